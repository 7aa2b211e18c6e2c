"""People whose bodies overlap step apart.

Trunks and legs are capsules. By as much as the deepest overlap of a moment exceeds what is
tolerated, the two people are moved apart along the floor, half each, away from each other's
pelvises. The course over time is an upper envelope of the overlaps, wide enough that nobody is
jolted. Arms are left out: they may embrace.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from generator.choreographer.clearance import LEGS, TRUNK, clearances
from generator.finishing.figure import Figure
from generator.io.plausible import stature
from robots.skeleton import FloatArray

TOLERATED = 0.015
"""Depth of an overlap that is left alone, m: flesh gives way."""

_MOST = 0.25
"""Farthest that each person is moved, m."""
_AROUND = 0.3
"""Time to either side over which a push is spread, s."""
_INSIDE = 0.03
"""Distance of pelvises below which people are pushed less, m."""
_STATURE = 1.70


def overlap(figures: tuple[Figure, Figure]) -> FloatArray:
    """Return the deepest overlap of trunks and legs ``[T]`` m; negative is room between them."""
    a, b = ((f.skeleton, f.points, stature(f.points) / _STATURE) for f in figures)
    gaps = clearances((a, b), TRUNK + LEGS)
    return -np.min(list(gaps.values()), axis=0)


def push_apart(figures: tuple[Figure, Figure], fps: float) -> dict[str, float]:
    """Move two people apart where they overlap, and say by how much."""
    depth = overlap(figures)
    push = np.clip(depth - TOLERATED, 0.0, 2 * _MOST)
    if not push.any():
        return {"overlap": float(depth.max()), "pushed": 0.0}
    size = 2 * round(_AROUND * fps) + 1
    push = maximum_filter1d(push, size, mode="nearest")
    push = gaussian_filter1d(push, 0.4 * _AROUND * fps, radius=size // 2, mode="nearest")
    between = (figures[1].point("pelvis") - figures[0].point("pelvis")) * (1.0, 1.0, 0.0)
    between = gaussian_filter1d(between, _AROUND * fps, axis=0, mode="nearest")
    # Where one stands in the other there is no direction, and beside it each in turn.
    between /= np.sqrt((between**2).sum(axis=1, keepdims=True) + _INSIDE**2)
    figures[0].shift(-0.5 * push[:, None] * between)
    figures[1].shift(0.5 * push[:, None] * between)
    return {"overlap": float(depth.max()), "pushed": float(0.5 * push.max())}
