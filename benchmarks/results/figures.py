"""How bodily one motion is: bones, feet, floor, partner, hands that meet, roughness."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.results.spectra import velocity_power
from generator.choreographer.clearance import clearances
from generator.choreographer.role import Build
from generator.motion import CONTACT_POINTS, DuetMotion, Motion
from robots.skeleton import FloatArray
from sim.metrics.smoothness import bone_deviation, jerk

Touch = tuple[str, str, float]
"""A point of person a, one of person b, and how far apart they are meant to be, m."""
Figures = dict[str, float | None]

LOW = 0.015
"""A toe that is no higher above its lowest level is taken to stand, m."""
LOWEST = 5
"""Percentile of a toe's heights that counts as its lowest level."""
DEEP = 0.02
"""Overlap of two bodies that shows, m."""
MET = 0.05
"""Miss up to which hands count as having met, m."""
_OTHER = {"left": "right", "right": "left"}


def measured(motion: DuetMotion, touches: Sequence[Touch]) -> tuple[Figures, FloatArray]:
    """Return the figures of a motion and the spectrum of its velocities.

    Args:
        motion: Two people.
        touches: Which hands are meant to meet.
    """
    points = motion.keypoints
    depth = overlap(motion)
    found: Figures = {
        "bones": float(bone_deviation(points, motion.a.skeleton.parents).mean()),
        "skate_labelled": _mean([labelled_skate(person) for person in motion.people]),
        "skate_low": _mean([low_skate(person) for person in motion.people]),
        "jerk": float(jerk(points, motion.fps).mean()),
        "speed": float(np.linalg.norm(np.diff(points, axis=0), axis=-1).mean() * motion.fps),
        "sunk": float(np.maximum(-points[..., 2].min(axis=(1, 2)), 0).mean()),
        "overlap": float(np.maximum(depth, 0).mean()),
        "overlapping": float((depth > DEEP).mean()),
        "missed": missed(motion, touches),
    }
    return found, velocity_power(points, motion.fps)


def labelled_skate(person: Motion) -> float | None:
    """Return the mean level speed of heels and toes while they are labelled as standing, m/s."""
    if person.foot_contacts is None:
        return None
    paths = np.stack([person.point(name) for name in CONTACT_POINTS], axis=1)
    return _slide(paths, person.foot_contacts, person.fps)


def low_skate(person: Motion) -> float | None:
    """Return the mean level speed of toes while they are low, whatever the labels say, m/s."""
    paths = np.stack([person.point(name) for name in CONTACT_POINTS if "foot" in name], axis=1)
    level = np.percentile(paths[..., 2], LOWEST, axis=0)
    return _slide(paths, paths[..., 2] < level + LOW, person.fps)


def _slide(paths: FloatArray, down: NDArray[np.bool_], fps: float) -> float | None:
    stays = down[1:] & down[:-1]
    speed = np.linalg.norm(np.diff(paths[..., :2], axis=0), axis=-1) * fps
    return float(speed[stays].mean()) if stays.any() else None


def overlap(motion: DuetMotion) -> FloatArray:
    """Return how deep the two bodies are in each other ``[N]`` m, some 15 times a second.

    Bodies are capsules about the keypoints (:mod:`generator.choreographer.clearance`); negative is
    room.
    """
    every = max(1, round(motion.fps / 15))
    a, b = ((p.skeleton, p.keypoints[::every], Build.of(p.skeleton).scale) for p in motion.people)
    return -np.min(list(clearances((a, b)).values()), axis=0)


def missed(motion: DuetMotion, touches: Sequence[Touch]) -> float | None:
    """Return by how much hands that should meet miss each other at their best, m.

    Of several pairs of hands the worst counts. Which hand is used is not judged here: a motion in
    the mirror has met too. ``None`` if no hands are meant to meet.
    """
    if not touches:
        return None
    mirrored = [(_mirrored(a), _mirrored(b), gap) for a, b, gap in touches]
    return min(max(_miss(motion, touch) for touch in way) for way in (touches, mirrored))


def _miss(motion: DuetMotion, touch: Touch) -> float:
    """Return the miss at the best moment; between frames, hands are taken to move straight."""
    between = motion.a.point(touch[0]) - motion.b.point(touch[1])
    nearest = min(_nearest(one, other) for one, other in pairwise(between))
    return max(nearest - touch[2], 0.0)


def _nearest(one: FloatArray, other: FloatArray) -> float:
    """Return the distance of the segment between two points from the origin."""
    along = other - one
    length = float(along @ along)
    share = 0.0 if length == 0 else min(max(-float(one @ along) / length, 0.0), 1.0)
    return float(np.linalg.norm(one + share * along))


def _mirrored(point: str) -> str:
    side, _, rest = point.partition("_")
    return f"{_OTHER[side]}_{rest}"


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
