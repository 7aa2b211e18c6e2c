"""From a sentence to a duet with a model that needs no torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.canonical import from_canonical
from generator.diffusion import SamplerConfig, sample
from generator.features import POSITIONS, decode
from generator.motion import DuetMotion
from generator.runtime.network import GuidedNetwork
from generator.runtime.portable import SHIPPED, Portable
from generator.smoothing import smooth
from generator.text.encoder import SentenceEncoder, packaged_encoder
from robots.errors import CheckpointError, PromptError, SpecError

SECONDS = 6.5
"""Length of a motion if nothing else decides it: half of the choreographer's duets are shorter."""

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffusionRequest:
    """What to generate besides the sentence; what is ``None`` is the model's own choice.

    Raises:
        SpecError: A number is out of range, or settings exclude each other.
    """

    weights: str = ""
    """Folder of a model; the one that ships by default."""
    frames: int | None = None
    """Length in frames."""
    seconds: float | None = None
    """Length in seconds, instead of ``frames``."""
    steps: int | None = None
    """Sampling steps."""
    guidance: float | None = None
    """Weight of the sentence."""
    threads: int | None = None
    """Threads; one by default."""
    smoothing: float = 0.0
    """Deviation in frames of the Gaussian over generated keypoints."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.frames is not None and self.seconds is not None:
            raise SpecError("frames and seconds", allowed="one of them")
        if self.threads is not None and self.threads < 1:
            raise SpecError(f"{self.threads}", where="--threads", allowed="1 or more")


def generate(
    text: str,
    request: DiffusionRequest,
    *,
    seed: int = 0,
    encoder: SentenceEncoder | None = None,
    progress: Progress | None = None,
) -> tuple[DuetMotion, dict[str, Any]]:
    """Return a duet and the facts of how it was made.

    Args:
        text: The sentence.
        request: Everything else.
        seed: The same seed gives the same duet on the same machine.
        encoder: Sentence encoder; the one that ships by default.
        progress: Called with the share done, 0 to 1.

    Raises:
        PromptError: The sentence is empty.
        CheckpointError: The model is missing or damaged.
        SpecError: A setting is out of range.
    """
    if not text.strip():
        raise PromptError("the sentence is empty")
    model = Portable.load(chosen_folder(request.weights), threads=request.threads or 1)
    if encoder is None:
        encoder = packaged_encoder(model.text_encoder)
        if encoder is None:
            raise CheckpointError(
                f"the model was made with the text encoder '{model.text_encoder}', which does not"
                " come with it",
                where=request.weights,
            )
    frames = _frames(request, model)
    sampler = model.sampling.sampler(request.steps, request.guidance)
    cond = np.asarray(encoder.encode([text]), np.float32)
    features = draw(model, cond, frames, sampler, seed=seed, progress=progress)[0]
    features[..., POSITIONS] = smooth(features[..., POSITIONS], request.smoothing)
    motion = decode(
        features,
        model.provenance.fps,
        text=text,
        seed=seed,
        source=model.provenance.source,
        licence=model.provenance.licence,
    )
    facts = {
        "weights": request.weights or "shipped",
        "model": model.provenance.source,
        "steps": sampler.steps,
        "guidance": sampler.guidance,
    }
    return motion, facts


def draw(
    model: Portable,
    cond: NDArray[np.float32],
    frames: int,
    sampler: SamplerConfig | None = None,
    *,
    seed: int = 0,
    noise: NDArray[np.float32] | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float64]:
    """Return features ``[B, T, 2, 262]`` in metres, drawn for text vectors.

    Args:
        model: The model.
        cond: ``[B, C]`` text vectors.
        frames: Length T.
        sampler: How; the model's own choice by default.
        seed: Of all randomness.
        noise: ``[B, T, 2F]`` to start from; drawn from the seed by default.
        progress: Called with the share done, 0 to 1.

    Raises:
        SpecError: The vectors are of another width.
    """
    config = sampler or model.sampling.sampler()
    if cond.ndim != 2 or cond.shape[1] != model.config.text_width:
        raise SpecError(
            f"text vectors have shape {cond.shape}", allowed=f"(batch, {model.config.text_width})"
        )
    rng = np.random.default_rng(seed)
    if noise is None:
        shape = (len(cond), frames, 2 * model.config.features)
        noise = rng.standard_normal(shape, np.float32)

    def fresh(x: NDArray[np.float32]) -> NDArray[np.float32]:
        return rng.standard_normal(x.shape, np.float32)

    predict = GuidedNetwork(model.network, cond, config)
    drawn = model.denormalise(sample(predict, noise, config, fresh=fresh, progress=progress))
    if model.config.representation == "canonical":
        drawn = np.stack([from_canonical(one) for one in drawn])
    return drawn


def chosen_folder(weights: str) -> Path:
    """Return the folder of the model that is asked for; of the one that ships by default.

    Raises:
        CheckpointError: None ships with this version.
    """
    if weights:
        return Path(weights)
    if not SHIPPED.is_dir():
        raise CheckpointError(
            "no model ships with this version",
            hint="name one with --weights (pasdedeux train makes them), or take --generator"
            " choreographer",
        )
    return SHIPPED


def _frames(request: DiffusionRequest, model: Portable) -> int:
    fps, longest = model.provenance.fps, model.sampling.frames
    if request.frames is not None:
        frames = request.frames
    elif request.seconds is not None:
        frames = round(request.seconds * fps)
    else:
        frames = min(round(SECONDS * fps), longest)
    if not 2 <= frames <= longest:
        raise SpecError(
            f"{frames} frames",
            where="length",
            allowed=f"2 to {longest} ({longest / fps:g} s), which is what the model has learnt",
        )
    return frames
