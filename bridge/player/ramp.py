"""The soft way from where a robot stands to where it shall be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robots.skeleton import FloatArray

PEAK = 1.875
"""Peak speed of a minimum-jerk move of distance 1 in time 1 (at half time)."""


@dataclass(frozen=True, slots=True, eq=False)
class Ramp:
    """A minimum-jerk move: starts and ends at rest, without a jump in acceleration."""

    start: FloatArray
    """``[D]`` rad."""
    end: FloatArray
    """``[D]`` rad."""
    duration: float
    """s."""

    def at(self, time: float) -> FloatArray:
        """Return the positions ``[D]`` rad at ``time`` s, held at both ends."""
        u = float(np.clip(time / self.duration, 0.0, 1.0)) if self.duration > 0 else 1.0
        share = u**3 * (10 + u * (6 * u - 15))
        return self.start + (self.end - self.start) * share


def ramp_time(start: FloatArray, end: FloatArray, max_velocity: FloatArray, least: float) -> float:
    """Return how long a :class:`Ramp` must take so that no joint exceeds its speed, s.

    Args:
        start: ``[D]`` rad.
        end: ``[D]`` rad.
        max_velocity: ``[D]`` rad/s.
        least: Shortest time, s.
    """
    return max(least, float((PEAK * np.abs(end - start) / max_velocity).max()))
