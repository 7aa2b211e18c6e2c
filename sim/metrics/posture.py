"""Whether a body is bent as far as no body bends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.ranges import RANGES, bones_at
from robots.skeleton import FloatArray, Skeleton


def bend_excess(keypoints: NDArray, skeleton: Skeleton) -> FloatArray:
    """Return by how much the joint that is bent worst is beyond its range, degrees.

    Args:
        keypoints: ``[..., J, 3]`` m.
        skeleton: Names and parents of the keypoints.

    Returns:
        ``[...]``, 0 where all are within :data:`robots.ranges.RANGES`.
    """
    excess = np.zeros(keypoints.shape[:-2])
    for name, (_, most) in RANGES.items():
        *_, angle = bones_at(keypoints, skeleton, name)
        excess = np.maximum(excess, angle - most)
    return excess
