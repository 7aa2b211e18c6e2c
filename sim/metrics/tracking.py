"""How far a simulated motion is from its reference."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray

FRAME = 1 / 30
"""The frame, s, in which accelerations per frame are given whatever the rate."""


def mpjpe(keypoints: NDArray, reference: NDArray) -> FloatArray:
    """Return the mean per-keypoint position error ``[N, 2]`` m, global.

    ``mean_j |x_j - r_j|``. Ionescu et al., "Human3.6M", TPAMI 2014; global as in Luo et al., "PHC",
    ICCV 2023.

    Args:
        keypoints: ``[N, 2, J, 3]`` m, simulated.
        reference: ``[N, 2, J, 3]`` m.
    """
    return np.linalg.norm(keypoints - reference, axis=-1).mean(axis=-1)


def mpjpe_root(keypoints: NDArray, reference: NDArray) -> FloatArray:
    """Return the mean per-keypoint position error ``[N, 2]`` m with the pelvises put together.

    ``mean_j |(x_j - x_0) - (r_j - r_0)|``; translation is taken out, rotation is not.
    """
    return mpjpe(keypoints - keypoints[:, :, :1], reference - reference[:, :, :1])


def acceleration_error(keypoints: NDArray, reference: NDArray, rate: float) -> FloatArray:
    """Return the mean error of keypoint accelerations ``[N, 2]``, m per frame squared of 1/30 s.

    ``mean_j |x''_j - r''_j|`` with second differences over about 1/30 s, as Luo et al., "PHC", ICCV
    2023, report at 30 frames per second. The ends repeat their neighbours. Zero for fewer than
    three samples at that distance.
    """
    stride = max(1, round(rate * FRAME))
    per_frame = (FRAME * rate / stride) ** 2
    difference = keypoints - reference
    out = np.zeros(difference.shape[:2])
    if len(difference) <= 2 * stride:
        return out
    second = difference[2 * stride :] - 2 * difference[stride:-stride] + difference[: -2 * stride]
    size = np.linalg.norm(second, axis=-1).mean(axis=-1) * per_frame
    out[stride:-stride] = size
    out[:stride], out[-stride:] = size[0], size[-1]
    return out
