"""A smooth way through the samples of a trajectory that keeps a robot's limits.

**The problem.** A trajectory has 30 samples a second; the player sends goals more often, and at
other times. On straight lines between the samples the speed jumps at each of them, which a servo
answers with a jerk. A cubic spline has none, but it swings over: past a joint's limit where
a sample lies on it, and beyond its speed where the samples just allow it.

So the slopes of the spline are corrected, which is enough: between two samples a cubic is a Bézier
curve, and a curve stays within the hull of its control points (as does its speed). With samples p0,
p1 a time h apart, slopes m0, m1 and the chord's slope c::

    position   p0,  p0 + h m0 / 3,  p1 - h m1 / 3,  p1     within the joint's range
    speed      m0,  3 c - m0 - m1,  m1                     within the joint's speed

1. Each slope is clipped until the position's control points are within the range, on both sides of
   the sample. On a limit that leaves slope 0. The speed stays continuous.
2. Where the speed's control points are still too large, both slopes are drawn towards the chord's,
   as far as needed: there alone the speed may jump, and less than on straight lines.

Worked example: samples 0, 1, 1 at 0, 1, 2 s, upper limit 1. The spline arrives at the second sample
with slope 0.5 and would rise to 1.125 before it returns; with slope 0 it stays at 1.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from bridge.trajectory import JointTrajectory
from robots.skeleton import FloatArray


class SmoothPath:
    """A trajectory as a function of time: C2 where no limit is near, within limits everywhere."""

    def __init__(
        self,
        trajectory: JointTrajectory,
        *,
        lower: FloatArray,
        upper: FloatArray,
        max_velocity: FloatArray,
    ) -> None:
        """Compute the slopes.

        Args:
            trajectory: ``N`` samples of ``D`` joints, themselves within the limits.
            lower: ``[D]`` rad.
            upper: ``[D]`` rad.
            max_velocity: ``[D]`` rad/s, in the time of the trajectory.
        """
        times, position = trajectory.times, trajectory.position
        self._times, self._position = times, position
        step = np.diff(times)[:, None]
        chord = np.diff(position, axis=0) / step
        slope = np.clip(CubicSpline(times, position)(times, 1), -max_velocity, max_velocity)
        # Samples may lie outside by what rounding in files costs: then 0 is what is left.
        above = np.maximum(upper - position, 0.0) * 3
        below = np.maximum(position - lower, 0.0) * 3
        rise, fall = np.full_like(slope, np.inf), np.full_like(slope, np.inf)
        rise[:-1], fall[:-1] = above[:-1] / step, below[:-1] / step
        rise[1:] = np.minimum(rise[1:], below[1:] / step)
        fall[1:] = np.minimum(fall[1:], above[1:] / step)
        slope = np.clip(slope, -fall, rise)

        first, last = slope[:-1] - chord, slope[1:] - chord
        share = np.ones_like(chord)
        for excess in (first, -first - last, last):
            room = np.maximum(max_velocity - np.sign(excess) * chord, 0.0)
            over = np.abs(excess) > room
            share[over] = np.minimum(share[over], room[over] / np.abs(excess[over]))
        self._first = (chord + share * first) * step
        self._last = (chord + share * last) * step

    def at(self, time: float) -> FloatArray:
        """Return the positions ``[D]`` rad at ``time`` s, held at both ends."""
        i = int(np.searchsorted(self._times, time, side="right")) - 1
        i = min(max(i, 0), len(self._times) - 2)
        u = (time - self._times[i]) / (self._times[i + 1] - self._times[i])
        u = min(max(float(u), 0.0), 1.0)
        v = 1.0 - u
        return (
            self._position[i] * (v * v * (1 + 2 * u))
            + self._first[i] * (v * v * u)
            - self._last[i] * (u * u * v)
            + self._position[i + 1] * (u * u * (1 + 2 * v))
        )
