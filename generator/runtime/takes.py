"""Takes that a draw should be like or unlike: motion files, or seeds of the same request."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from generator.features import VELOCITIES, pair_features
from generator.motion import DuetMotion
from generator.runtime.network import Floats
from generator.runtime.portable import Portable
from robots.errors import SpecError
from robots.skeleton import FloatArray

Redraw = Callable[[int], NDArray[np.float64]]
"""Draws the features ``[T, 2, 262]`` of a seed."""


def read_take(name: str, model: Portable, frames: int, redraw: Redraw) -> Floats:
    """Return a take as a model sees it, ``[1, frames, 2F]`` and normalised.

    A take of another length is stretched over the frames.

    Args:
        name: A motion file, or a seed.
        model: The model.
        frames: How long it has to be.
        redraw: Draws the take of a seed.

    Raises:
        SpecError: It is neither.
        MotionFileError: The file cannot be read.
    """
    if Path(name).exists():
        from generator.io import read_motion

        features = features_at(read_motion(Path(name)), model.provenance.fps)
    elif name.strip().isdigit():
        features = redraw(int(name))
    else:
        raise SpecError(f"'{name}' is no file", allowed="a motion file, or the seed of a take")
    return model.normalise(stretched(features, frames))[None]


def take_frames(name: str, fps: float) -> int | None:
    """Return how many frames a take has at a frame rate; ``None`` for a seed."""
    if not Path(name).exists():
        return None
    from generator.io import read_motion

    motion = read_motion(Path(name))
    return max(2, round(motion.duration * fps))


def features_at(motion: DuetMotion, fps: float) -> FloatArray:
    """Return the features ``[T, 2, 262]`` of a motion at a frame rate."""
    from generator.data.clip import clip_of, resampled

    return pair_features(resampled(clip_of(motion), fps).poses, fps)


def stretched(features: NDArray, frames: int) -> FloatArray:
    """Return features ``[frames, 2, 262]`` that take all of the time; displacements shrink."""
    features = np.asarray(features, float)
    if len(features) == frames:
        return features
    at = np.linspace(0, len(features) - 1, frames)
    low = np.minimum(at.astype(int), len(features) - 2)
    share = (at - low)[:, None, None]
    out = features[low] * (1 - share) + features[low + 1] * share
    out[..., VELOCITIES] *= (len(features) - 1) / (frames - 1)
    return out
