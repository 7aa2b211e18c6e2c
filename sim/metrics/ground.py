"""Feet and floor: penetration, floating, skating, and who is down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from robots.skeleton import FloatArray, Skeleton

TOE_HEIGHT = 0.05
"""Height of the toe keypoint, m, below which a foot counts as on the floor."""
SOLE_HEIGHT = 0.01
"""Height of a sole corner, m, below which it counts as on the floor."""
SKATE_SPEED = 0.5
"""Horizontal speed, m/s, from which a foot on the floor skates."""
SKATE_WINDOW = 0.17
"""Time, s, over which the speed must be that high on average too (5 frames at 30 per second)."""


def floor_penetration(lowest: NDArray) -> FloatArray:
    """Return how deep the lowest point of each body is below the floor ``[N, 2]`` m.

    ``max(0, -z_min)``. Y. Yuan et al., "PhysDiff", ICCV 2023, "Penetrate" (there averaged, with
    5 mm of tolerance).

    Args:
        lowest: ``[N, 2]`` m, height of the lowest point of each body.
    """
    return np.maximum(-lowest, 0.0)


def floating(lowest: NDArray) -> FloatArray:
    """Return how high the lowest point of each body is above the floor ``[N, 2]`` m.

    ``max(0, z_min)``. PhysDiff's "Float". A jump floats too; a floating crowd does so all the time.
    """
    return np.maximum(lowest, 0.0)


def skating(toes: NDArray, rate: float) -> NDArray[np.bool_]:
    """Return in which moments ``[N, 2]`` a foot skates, by its toe keypoint.

    The keypoint is below :data:`TOE_HEIGHT` at both ends of the step and moves horizontally faster
    than :data:`SKATE_SPEED`, in the step and on average over :data:`SKATE_WINDOW`. Karunratanakul
    et al., "Guided Motion Diffusion", ICCV 2023, and InterControl, NeurIPS 2024. Feet that swing
    low count too, so this is for comparison with the literature; :func:`sliding` decides.

    Args:
        toes: ``[N, 2, 2, 3]`` m: person, left and right.
        rate: Moments per second.
    """
    speed, low = _steps(toes, rate, TOE_HEIGHT)
    mean = uniform_filter1d(speed, max(1, round(SKATE_WINDOW * rate)), axis=0, mode="nearest")
    skates = low & (speed > SKATE_SPEED) & (mean > SKATE_SPEED)
    return skates[..., 0] | skates[..., 1]


def sliding(soles: NDArray, rate: float) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return in which moments ``[N, 2]`` a sole slides, and how fast soles on the floor move.

    A sole corner is below :data:`SOLE_HEIGHT` at both ends of the step; it slides if it moves
    horizontally faster than :data:`SKATE_SPEED`. The second result ``[N, 2]`` m/s is the mean speed
    of such corners, 0 with none: Kimodo's "foot skate from height" (NVIDIA, 2026) for soles.

    Args:
        soles: ``[N, 2, C, 3]`` m: person, sole corners.
        rate: Moments per second.
    """
    speed, low = _steps(soles, rate, SOLE_HEIGHT)
    mean = (speed * low).sum(axis=-1) / np.maximum(low.sum(axis=-1), 1)
    slides: NDArray[np.bool_] = (low & (speed > SKATE_SPEED)).sum(axis=-1) > 0
    return slides, mean


def _steps(points: NDArray, rate: float, height: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return speed and being low ``[N, 2, P]``; the last moment repeats the one before."""
    speed = np.linalg.norm(np.diff(points[..., :2], axis=0), axis=-1) * rate
    low = points[..., 2] < height
    both = low[1:] & low[:-1]
    return np.concatenate([speed, speed[-1:]]), np.concatenate([both, both[-1:]])


def pelvis_height(keypoints: NDArray, skeletons: tuple[Skeleton, Skeleton]) -> FloatArray:
    """Return the height of each pelvis ``[N, 2]`` as a share of that when standing upright.

    Standing height is that of the rest pose above its toes. Deep squats reach about 0.35, sitting
    on or lying on the floor 0.1 to 0.2: not what a standing puppet can perform.
    """
    out = np.empty(keypoints.shape[:2])
    for p, skeleton in enumerate(skeletons):
        height, j = 0.0, skeleton.index("left_foot")
        while j > 0:
            height -= float(skeleton.offsets[j, 2])
            j = skeleton.parents[j]
        out[:, p] = keypoints[:, p, 0, 2] / max(height, 1e-6)
    return out
