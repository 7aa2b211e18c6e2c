"""Motions out of noise, without torch, and what may steer them on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.canonical import from_canonical
from generator.diffusion import STEPS, SamplerConfig, sample, timesteps
from generator.features import POSITIONS
from generator.runtime.network import Accent, Floats, GuidedNetwork
from generator.runtime.portable import Portable
from robots.errors import SpecError

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """What is known of a motion: put into every prediction, so that the rest is drawn to fit it.

    The last prediction is left as it is. There the network has seen the known part all but clean,
    so it repeats it within a little, and what it repeats goes on smoothly into what it adds: who
    needs the known part exactly has both at hand, and can blend.
    """

    values: Floats
    """``[B, T, 2F]``, normalised."""
    known: NDArray[np.bool_]
    """``[B, T, 2F]`` or what broadcasts to it: which of them are known."""
    edge: int = 0
    """Last known frame, if what is known is a beginning."""
    carry: Floats | None = None
    """``[T, 2F]``, 0 to 1: share of the prediction's error in that frame by which the frames after
    it are corrected. Putting the known part in alone leaves a kink there."""

    def put_into(self, clean: Floats) -> Floats:
        """Return a prediction ``[B, T, 2F]`` with what is known in its place."""
        if self.carry is not None:
            error = (self.values - clean)[:, self.edge, None]
            clean = (clean + self.carry * error).astype(np.float32, copy=False)
        return np.where(self.known, self.values, clean)


@dataclass(frozen=True, slots=True, eq=False)
class Steering:
    """What acts on a draw besides the sentence."""

    accents: tuple[Accent, ...] = ()
    """Emphasis; see :class:`~generator.runtime.network.GuidedNetwork`."""
    other: Floats | None = None
    """``[B, C]``, text vectors of what person b does, if the sentence is about person a alone."""
    held: Held | None = None
    """What is known of the motion."""
    mend: Callable[[Floats], Floats] | None = None
    """Changes a prediction ``[B, T, 2F]``, normalised, so that it is possible."""
    start: Floats | None = None
    """``[B, T, 2F]``, normalised: a motion to vary."""
    strength: float = 0.7
    """Share of the diffusion that is undone when one is varied: 0 keeps it, 1 forgets it."""
    avoid: tuple[Floats, ...] = ()
    """Motions ``[B, T, 2F]``, normalised, to draw away from."""
    repulsion: float = 0.5
    """How far each of them pushes while only the outline is settled, as a share of what is left of
    the way to :data:`FAR`."""


PLAIN = Steering()
"""Nothing but the sentence."""
FAR = 2.0
"""Root mean square distance of keypoints, in their standard deviations, from which nothing is
pushed away: two motions that know nothing of each other are 1.4 apart."""
OUTLINE = STEPS // 2
"""Above this step a prediction is an outline: what is changed there, later steps work out."""


def draw(
    model: Portable,
    cond: Floats,
    frames: int,
    sampler: SamplerConfig | None = None,
    *,
    seed: int | tuple[int, ...] = 0,
    noise: Floats | None = None,
    steering: Steering = PLAIN,
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
        steering: What acts on it besides the text.
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

    def fresh(x: Floats) -> Floats:
        return rng.standard_normal(x.shape, np.float32)

    guided = GuidedNetwork(model.network, cond, config, steering.accents, steering.other)
    start, first = steering.start, round(steering.strength * STEPS)

    def predict(x: Floats, step: int) -> Floats:
        # Above the first step the motion to vary stands in for the network: the sampler then
        # arrives there with exactly that motion, noised.
        return guided(x, step) if start is None or step <= first else start

    last = timesteps(config.steps, config.spacing)[-1]
    normalised = sample(
        predict,
        noise,
        config,
        fresh=fresh,
        constrain=lambda clean, step: _steered(clean, step, last, steering),
        progress=progress,
    )
    drawn = model.denormalise(normalised)
    if model.config.representation == "canonical":
        drawn = np.stack([from_canonical(one) for one in drawn])
    return drawn


def _steered(clean: Floats, step: int, last: int, steering: Steering) -> Floats:
    """Return a prediction that keeps away, is possible, and has what is known in place."""
    if step > OUTLINE:
        for other in steering.avoid:
            clean = _away(clean, other, steering.repulsion)
    if steering.mend is not None:
        clean = steering.mend(clean)
    if steering.held is not None and step != last:
        return steering.held.put_into(clean)
    return clean


def _away(clean: Floats, other: Floats, repulsion: float) -> Floats:
    """Return predictions ``[B, T, 2F]``, each pushed away from another motion along the difference.

    The push fades with distance, so that steps do not add up to a motion that nobody makes.
    """
    between = clean - other
    points = between.reshape(*between.shape[:2], 2, -1)[..., POSITIONS]
    distance = np.sqrt((points**2).mean(axis=(1, 2, 3)))[:, None, None]
    push = repulsion * np.maximum(FAR - distance, 0.0) / np.maximum(distance, 1e-6)
    return (clean + push * between).astype(np.float32, copy=False)
