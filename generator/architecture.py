"""The architecture of a denoiser, as data that is saved beside its weights. Torch-free."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from robots.errors import SpecError

FEATURES = 262
"""Numbers per person and frame in the non-canonical representation (eq. 2)."""

_CHOICES = {
    "representation": ("non_canonical", "canonical"),
    "conditioning": ("mutual", "concat"),
}


@dataclass(frozen=True, slots=True)
class DenoiserConfig:
    """Size and variant of the cooperative denoiser (Sec. 4.2).

    The defaults are the size of the paper (Sec. 5.1). The three variants are rows of Table 3.

    Raises:
        SpecError: A number is out of range, or the width does not divide by the heads.
    """

    width: int = 1024
    """Latent dimension D."""
    layers: int = 8
    """Blocks N."""
    heads: int = 8
    """Attention heads per layer."""
    feedforward: int = 2048
    """Hidden width of the feed-forward layers."""
    dropout: float = 0.1
    """In attention and feed-forward layers, while training."""
    features: int = FEATURES
    """Numbers per person and frame."""
    text_width: int = 768
    """Width of the condition vector."""
    text_tokens: int = 0
    """Above 0, the condition vector is so many token vectors in a row, zeros where the sentence has
    ended, and the network has layers of its own to read them; else it is taken as it is."""
    text_names: bool = False
    """Whether the last number of each token says whom it names: positive for person a, negative for
    person b."""
    text_layers: int = 2
    """How many layers read the tokens."""
    representation: Literal["non_canonical", "canonical"] = "non_canonical"
    """What the numbers mean: eq. (2), or eq. (1) for the row "canonical rep"."""
    conditioning: Literal["mutual", "concat"] = "mutual"
    """How a person knows of the other: attention to the other's hidden states, or (row
    "concat-conditioning") the other's noisy motion beside the own as input, and no such layers."""
    share_weights: bool = True
    """Whether both persons have the same network (row "w/o weights sharing")."""
    told_apart: bool = False
    """Whether a person is told which of the two it is. The paper's network is not: exchanging the
    noise exchanges the people, so a sentence cannot say who of them does what."""

    def __post_init__(self) -> None:
        """Validate."""
        for name in ("width", "layers", "heads", "feedforward", "features", "text_width"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise SpecError(f"{name} is {value!r}", where="denoiser", allowed="1 or more")
        for name, allowed in _CHOICES.items():
            if getattr(self, name) not in allowed:
                raise SpecError(
                    f"{name} is {getattr(self, name)!r}",
                    where="denoiser",
                    allowed=" or ".join(allowed),
                )
        for name in ("text_tokens", "text_layers"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 0:
                raise SpecError(f"{name} is {value!r}", where="denoiser", allowed="0 or more")
        if self.text_tokens and self.text_width % self.text_tokens:
            raise SpecError(
                f"text_width {self.text_width} does not divide by {self.text_tokens} tokens",
                where="denoiser",
            )
        if self.width % self.heads or self.width % 2:
            raise SpecError(
                f"width {self.width} does not divide by {self.heads} heads and by 2",
                where="denoiser",
            )
        if not 0 <= self.dropout < 1:
            raise SpecError(f"dropout {self.dropout}", where="denoiser", allowed="0 up to below 1")
