"""How much to smooth a person's motion, from the noise in it.

**The problem.** Half a degree of white noise per frame is invisible in a picture, and 15 rad/s2 at
30 frames per second: more than gravity asks of a leg. Smoothing all motions enough for that would
round off every punch and footfall of the clean ones. So the noise is measured, and the low-pass is
just long enough that what remains of it is a stated acceleration.

White noise of standard deviation ``sigma`` per frame at ``f`` frames per second, through a Gaussian
of ``s`` seconds, has the acceleration ``sigma / sqrt(f) * sqrt(3 / (8 sqrt(pi))) / s**2.5``; solved
for ``s``. Example: 0.42 degrees beyond what captured clips have, at 30 frames per second, for
0.8 rad/s2: 57 ms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

REMAINING = 0.8
"""Acceleration, rad/s2, that noise may keep."""
USUAL = np.radians(0.25)
"""Noise of a joint per frame, rad, up to which a clip counts as clean; captured ones have 0.1 to
0.23 degrees, most of it quick movement."""
LONGEST = 0.06
"""Longest low-pass, s: more would take the steps out of walking."""

_ORDER = 4
_GAIN = 70.0
"""Variance of the fourth difference of white noise of variance 1: sum of squared binomials."""


def noise_level(rotations: NDArray) -> float:
    """Return the standard deviation of the white noise per frame of a typical joint, rad.

    The fourth difference takes out what is smooth over five frames; a median over time does not
    mind the few frames in which people really jerk, and one over joints not the noisy few.

    Args:
        rotations: ``[T, J, 4]`` unit quaternions, sign-continuous.
    """
    if len(rotations) <= _ORDER:
        return 0.0
    # A quaternion moves by half the angle; the three directions off its own have noise alike.
    rough = 2 * np.diff(rotations, _ORDER, axis=0) / np.sqrt(_GAIN)
    spread = np.median(np.abs(rough), axis=0) / 0.6745
    return float(np.median(np.sqrt((spread**2).sum(axis=-1) / 3)))


def low_pass(rotations: NDArray, fps: float, least: float) -> float:
    """Return the standard deviation, s, of the Gaussian that suits a person's motion.

    Args:
        rotations: ``[T, J, 4]`` unit quaternions, sign-continuous.
        fps: Frames per second.
        least: What clean motions get, s.
    """
    noise = np.sqrt(max(noise_level(rotations) ** 2 - USUAL**2, 0.0))
    needed = (noise / np.sqrt(fps) * np.sqrt(3 / (8 * np.sqrt(np.pi))) / REMAINING) ** 0.4
    return float(max(least, min(needed, LONGEST)))
