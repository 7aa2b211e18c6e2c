"""Other frame rates by splines.

Roots follow cubic splines. Rotations follow cubic splines of their quaternions, drawn back to unit
length: as multiplying by a quaternion turns the space of quaternions rigidly, the curve depends
neither on the world's axes nor on those of the rest pose, and it has continuous acceleration. A
spline of accumulated rotation vectors would have that, too, at ten times the cost.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from generator.kinematics import continuous
from robots.skeleton import FloatArray


def resample(values: NDArray, fps: float, new: float) -> FloatArray:
    """Return ``[N, ...]`` at another frame rate, from ``[T, ...]``; the first frame stays.

    Args:
        values: Time along the first axis, two frames or more.
        fps: Frames per second of ``values``.
        new: Frames per second of the result; lower ones are low-passed before.
    """
    values = np.asarray(values, dtype=float)
    if fps == new:
        return values.copy()
    if new < fps:
        width = 0.5 * np.sqrt((fps / new) ** 2 - 1)
        values = gaussian_filter1d(values, width, axis=0, mode="nearest")
    at = moments(len(values), fps, new)
    return CubicSpline(np.arange(len(values)) / fps, values)(at)


def resample_rotations(rotations: NDArray, fps: float, new: float) -> FloatArray:
    """Return quaternions ``[N, J, 4]`` at another frame rate, from ``[T, J, 4]``."""
    out = resample(continuous(rotations), fps, new)
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def resample_labels(labels: NDArray, fps: float, new: float) -> NDArray[np.bool_]:
    """Return labels ``[N, ...]`` at another frame rate: those of the nearest frame."""
    nearest = np.round(moments(len(labels), fps, new) * fps).astype(int)
    return np.asarray(labels, dtype=bool)[np.minimum(nearest, len(labels) - 1)]


def moments(frames: int, fps: float, new: float) -> FloatArray:
    """Return the times ``[N]`` s of frames at a new rate that lie within the old ones."""
    return np.arange(max(2, int((frames - 1) / fps * new + 1e-6) + 1)) / new
