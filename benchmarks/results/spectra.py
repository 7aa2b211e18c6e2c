"""How fast and how rough movement is at each frequency: power of velocities and of jerks.

**The problem.** A mean of speed or jerk hides what eyes see: jitter is much power at high
frequencies, a network's blur is little of it at middle ones. So the velocities of all keypoints are
cut into windows of :data:`SECONDS`, and their power is summed in bands of frequency. Windows are as
long at every frame rate, so that the same frequencies are compared; what a rate cannot hold (half
of it and above) is not a number.

Example: at 7.5 frames a second a window has 16 frames and 8 frequencies, 0.47 to 3.75 Hz; at 30 it
has 64, of which the first 8 are the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray

SECONDS = 64 / 30
"""Length of a window, s."""
COUNT = 32
"""Frequencies, up to 15 Hz."""
FREQUENCIES: FloatArray = np.arange(1, COUNT + 1) / SECONDS
"""``[COUNT]`` Hz; the mean of a window is left out."""
BANDS = ((0.0, 1.0), (1.0, 2.0), (2.0, 3.75), (3.75, 7.5), (7.5, 15.0))
"""Hz; a frequency belongs to the band whose upper end it does not exceed."""


def velocity_power(keypoints: NDArray, fps: float) -> FloatArray:
    """Return the mean power ``[COUNT]`` of keypoint velocities at :data:`FREQUENCIES`, (m/s)².

    The sum over frequencies is the mean square of speed about its mean in a window. Windows are
    Hann's and overlap by half; mean over windows, people and keypoints, sum over the axes. NaN
    where the frame rate holds nothing, and everywhere if the motion is shorter than a window.

    Args:
        keypoints: ``[T, ..., 3]`` m.
        fps: Frames per second.
    """
    out = np.full(COUNT, np.nan)
    size = round(SECONDS * fps)
    velocity = np.diff(keypoints.reshape(len(keypoints), -1), axis=0) * fps
    if size < 4 or len(velocity) < size:
        return out
    window = np.hanning(size + 1)[:-1, None]
    starts = np.unique(np.linspace(0, len(velocity) - size, _windows(len(velocity), size)).round())
    power = np.zeros(size // 2)
    for start in starts.astype(int):
        part = velocity[start : start + size]
        spectrum = np.fft.rfft((part - part.mean(axis=0)) * window, axis=0)[1:]
        square = 2 * np.abs(spectrum) ** 2 / (size * (window**2).sum())
        square[-1] /= 2  # half the frame rate stands for itself alone
        power += square.sum(axis=1)
    points = velocity.shape[1] // 3
    known = min(size // 2, COUNT)
    out[:known] = power[:known] / (len(starts) * points)
    return out


def _windows(length: int, size: int) -> int:
    return 1 + max(0, -(-(length - size) // (size // 2)))


def jerk_power(velocity: NDArray) -> FloatArray:
    """Return the power of jerk, (m/s³)², from that of velocity: two derivatives are (2 pi f)²."""
    return velocity * (2 * np.pi * FREQUENCIES) ** 4


def in_bands(power: NDArray) -> FloatArray:
    """Return the root of the power ``[..., COUNT]`` summed in each of :data:`BANDS`."""
    sums = [
        power[..., (low < FREQUENCIES) & (high >= FREQUENCIES)].sum(axis=-1) for low, high in BANDS
    ]
    return np.sqrt(np.stack(sums, axis=-1))
