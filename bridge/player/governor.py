"""The last word on every goal: how far it may be from the one before, and from the joint.

**The problem.** A trajectory is checked as a whole before it is played, but servos are told single
goals, and between the two lie dropped ticks, a dance that begins at full speed, a stop, a return
after a fault, a hand that holds an arm. So what is about to be sent is bounded once more, tick by
tick, in this order:

1. position: the joint's range;
2. velocity: the joint's no-load speed, over at most two periods, however long nothing was sent;
3. acceleration: the no-load speed within :attr:`acceleration_time`;
4. distance from where the joint was last seen.

A trajectory within its limits passes unchanged. One that was held back is caught up with: the goal
moves relative to the path no faster than it can still be braked, so that it arrives without
swinging over. With a lag ``e``, a period ``h`` and an acceleration ``A``::

    relative speed = e / h                    if e <= A h^2: there in one tick, at rest in the next
                     sqrt(2 A e) - A h / 2    else: falls by A h in each tick

Worked example: h 0.02 s, A 50 rad/s^2. A lag of 0.01 rad is made up at 0.5 rad/s, in one tick; one
of 0.5 rad at 6.6 rad/s at first (if the joint is that fast), and ever slower towards its end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray
from robots.spec import RobotSpec

PERIODS = 2.0
"""Periods that one goal may make up for at most."""


class Governor:
    """Bounds the goals of one robot; arrays follow its joints."""

    def __init__(
        self, robot: RobotSpec, *, period: float, acceleration_time: float, reach: float
    ) -> None:
        """Take the limits; :meth:`start` before the first :meth:`bound`.

        Args:
            robot: Gives ranges and speeds.
            period: Time between two goals, s.
            acceleration_time: In which a joint may reach its no-load speed, s.
            reach: How far a goal may be from where the joint was seen, rad.
        """
        self._lower, self._upper = robot.lower, robot.upper
        self._fastest = robot.max_velocity
        self._acceleration = robot.max_velocity / acceleration_time
        self._period = period
        self._reach = reach
        self.start(robot.rest)

    def start(self, goal: FloatArray) -> None:
        """Begin anew, at rest at a goal ``[D]`` rad."""
        self._asked = self._told = goal.copy()
        self._velocity = np.zeros_like(goal)
        self.held_back: NDArray[np.bool_] = np.zeros(len(goal), bool)
        """``[D]`` which joints were last told something else than was asked."""

    def bound(self, asked: FloatArray, present: FloatArray, elapsed: float) -> FloatArray:
        """Return what may be sent ``[D]`` rad.

        Args:
            asked: ``[D]`` rad.
            present: ``[D]`` rad, where the joints were last seen; NaN if that is not known.
            elapsed: Time since the last goal, s.
        """
        h = min(max(elapsed, self._period / 4), PERIODS * self._period)
        asked = np.clip(asked, self._lower, self._upper)
        lag = self._asked - self._told
        change = self._acceleration * h
        braked = np.sqrt(2 * self._acceleration * np.abs(lag)) - change / 2
        closing = np.where(np.abs(lag) <= change * h, np.abs(lag) / h, braked)
        path = (asked - self._asked) / max(elapsed, h)
        velocity = path + np.sign(lag) * closing
        velocity = np.clip(velocity, self._velocity - change, self._velocity + change)
        velocity = np.clip(velocity, -self._fastest, self._fastest)
        told = self._told + velocity * h
        near = np.where(np.isnan(present), told, present)
        told = np.clip(told, near - self._reach, near + self._reach)
        told = np.clip(told, self._lower, self._upper)
        self._velocity = np.clip((told - self._told) / h, -self._fastest, self._fastest)
        self._asked, self._told = asked, told
        self.held_back = np.abs(told - asked) > 1e-6
        return told
