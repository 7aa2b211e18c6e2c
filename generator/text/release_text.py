"""The text path of InterGen's public release: CLIP, and two trained layers the paper leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from generator.text.clip import ClipTextTower, sentence_end
from generator.text.clip_tokenizer import ClipTokenizer, find_vocabulary
from generator.weights import adopt
from robots.errors import CheckpointError

_HEAD = {"clipTransEncoder.": "layers.", "clip_ln.": "norm."}
"""Prefixes of the release's keys, and of :class:`ReleaseTextHead`'s."""


class ReleaseTextHead(nn.Module):
    """Two post-norm transformer layers and a layer norm over CLIP's states; the end mark's counts.

    No mask at all: padding is attended to, as it was in training.
    """

    def __init__(self, width: int, layers: int = 2, heads: int = 8, hidden: int = 2048) -> None:
        """Make an untrained head."""
        super().__init__()
        layer = nn.TransformerEncoderLayer(
            width, heads, hidden, dropout=0.1, activation="gelu", batch_first=True
        )
        self.layers = nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)
        self.norm = nn.LayerNorm(width)

    def states(self, clip_states: Tensor) -> Tensor:
        """Return ``[N, S, D]`` for CLIP's states ``[N, S, D]``."""
        return self.norm(self.layers(clip_states))

    def forward(self, clip_states: Tensor, tokens: Tensor) -> Tensor:
        """Return condition vectors ``[N, D]``."""
        rows = torch.arange(len(tokens), device=tokens.device)
        return self.states(clip_states)[rows, sentence_end(tokens)]


class ReleaseText(nn.Module):
    """CLIP's frozen text tower and the trained head, as one sentence encoder.

    Attributes:
        dimension: Width of the condition vectors.
    """

    kind = "release"

    def __init__(
        self,
        tower: ClipTextTower,
        head: ReleaseTextHead,
        *,
        vocabulary: str | Path | None = None,
        folder: str | Path | None = None,
    ) -> None:
        """Join the parts.

        Args:
            tower: CLIP.
            head: The trained layers.
            vocabulary: File of CLIP's vocabulary; found when the first sentence is encoded if not
                given.
            folder: Where to look for it first.
        """
        super().__init__()
        self.tower = tower.requires_grad_(False)
        self.head = head
        self.dimension = tower.config.width
        self._vocabulary, self._folder = vocabulary, folder
        self._tokenizer: ClipTokenizer | None = None

    def forward(self, tokens: Tensor) -> Tensor:
        """Return condition vectors ``[N, D]`` of tokens ``[N, 77]``; gradients reach the head."""
        with torch.no_grad():
            states = self.tower(tokens)
        return self.head(states, tokens)

    @torch.no_grad()
    def encode(self, sentences: Sequence[str]) -> NDArray[np.float32]:
        """Return condition vectors ``[N, D]`` of sentences.

        Raises:
            CheckpointError: CLIP's vocabulary is not on this machine.
        """
        if self._tokenizer is None:
            self._tokenizer = ClipTokenizer(find_vocabulary(self._vocabulary, self._folder))
        was_training = self.training
        self.eval()
        try:
            return self(torch.from_numpy(self._tokenizer.encode(sentences))).numpy()
        finally:
            self.train(was_training)

    @classmethod
    def from_release_state(
        cls,
        state: Mapping[str, Tensor],
        *,
        where: str,
        vocabulary: str | Path | None = None,
        folder: str | Path | None = None,
    ) -> ReleaseText:
        """Return the text path out of the release's checkpoint.

        Args:
            state: Its keys of the text path, without the prefix ``model.``.
            where: Name of the file, for errors.
            vocabulary: File of CLIP's vocabulary, if known.
            folder: Where to look for it.

        Raises:
            CheckpointError: A key is missing, or of another shape.
        """
        named: dict[str, Tensor] = {}
        for key, value in state.items():
            theirs = next((prefix for prefix in _HEAD if key.startswith(prefix)), None)
            if theirs is None:
                named["tower." + key.removeprefix("clip_transformer.")] = value
            else:
                named["head." + _HEAD[theirs] + key.removeprefix(theirs)] = value
        return cls.from_state(named, where=where, vocabulary=vocabulary, folder=folder)

    @classmethod
    def from_state(
        cls,
        state: Mapping[str, Tensor],
        *,
        where: str,
        vocabulary: str | Path | None = None,
        folder: str | Path | None = None,
    ) -> ReleaseText:
        """Return the text path from its own ``state_dict``; arguments and errors as above."""
        parts: dict[str, dict[str, Tensor]] = {"tower": {}, "head": {}}
        for key, value in state.items():
            part, _, name = key.partition(".")
            if part not in parts:
                raise CheckpointError(f"key '{key}' is not of the text path", where=where)
            parts[part][name] = value
        tower = ClipTextTower.from_state(parts["tower"], where=where)
        inner = parts["head"].get("layers.layers.0.linear1.bias")
        count = sum(name.endswith(".linear1.bias") for name in parts["head"])
        with torch.device("meta"):
            head = ReleaseTextHead(
                tower.config.width,
                layers=max(count, 1),
                hidden=2048 if inner is None else len(inner),
            )
        copies = {name: value.float().clone() for name, value in parts["head"].items()}
        adopt(head, copies, where=where)
        return cls(tower, head, vocabulary=vocabulary, folder=folder).eval()
