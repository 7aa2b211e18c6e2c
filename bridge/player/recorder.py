"""Keeps what a performance's summary is made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bridge.plan import Part
from bridge.player.telemetry import Performance, Tracking, track
from bridge.servo.state import ServoState
from robots.skeleton import FloatArray

LATE_SHARE = 0.25
"""Share of a period after which a tick counts as late."""


class Recorder:
    """Collects the ticks of the dance itself."""

    def __init__(self, people: Sequence[str], parts: Sequence[Part], rate: float) -> None:
        """Start empty."""
        self._people = tuple(people)
        self._parts = tuple(parts)
        self._rate = rate
        self._times: list[float] = []
        self._late: list[float] = []
        self._skew: list[float] = []
        self._dropped = 0
        self._goal: list[list[FloatArray]] = [[] for _ in parts]
        self._present: list[list[FloatArray]] = [[] for _ in parts]

    def drop(self, count: int) -> None:
        """Note ticks that were left out."""
        self._dropped += count

    def tick(
        self,
        time: float,
        late: float,
        skew: float,
        goals: Sequence[FloatArray],
        states: Sequence[ServoState],
    ) -> None:
        """Note a tick: when, how late it began and how far apart the robots were told (s)."""
        self._times.append(time)
        self._late.append(late)
        self._skew.append(skew)
        for index, (goal, state) in enumerate(zip(goals, states, strict=True)):
            self._goal[index].append(goal)
            self._present[index].append(state.position)

    def performance(self, outcome: str) -> Performance:
        """Return the summary."""
        times = np.array(self._times)
        tracking: dict[str, Tracking] = {}
        for index, (person, part) in enumerate(zip(self._people, self._parts, strict=True)):
            shape = (-1, len(part.robot.joints))
            goal = np.array(self._goal[index]).reshape(shape)
            present = np.array(self._present[index]).reshape(shape)
            robot = part.robot
            tracking[person] = track(robot.name, robot.joint_names, times, goal, present)
        return Performance(
            completed=outcome == "completed",
            outcome=outcome,
            duration=float(times[-1] - times[0]) if len(times) else 0.0,
            rate=self._rate,
            ticks=len(times),
            late_ticks=int((np.array(self._late) > LATE_SHARE / self._rate).sum()),
            dropped_ticks=self._dropped,
            jitter_p99_ms=_p99(self._late),
            skew_p99_ms=_p99(self._skew),
            tracking=tracking,
        )


def _p99(values: Sequence[float]) -> float:
    return float(np.percentile(values, 99)) * 1e3 if len(values) else 0.0
