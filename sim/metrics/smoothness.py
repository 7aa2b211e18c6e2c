"""Whether keypoints move as bodies do: speed, jerk, bones of constant length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray


def speed(keypoints: NDArray, rate: float) -> FloatArray:
    """Return the speed of the fastest keypoint ``[N, 2]`` m/s between neighbouring moments.

    ``max_j |x_j(t+1) - x_j(t)| rate``. A sprinter's foot reaches about 20 m/s and a boxer's fist
    10 m/s; one metre between frames at 30 per second, a teleport, is 30 m/s.
    """
    steps = np.linalg.norm(np.diff(keypoints, axis=0), axis=-1).max(axis=-1) * rate
    return np.concatenate([steps, steps[-1:]])


def jerk(keypoints: NDArray, rate: float) -> FloatArray:
    """Return the mean size of keypoint jerk ``[N, 2]`` m/s3.

    ``mean_j |x'''_j|`` by third differences. T. Flash and N. Hogan, "The coordination of arm
    movements", J. Neuroscience 5(7), 1985, for jerk as the measure of smoothness. Zero for fewer
    than four moments.
    """
    out = np.zeros(keypoints.shape[:2])
    if len(keypoints) > 3:
        third = np.linalg.norm(np.diff(keypoints, 3, axis=0), axis=-1).mean(axis=-1) * rate**3
        out[1:-2] = third
        out[0], out[-2:] = third[0], third[-1]
    return out


def bone_deviation(keypoints: NDArray, parents: Sequence[int]) -> FloatArray:
    """Return the largest deviation of a bone from its median length ``[N, 2]``, as a share.

    ``max_j |l_j(t) - m_j| / max(m_j, 5 cm)`` with ``m_j`` the median over time; the floor is for
    bones that some skeletons have at length 0. A body's bones keep their lengths; networks that put
    out positions do not know that.
    """
    child = np.arange(1, len(parents))
    lengths = np.linalg.norm(keypoints[:, :, child] - keypoints[:, :, list(parents[1:])], axis=-1)
    median = np.median(lengths, axis=0)
    return (np.abs(lengths - median) / np.maximum(median, 0.05)).max(axis=-1)
