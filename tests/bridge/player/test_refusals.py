"""What the player refuses before it opens anything."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.player import PlayerSettings, Verdict
from bridge.ports import VIRTUAL, ports_of
from bridge.trajectory import JointTrajectory
from robots.errors import (
    DuetError,
    GateRefused,
    LimitViolation,
    SpecError,
)
from tests.bridge.player.stage import BRISK, DANCES, ROBOTS, Stage


def refused(error: type[DuetError], match: str, trajectories=DANCES, **options) -> None:
    stage = Stage()
    with pytest.raises(error, match=match):
        stage.play(trajectories, **options)
    assert [wire.instructions for wire in stage.wires] == [0, 0]
    assert stage.open_ports == 0


def changed(index: int, row: int, column: int, value: float):
    position = DANCES[index].position.copy()
    position[row, column] = value
    trajectories = list(DANCES)
    trajectories[index] = dataclasses.replace(DANCES[index], position=position)
    return trajectories


@pytest.mark.parametrize("row", [0, 30, -1])
def test_a_goal_outside_the_limits_is_refused_with_joint_time_and_limit(row):
    name = ROBOTS[1].joint_names[3]
    when = DANCES[1].times[row]
    beyond = changed(1, row, 3, ROBOTS[1].upper[3] + 0.01)
    refused(LimitViolation, rf"{name}.*at {when:.3f} s", beyond)


def test_a_trajectory_too_fast_for_a_joint_is_refused_but_plays_slower():
    step = ROBOTS[0].max_velocity[2] * 0.02 * 1.5
    before = DANCES[0].position[30, 2]
    fast = changed(0, 31, 2, before + step)
    refused(LimitViolation, rf"{ROBOTS[0].joint_names[2]}.*rad/s", fast)
    slow = dataclasses.replace(BRISK, speed=0.3)
    assert Stage().play(fast, settings=slow).completed


@given(row=st.integers(0, 50), column=st.integers(0, 19), bad=st.sampled_from([np.nan, np.inf]))
@settings(max_examples=20, deadline=None)
def test_a_goal_that_is_not_finite_cannot_even_be_a_trajectory(row, column, bad):
    with pytest.raises(LimitViolation, match=ROBOTS[0].joint_names[column]):
        changed(0, row, column, bad)


def test_a_trajectory_for_another_robot_is_refused():
    refused(LimitViolation, "is for 'marionette'", (DANCES[1], DANCES[1]))


def test_missing_and_unknown_joints_are_named():
    short = JointTrajectory(
        DANCES[0].times, DANCES[0].position[:, 1:], DANCES[0].joint_names[1:], "op3"
    )
    refused(LimitViolation, ROBOTS[0].joint_names[0], (short, DANCES[1]))
    names = ("r_sho_pich", *DANCES[0].joint_names[1:])
    odd = dataclasses.replace(DANCES[0], joint_names=names)
    refused(LimitViolation, "did you mean 'r_sho_pitch'", (odd, DANCES[1]))


def test_a_failed_report_is_refused_unless_forced_on_virtual_ports():
    failed = Verdict(passed=False)
    refused(GateRefused, "did not pass", gate=failed)
    refused(
        GateRefused,
        "did not pass",
        gate=failed,
        force=True,
        arm=True,
        ports=("/dev/ttyUSB0", VIRTUAL),
    )
    assert Stage().play(gate=failed, force=True).completed


def test_real_ports_need_to_be_armed():
    refused(GateRefused, "--arm", ports=("/dev/ttyUSB0", "/dev/ttyUSB1"))
    refused(SpecError, "one port", ports=("/dev/ttyUSB0", "/dev/ttyUSB0"), arm=True)


def test_ports_are_given_by_bus():
    robot = ROBOTS[0]
    assert ports_of(robot, "/dev/x") == {"main": "/dev/x"}
    assert ports_of(robot, {"main": "/dev/y"}) == {"main": "/dev/y"}
    with pytest.raises(SpecError, match="main"):
        ports_of(robot, {"mian": "/dev/y"})
    with pytest.raises(SpecError, match="main"):
        ports_of(robot, {})


@pytest.mark.parametrize("bad", [{"speed": 0.0}, {"rate": 0.0}, {"watchdog": 3.0}])
def test_settings_outside_their_ranges_are_refused(bad):
    with pytest.raises(SpecError, match=next(iter(bad))):
        PlayerSettings(**bad)


def test_robots_that_would_collide_are_refused_on_real_ports_alone():
    deep = Verdict(passed=True, overlap_mm=14.5)
    refused(GateRefused, "14 mm deep", gate=deep, arm=True, ports=("/dev/ttyUSB0", "/dev/ttyUSB1"))
    assert Stage().play(gate=deep).completed
