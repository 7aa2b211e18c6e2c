"""InterGen: the denoiser with its normalisation, text encoder and sampler.

Everything named *normalised* is features with their mean taken off, divided by their deviation;
*raw* is metres. Samples are drawn in normalised space.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from generator.architecture import DenoiserConfig
from generator.denoiser import MAX_POSITIONS, Denoiser
from generator.diffusion import STEPS, Constrain, SamplerConfig, sample
from generator.guidance import Guided
from generator.precision import matmul_precision
from generator.provenance import Provenance
from generator.smoothing import smooth
from generator.text.encoder import SentenceEncoder
from robots.errors import CheckpointError, PromptError, SpecError

if TYPE_CHECKING:
    from generator.motion import DuetMotion


def fresh_noise(generator: torch.Generator | None) -> Callable[[Tensor], Tensor]:
    """Return what gives noise like a tensor, from a generator (or from torch's global one)."""

    def like(x: Tensor) -> Tensor:
        return torch.randn(x.shape, generator=generator, device=x.device, dtype=x.dtype)

    return like


class InterGen(nn.Module):
    """Text to two-person motion by diffusion.

    Attributes:
        config: Architecture.
        denoiser: The network.
        text: What turns sentences into condition vectors; ``None``: only vectors are taken. Not a
            submodule, even if it is a module: optimisers and ``state_dict`` leave it alone.
        provenance: Origin, licence and frame rate.
        matmul: What :func:`generator.precision.matmul_precision` is set to while sampling.
    """

    mean: Tensor
    std: Tensor
    text: SentenceEncoder | None

    def __init__(
        self,
        config: DenoiserConfig,
        *,
        mean: Sequence[float] | np.ndarray | Tensor | None = None,
        std: Sequence[float] | np.ndarray | Tensor | None = None,
        text: SentenceEncoder | None = None,
        provenance: Provenance | None = None,
    ) -> None:
        """Make an untrained model.

        Args:
            config: Architecture.
            mean: ``[F]`` mean of each feature of one person; zeros by default.
            std: ``[F]`` deviation, all positive; ones by default.
            text: Encoder of sentences, of width ``config.text_width``.
            provenance: Origin, licence and frame rate.

        Raises:
            SpecError: The statistics do not fit the architecture or cannot be divided by.
        """
        super().__init__()
        self.config = config
        self.denoiser = Denoiser(config)
        self.__dict__["text"] = text
        self.provenance = provenance or Provenance()
        self.matmul: Literal["highest", "medium"] = "highest"
        self.register_buffer("mean", torch.zeros(config.features))
        self.register_buffer("std", torch.ones(config.features))
        if mean is not None or std is not None:
            self.set_statistics(
                np.zeros(config.features) if mean is None else mean,
                np.ones(config.features) if std is None else std,
            )

    @property
    def licence(self) -> str:
        """Licence of the weights, which every motion made from them carries."""
        return self.provenance.licence

    @property
    def has_statistics(self) -> bool:
        """Whether normalised features can be turned into metres."""
        return bool((self.mean != 0).any() or (self.std != 1).any())

    def set_statistics(
        self,
        mean: Sequence[float] | np.ndarray | Tensor,
        std: Sequence[float] | np.ndarray | Tensor,
    ) -> None:
        """Take mean and deviation ``[F]`` of the raw features of one person.

        Raises:
            SpecError: They do not fit, are not finite, or a deviation is not positive.
        """
        for name, value in (("mean", mean), ("std", std)):
            tensor = torch.as_tensor(value, dtype=torch.float32)
            if tensor.shape != (self.config.features,):
                raise SpecError(
                    f"{name} has shape {tuple(tensor.shape)}",
                    where="normalisation",
                    allowed=f"({self.config.features},)",
                )
            if not tensor.isfinite().all() or (name == "std" and not (tensor > 0).all()):
                raise SpecError(
                    f"{name} is not finite" + (" and positive" if name == "std" else ""),
                    where="normalisation",
                )
            getattr(self, name).copy_(tensor)

    def normalise(self, raw: Tensor) -> Tensor:
        """Return raw features ``[..., F]`` or ``[..., 2F]`` of mean 0 and deviation 1."""
        people = raw.unflatten(-1, (-1, self.config.features))
        return ((people - self.mean) / self.std).flatten(-2)

    def denormalise(self, normalised: Tensor) -> Tensor:
        """Return raw features ``[..., F]`` or ``[..., 2F]``; undoes :meth:`normalise`."""
        people = normalised.unflatten(-1, (-1, self.config.features))
        return (people * self.std + self.mean).flatten(-2)

    def forward(self, x: Tensor, t: Tensor, cond: Tensor, mask: Tensor | None = None) -> Tensor:
        """Return :meth:`denoise`."""
        return self.denoise(x, t, cond, mask)

    def denoise(self, x: Tensor, t: Tensor, cond: Tensor, mask: Tensor | None = None) -> Tensor:
        """Return the predicted clean motion ``[B, T, 2F]``, normalised.

        Args:
            x: ``[B, T, 2F]`` noisy motion, normalised: person a's F features, then b's.
            t: ``[B]`` diffusion step, 0 (clean) to 999.
            cond: ``[B, C]`` text vectors; zeros for the unconditional branch.
            mask: ``[B, T]`` (or ``[B, T, 2]``, one column per person, of which the first counts),
                nonzero where a frame exists; ``None``: everywhere.
        """
        if mask is not None and mask.dim() == 3:
            mask = mask[..., 0]
        return self.denoiser(x, t, cond, mask)

    def encode_text(self, sentences: Sequence[str]) -> Tensor:
        """Return the condition vectors ``[N, C]`` of sentences.

        Raises:
            CheckpointError: The model has no text encoder, or one of another width.
        """
        if self.text is None:
            raise CheckpointError(
                "this model was loaded without its text encoder",
                where=self.provenance.source or "InterGen",
                hint="load it with text=True, or pass condition vectors",
            )
        vectors = torch.from_numpy(np.asarray(self.text.encode(list(sentences)), np.float32))
        if vectors.shape != (len(sentences), self.config.text_width):
            raise CheckpointError(
                f"the text encoder gives vectors of width {vectors.shape[-1]}",
                where=type(self.text).__name__,
                allowed=str(self.config.text_width),
            )
        return vectors.to(self.mean.device)

    @torch.no_grad()
    def sample(
        self,
        cond: Tensor,
        frames: int,
        *,
        steps: int = 50,
        guidance: float = 3.5,
        eta: float = 0.0,
        solver: Literal["ddim", "dpm2m"] = "ddim",
        spacing: Literal["leading", "trailing"] = "leading",
        guidance_interval: tuple[int, int] = (0, STEPS - 1),
        x_T: Tensor | None = None,
        seed: int | None = None,
        constrain: Constrain[Tensor] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Tensor:
        """Return drawn motions ``[B, T, 2F]``, normalised.

        Args:
            cond: ``[B, C]`` text vectors.
            frames: Length T.
            steps: Network evaluations (twice as many with guidance).
            guidance: Weight of the text; 1 is plain.
            eta: Share of fresh noise per DDIM step, 0 to 1.
            solver: ``ddim``, or ``dpm2m`` (second order: fewer steps for the same error).
            spacing: ``leading`` (the release's) or ``trailing`` (better below some 20 steps).
            guidance_interval: First and last step t that are guided.
            x_T: ``[B, T, 2F]`` noise to start from; drawn from the seed by default.
            seed: Seed of all randomness; ``None`` takes torch's global generator.
            constrain: Applied to every prediction (normalised), with its step.
            progress: Called with the share done, 0 to 1.

        Raises:
            SpecError: A setting is out of range, or shapes do not fit together.
        """
        config = SamplerConfig(solver, steps, spacing, eta, guidance, guidance_interval)
        shape = self._shape(cond, frames, x_T)
        generator = None
        if seed is not None:
            generator = torch.Generator(device=cond.device).manual_seed(seed)
        if x_T is None:
            x_T = torch.randn(shape, generator=generator, device=cond.device)
        was_training = self.training
        self.eval()
        try:
            with matmul_precision(self.matmul):
                predict = Guided(self.denoiser, cond.to(self.denoiser.positions.dtype), config)
                fresh = fresh_noise(generator)
                return sample(
                    predict, x_T, config, fresh=fresh, constrain=constrain, progress=progress
                )
        finally:
            self.train(was_training)

    def _shape(self, cond: Tensor, frames: int, noise: Tensor | None) -> tuple[int, int, int]:
        if cond.dim() != 2 or cond.shape[1] != self.config.text_width:
            raise SpecError(
                f"condition vectors have shape {tuple(cond.shape)}",
                allowed=f"(batch, {self.config.text_width})",
            )
        if not 1 <= frames <= MAX_POSITIONS:
            raise SpecError(f"{frames} frames", allowed=f"1 to {MAX_POSITIONS}")
        shape = (len(cond), frames, 2 * self.config.features)
        if noise is not None and tuple(noise.shape) != shape:
            raise SpecError(f"the noise has shape {tuple(noise.shape)}", allowed=str(shape))
        return shape

    def generate(
        self,
        text: str,
        frames: int,
        seed: int = 0,
        *,
        smoothing: float = 1.0,
        **sampling: Any,
    ) -> DuetMotion:
        """Return a duet for a sentence.

        Args:
            text: What the two do; must not be empty.
            frames: Length, at ``provenance.fps`` frames per second.
            seed: The same seed gives the same duet on the same machine.
            smoothing: Deviation in frames of the Gaussian that smooths the keypoints; 0: none.
            sampling: Anything :meth:`sample` takes.

        Raises:
            PromptError: The sentence is empty.
            CheckpointError: The model has no text encoder, or no statistics.
        """
        from generator.canonical import from_canonical
        from generator.features import POSITIONS, decode

        if not text.strip():
            raise PromptError("the sentence is empty")
        if not self.has_statistics:
            raise CheckpointError(
                "the statistics that turn samples into metres are not there",
                where=self.provenance.source or "InterGen",
                hint="put global_mean.npy and global_std.npy beside the checkpoint",
            )
        drawn = self.sample(self.encode_text([text]), frames, seed=seed, **sampling)
        raw = self.denormalise(drawn[0]).unflatten(-1, (2, self.config.features))
        features = raw.cpu().numpy().astype(np.float64)
        if self.config.representation == "canonical":
            features = from_canonical(features)
        features[..., POSITIONS] = smooth(features[..., POSITIONS], smoothing)
        return decode(
            features,
            self.provenance.fps,
            text=text,
            seed=seed,
            source=self.provenance.source,
            licence=self.licence,
        )
