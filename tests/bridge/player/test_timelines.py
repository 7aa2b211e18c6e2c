"""Random timelines of faults against the player: 20 of 500, other ones every day.

All of them: ``python -m tests.bridge.player.timelines 0 500`` (a quarter of an hour of CPU time);
one of them again, with its faults named: the same with its number alone.
"""

from __future__ import annotations

import datetime
import itertools
import math

import pytest

from bridge.player.governor import Governor
from bridge.player.link import Link
from bridge.player.performer import Performer
from bridge.servo.bus import ServoBus
from bridge.virtual.faults import KINDS
from tests.bridge.player.stage import ROBOTS
from tests.bridge.player.timelines import (
    SECONDS,
    PatientClock,
    Timeline,
    Violation,
    perform,
    timeline,
)

ALL, DAILY = 500, 20
TODAY = datetime.datetime.now(datetime.UTC).toordinal() * DAILY
QUIET = Timeline(0, ((), ()), (), (0.0, 0.0))
BRIEF = 0.5
"""Length of the dance where the point is to be found out, s."""


@pytest.mark.slow
@pytest.mark.parametrize("seed", [(TODAY + k) % ALL for k in range(DAILY)])
def test_whatever_goes_wrong_ends_safely(seed):
    """No goal beyond limits, no leap, no stale goal under torque, a stated end, and an end at all.

    Only our own errors may come out, or a summary.
    """
    outcome = perform(timeline(seed))
    assert outcome.ending
    assert outcome.told or outcome.ending in ("completed", "stopped")


def test_the_timelines_cover_every_kind_of_fault():
    plans = [timeline(seed) for seed in range(ALL)]
    faults = [fault for plan in plans for faults in plan.faults for fault in faults]
    assert {fault.kind for fault in faults} == set(KINDS)
    assert all(0.0 <= fault.start <= SECONDS for fault in faults)
    assert sum(1 for plan in plans if plan.stops) > 50
    assert sum(1 for plan in plans if plan.stall[1]) > 50


def test_a_timeline_is_the_same_whenever_it_is_played():
    assert timeline(7) == timeline(7)
    assert timeline(7) != timeline(8)


def test_nothing_is_found_where_nothing_is_wrong():
    assert perform(QUIET, BRIEF).ending == "completed"


def test_a_stale_goal_under_torque_is_found(monkeypatch):
    """A player that takes the goals that it finds in the servos."""
    monkeypatch.setattr(ServoBus, "hold_present", ServoBus.standing)
    with pytest.raises(Violation, match="torque came on"):
        perform(QUIET, BRIEF)


def test_a_leap_is_found(monkeypatch):
    calls = itertools.count()
    inside = ROBOTS[0].rest, ROBOTS[1].rest

    def leaping(self: Governor, asked, present, elapsed):
        (rest,) = (pose for pose in inside if len(pose) == len(asked))
        return asked if next(calls) != 100 else rest + 0.5 * (asked - rest)

    monkeypatch.setattr(Governor, "bound", leaping)
    with pytest.raises(Violation, match="leap"):
        perform(QUIET, BRIEF)


def test_a_goal_beyond_limits_is_found(monkeypatch):
    write = ServoBus.write_goals
    monkeypatch.setattr(ServoBus, "write_goals", lambda self, goal: write(self, goal + math.pi))
    with pytest.raises(Violation, match="beyond limits"):
        perform(QUIET, BRIEF)


def test_torque_that_is_left_on_is_found(monkeypatch):
    monkeypatch.setattr(Link, "relax", lambda self: [])
    with pytest.raises(Violation, match="keeps its torque"):
        perform(QUIET, BRIEF)


def test_an_end_that_never_comes_is_found(monkeypatch):
    def waiting(self: Performer) -> None:
        while True:
            self.clock.sleep_until(self.clock.now() + 1.0)

    monkeypatch.setattr(Performer, "_soften", waiting)
    with pytest.raises(Violation, match="not at an end"):
        perform(QUIET, BRIEF)


def test_time_that_stands_still_is_found():
    clock = PatientClock()
    with pytest.raises(Violation, match="stands still"):
        list(iter(clock.now, 1.0))
