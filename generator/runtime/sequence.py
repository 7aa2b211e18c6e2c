"""Motions of any length, from a network that has learnt short ones: windows that overlap.

**The problem.** A network draws at most so many frames at once. Two windows drawn one after the
other do not meet: the people jump. So each window but the first begins with frames of the one
before it, which are held while the rest is drawn (:class:`~generator.runtime.drawing.Held`), and
the two versions of these frames, the old one and what the network makes of it, are faded from one
into the other. What the network draws beyond fits its own version, so nothing jumps at either end
of the fade.

A network knows motions in the frame of their first person's first pose alone. So the end of a
window is seen from there, where its first person stands now, and what is drawn is put back. Only
the end of the last window is kept in mind, however long the sequence grows.

Example: windows of at most 75 frames that overlap by 9, parts of 90 and 49 frames. The first part
is drawn as windows of 50 and 49 (9 of them known), the second as one of 58 (9 known).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.features import CONTACTS, POINTS, POSITIONS, VELOCITIES
from generator.placement import Placement, placement_of, turn_about_y
from generator.runtime.drawing import Held
from generator.runtime.portable import Portable
from robots.skeleton import FloatArray

OVERLAP_SECONDS = 1.2
"""Time that two windows share."""


@dataclass(frozen=True, slots=True)
class Window:
    """What is drawn at once."""

    part: int
    """Which sentence it is of."""
    frames: int
    """Its length, with the known beginning."""


def overlap_of(longest: int, fps: float) -> int:
    """Return how many frames two windows share: no more than a third of one."""
    return max(1, min(round(OVERLAP_SECONDS * fps), longest // 3))


def plan(parts: Sequence[int], longest: int, overlap: int) -> list[Window]:
    """Return the windows of parts that are so many frames long, each part in equal windows.

    Args:
        parts: Frames of each part; the first has more than windows share, if there are others.
        longest: Frames that a window may have.
        overlap: Frames that two windows share, fewer than ``longest``.
    """
    windows = []
    for part, frames in enumerate(parts):
        known = overlap if part else 0
        count = max(1, math.ceil((frames + known - overlap) / (longest - overlap)))
        total = frames + known + (count - 1) * overlap
        lengths = [total // count + (i < total % count) for i in range(count)]
        windows += [Window(part, length) for length in lengths]
    return windows


Draw = Callable[[int, Window, "FloatArray | None"], FloatArray]
"""Takes the number of a window, the window and its known beginning ``[overlap, 2, 262]``, returns
features ``[window.frames, 2, 262]``."""


def sequence(windows: Sequence[Window], overlap: int, draw: Draw) -> Iterator[FloatArray]:
    """Yield the features ``[?, 2, 262]`` of a sequence, in the frame of its first pose.

    Args:
        windows: From :func:`plan`.
        overlap: Frames that two windows share.
        draw: Draws a window.
    """
    fade = _rise(np.arange(1, overlap + 1) / (overlap + 1))[:, None, None]
    end: FloatArray | None = None
    for number, window in enumerate(windows):
        if end is None:
            drawn = draw(number, window, None)
        else:
            stand = placement_of(_points(end[:1, 0, POSITIONS]))
            drawn = put_back(draw(number, window, seen_from(end, stand)), stand)
            drawn[:overlap] = end + fade * (drawn[:overlap] - end)
        if number + 1 < len(windows):
            yield drawn[:-overlap]
            end = drawn[-overlap:]
        else:
            yield drawn


def held_beginning(model: Portable, beginning: NDArray, frames: int) -> Held:
    """Return that a motion of so many frames begins with features ``[overlap, 2, 262]``.

    The displacements of the last of them are left open: they lead to what is drawn. By how much
    the network misses the last pose is handed on to as many frames after it, fading out.
    """
    count = len(beginning)
    values = np.zeros((1, frames, 2 * model.config.features), np.float32)
    values[0, :count] = model.normalise(beginning)
    known = np.zeros((1, frames, 2, model.config.features), bool)
    known[:, :count] = True
    known[:, count - 1, :, VELOCITIES] = False
    share = np.clip(np.arange(1 - count, frames - count + 1) / (count + 1), 0, 1)
    carry = np.zeros(known.shape[1:], np.float32)
    carry[:] = _rise(1 - share)[:, None, None]
    carry[:count] = carry[..., VELOCITIES] = carry[..., CONTACTS] = 0
    return Held(values, known.reshape(values.shape), count - 1, carry.reshape(values.shape[1:]))


def seen_from(features: NDArray, placement: Placement) -> FloatArray:
    """Return features ``[T, ..., 262]`` as they are in the frame of a placement."""
    out = np.array(features, float)
    out[..., POSITIONS] = _flat(placement.apply(_points(out[..., POSITIONS])))
    out[..., VELOCITIES] = _flat(placement.turn(_points(out[..., VELOCITIES])))
    return out


def put_back(features: NDArray, placement: Placement) -> FloatArray:
    """Undo :func:`seen_from`."""
    out = np.array(features, float)
    out[..., POSITIONS] = _flat(placement.undo(_points(out[..., POSITIONS])))
    moves = turn_about_y(_points(out[..., VELOCITIES]), -placement.yaw)
    out[..., VELOCITIES] = _flat(moves)
    return out


def _rise(share: NDArray) -> FloatArray:
    """Return a smooth step from 0 to 1 for shares from 0 to 1."""
    return share * share * (3 - 2 * share)


def _points(flat: NDArray) -> FloatArray:
    return flat.reshape(*flat.shape[:-1], POINTS, 3)


def _flat(points: NDArray) -> FloatArray:
    return points.reshape(*points.shape[:-2], 3 * POINTS)
