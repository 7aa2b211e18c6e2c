"""Generation around something given (Sec. 5.4): person-to-person, trajectories, in-betweening.

**The problem.** The sampler turns noise into motion; what is given must come out exactly, and the
rest must fit it. Two ways lead there, for any :class:`generator.given.Given`:

*Conditioning while sampling* needs no training. Every prediction of the clean motion gets the given
numbers put in before the sampler goes on, so the network sees them at each step's noise level and
mends the rest around them. A path is given for the pelvis alone; put in as it is, it would tear the
pelvis out of the body, so the predicted body is first moved along with it.

*A fine-tuned model* (``training.freeze``) has learnt to read what is given: in its input these
numbers carry no noise. It gets them so in every step, and the same replacement keeps them exact.

Where a given end meets the generated middle, a prediction rarely goes on exactly from it. The gap
that the network leaves at the last given frame is handed on to the frames after it, fading over
:data:`BLEND_SECONDS`, so that no body jumps.

The sampler works on normalised float32, which costs some 1e-7 of a metre; the given numbers
themselves are put into the result last.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from generator.architecture import FEATURES
from generator.diffusion import STEPS, SamplerConfig, sample
from generator.features import CONTACTS, POINTS, POSITIONS, VELOCITIES, decode
from generator.given import Given
from generator.guidance import Guided
from generator.model import InterGen, fresh_noise
from generator.motion import DuetMotion
from generator.precision import matmul_precision
from generator.smoothing import smooth
from robots.errors import CheckpointError, SpecError
from robots.skeleton import FloatArray

FREEZE = "freeze"
"""Entry of ``provenance.training`` that says what a model has learnt to read without noise."""

BLEND_SECONDS = 0.4
"""Time over which the gap between a given end and the generated middle fades."""

_READS: dict[str, tuple[str, ...]] = {
    "person": ("person", "mixed"),
    "trajectory": ("trajectory", "mixed"),
    "ends": ("ends", "mixed"),
}
_GROUND = [3 * i + axis for i in range(POINTS) for axis in (0, 2)]
_GROUND_STEPS = [3 * POINTS + i for i in _GROUND]


@dataclass(frozen=True, slots=True)
class Draw:
    """How a motion around something given is drawn.

    Raises:
        SpecError: A number is out of range.
    """

    sampler: SamplerConfig = field(default_factory=SamplerConfig)
    """Solver, steps and guidance."""
    smoothing: float = 1.0
    """Deviation in frames of the Gaussian over the generated keypoints; 0: none."""
    strength: float = 0.7
    """Share of the diffusion that a further round undoes: 1 forgets the round before."""
    clean_input: bool | None = None
    """Give the network the given numbers without noise; ``None``: if it was trained for it."""

    def __post_init__(self) -> None:
        """Validate."""
        if not 0 < self.strength <= 1:
            raise SpecError(f"{self.strength}", where="strength", allowed="above 0, up to 1")
        if self.smoothing < 0:
            raise SpecError(f"{self.smoothing}", where="smoothing", allowed="0 or more")


def generate_around(
    model: InterGen,
    texts: Sequence[str],
    given: Given,
    *,
    seed: int = 0,
    draw: Draw | None = None,
    progress: Callable[[float], None] | None = None,
) -> DuetMotion:
    """Return a duet that holds what is given, and fits a sentence around it.

    Args:
        model: Of the non-canonical representation, with statistics.
        texts: A sentence, which may be empty: then nothing but what is given guides. Further ones
            are further rounds of in-betweening: each starts from the motion of the round before,
            noised anew up to ``draw.strength``.
        given: What is known; its length is that of the motion.
        seed: The same seed gives the same duet on the same machine.
        draw: How.
        progress: Called with the share done, 0 to 1.

    Raises:
        CheckpointError: The model is of the canonical representation, has no statistics, or no
            text encoder.
        SpecError: There is no sentence, not even an empty one.
    """
    draw = draw or Draw()
    _require_fit(model)
    if not texts:
        raise SpecError("there is no sentence", where="texts", allowed="one or more; may be empty")
    previous: Tensor | None = None
    for number, text in enumerate(texts):
        previous = sample_around(
            model,
            _condition(model, text),
            given,
            seed=seed + number,
            draw=draw,
            previous=previous,
            progress=_part(progress, number, len(texts)),
        )
    if previous is None:
        raise SpecError("there is no sentence", where="texts")
    features = _in_metres(model, previous, given, draw.smoothing)
    return decode(
        features,
        model.provenance.fps,
        placement=given.placement,
        text=texts[-1],
        seed=seed,
        source=model.provenance.source,
        licence=model.licence,
    )


@torch.no_grad()
def sample_around(
    model: InterGen,
    cond: Tensor | None,
    given: Given,
    *,
    seed: int,
    draw: Draw,
    previous: Tensor | None = None,
    progress: Callable[[float], None] | None = None,
) -> Tensor:
    """Return a drawn motion ``[1, T, 524]``, normalised, that holds what is given.

    Args:
        model: The model.
        cond: ``[1, C]`` text vector; ``None`` for no text.
        given: What is known.
        seed: Of all randomness.
        draw: How.
        previous: ``[1, T, 524]`` a motion to start from instead of noise; see ``draw.strength``.
        progress: Called with the share done.
    """
    config = draw.sampler
    if cond is None:
        width = model.config.text_width
        cond = torch.zeros((1, width), device=model.mean.device)
        config = SamplerConfig(config.solver, config.steps, config.spacing, config.eta, 1.0)
    generator = torch.Generator(device=cond.device).manual_seed(seed)
    shape = (1, given.frames, 2 * FEATURES)
    noise = torch.randn(shape, generator=generator, device=cond.device)
    keep = Keep(model, given)
    clean_input = draw.clean_input
    if clean_input is None:
        clean_input = _has_learnt(model, given)
    first = STEPS if previous is None else round(draw.strength * STEPS)
    was_training = model.training
    model.eval()
    try:
        with matmul_precision(model.matmul):
            guided = Guided(model.denoiser, cond.to(model.denoiser.positions.dtype), config)

            def predict(x: Tensor, step: int) -> Tensor:
                # Above the first step the round before stands in for the network: the sampler then
                # arrives there with exactly that motion, noised.
                if previous is not None and step > first:
                    return previous
                return guided(keep.put(x) if clean_input else x, step)

            fresh = fresh_noise(generator)
            return sample(predict, noise, config, fresh=fresh, constrain=keep, progress=progress)
    finally:
        model.train(was_training)


class Keep:
    """Puts what is given into a predicted motion."""

    def __init__(self, model: InterGen, given: Given) -> None:
        """Prepare the given numbers, normalised."""
        self._model = model
        mean = model.mean
        flat = torch.tensor(given.values, dtype=mean.dtype, device=mean.device).flatten(1)
        self._values = model.normalise(flat)[None]
        self._known = torch.tensor(given.known, device=mean.device).flatten(1)[None]
        self._paths = given.paths
        frames = max(1, round(BLEND_SECONDS * model.provenance.fps))
        self._fades = [
            (edge, torch.tensor(weights, dtype=mean.dtype, device=mean.device)[:, None])
            for edge, weights in _fades(given, frames)
        ]
        self._poses = torch.ones(FEATURES, dtype=torch.bool, device=mean.device)
        self._poses[VELOCITIES] = self._poses[CONTACTS] = False
        self._poses = self._poses.repeat(2)

    def put(self, x: Tensor) -> Tensor:
        """Return ``x [B, T, 524]`` (normalised) with the given numbers in place."""
        return torch.where(self._known, self._values.to(x.dtype), x)

    def __call__(self, clean: Tensor, step: int) -> Tensor:
        """Return a prediction with the given numbers in place and bodies moved along paths."""
        if any(self._paths):
            clean = self._moved(clean)
        blended = clean
        for edge, weights in self._fades:
            gap = (self._values - clean)[:, edge] * self._poses
            blended = blended + weights * gap[:, None]
        return self.put(blended)

    def _moved(self, clean: Tensor) -> Tensor:
        """Shift the bodies of those whose path is given so that the pelvis follows it."""
        raw = self._model.denormalise(clean).unflatten(-1, (2, FEATURES)).clone()
        target = self._model.denormalise(self._values).unflatten(-1, (2, FEATURES))
        for person, has_path in enumerate(self._paths):
            if not has_path:
                continue
            pelvis = [_GROUND[0], _GROUND[1]]
            shift = target[:, :, person, pelvis] - raw[:, :, person, pelvis]
            steps = shift.diff(dim=1, append=shift[:, -1:])
            raw[:, :, person, _GROUND] += shift.repeat(1, 1, POINTS)
            raw[:, :, person, _GROUND_STEPS] += steps.repeat(1, 1, POINTS)
        return self._model.normalise(raw.flatten(-2))


def _fades(given: Given, frames: int) -> list[tuple[int, FloatArray]]:
    """Return the last given frame at each end, and the weights ``[T]`` of the gap there.

    A weight is 1 at the edge and falls smoothly to 0 ``frames`` later; it is 0 on given frames.
    """
    if kind_of(given) != "ends":
        return []
    free = np.flatnonzero(~given.known[..., POSITIONS].all(axis=(1, 2)))
    edges = [(free[0] - 1, 1), (free[-1] + 1, -1)]
    result = []
    for edge, way in edges:
        if 0 <= edge < given.frames:
            share = np.clip(way * (np.arange(given.frames) - edge) / (frames + 1), 0, 1)
            weights = 1 - share * share * (3 - 2 * share)
            outside = np.ones(given.frames, bool)
            outside[free] = False
            weights[outside] = 0
            result.append((int(edge), weights))
    return result


def kind_of(given: Given) -> Literal["person", "trajectory", "ends"]:
    """Return which of the three applications something given belongs to."""
    if any(given.paths):
        return "trajectory"
    whole = given.known.all(axis=(0, 2))
    return "person" if whole.any() else "ends"


def _has_learnt(model: InterGen, given: Given) -> bool:
    learnt = str(model.provenance.training.get(FREEZE, "none"))
    return learnt in _READS[kind_of(given)]


def _require_fit(model: InterGen) -> None:
    where = model.provenance.source or "InterGen"
    if model.config.representation != "non_canonical":
        raise CheckpointError(
            "the canonical representation holds no places to give",
            where=where,
            allowed="a model of the non-canonical representation",
        )
    if not model.has_statistics:
        raise CheckpointError(
            "the statistics that turn samples into metres are not there", where=where
        )


def _condition(model: InterGen, text: str) -> Tensor | None:
    return model.encode_text([text]) if text.strip() else None


def _part(
    progress: Callable[[float], None] | None, number: int, count: int
) -> Callable[[float], None] | None:
    if progress is None:
        return None
    return lambda share: progress((number + share) / count)


def _in_metres(model: InterGen, drawn: Tensor, given: Given, smoothing: float) -> FloatArray:
    """Return features ``[T, 2, 262]``: de-normalised, smoothed, and what is given as it was."""
    raw = model.denormalise(drawn[0]).unflatten(-1, (2, FEATURES))
    features = raw.cpu().numpy().astype(np.float64)
    features = np.where(given.known, given.values, features)
    if smoothing:
        ends = 3 * POINTS
        features[..., :ends] = smooth(features[..., :ends], smoothing)
        for person, has_path in enumerate(given.paths):
            if has_path:  # smoothing moved the pelvis off its path; the body goes back with it
                shift = (given.values - features)[:, person, :3] * (1, 0, 1)
                features[:, person, :ends] += np.tile(shift, POINTS)
    return np.where(given.known, given.values, features)
