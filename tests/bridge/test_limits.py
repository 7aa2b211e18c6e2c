"""No trajectory passes that leaves a joint's range or asks a servo for more speed than it has."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.plan import SLACK, Part
from bridge.trajectory import JointTrajectory
from robots.errors import LimitViolation
from robots.registry import load_robot
from robots.spec import RobotSpec


@cache
def robot() -> RobotSpec:
    return load_robot("marionette")


def still(count: int = 5, seconds: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(0, seconds, count), np.tile(robot().rest, (count, 1))


def made(times: np.ndarray, position: np.ndarray) -> JointTrajectory:
    return JointTrajectory(times, position, robot().joint_names, robot().name)


def test_standing_at_rest_and_at_every_limit_is_allowed() -> None:
    times, position = still()
    Part.of(made(times, position), robot())
    for ends in (robot().lower, robot().upper):
        Part.of(made(times, np.tile(ends, (5, 1))), robot())


@given(st.integers(0, 10), st.integers(0, 4), st.sampled_from([-1, 1]), st.floats(1e-4, 3))
@settings(max_examples=60, deadline=None)
def test_a_joint_beyond_its_range_is_named_with_time_and_range(
    column: int, row: int, side: int, by: float
) -> None:
    times, position = still(seconds=1000)
    joint = robot().joints[column]
    position[row, column] = (joint.upper if side > 0 else joint.lower) + side * by
    with pytest.raises(LimitViolation) as caught:
        Part.of(made(times, position), robot())
    text = str(caught.value)
    assert f"marionette: {joint.name}" in text
    assert f"{times[row]:.3f} s" in text
    assert f"{joint.lower:.4f} to {joint.upper:.4f} rad" in text


def test_rounding_is_no_violation() -> None:
    times, _ = still()
    position = np.tile(robot().upper + 0.5 * SLACK, (5, 1))
    Part.of(made(times, position), robot())


@given(st.floats(0.2, 3))
@settings(max_examples=40, deadline=None)
def test_speed_is_allowed_up_to_the_no_load_speed(share: float) -> None:
    if abs(share - 1) < 1e-3:
        return
    times, position = still()
    joint = robot().joint("waist")
    column = robot().joint_names.index("waist")
    position[1:, column] += 0.5
    times = np.concatenate([[0], 0.5 / (joint.max_velocity * share) + np.arange(4)])
    if share < 1:
        Part.of(made(times, position), robot())
    else:
        with pytest.raises(LimitViolation, match=r"marionette: waist.*rad/s"):
            Part.of(made(times, position), robot())


def test_playing_faster_counts_against_the_speed() -> None:
    times, position = still()
    joint = robot().joint("waist")
    position[1:, robot().joint_names.index("waist")] += 0.5
    times = np.concatenate([[0], 0.5 / (0.6 * joint.max_velocity) + np.arange(4)])
    Part.of(made(times, position), robot(), speed=1.6)
    with pytest.raises(LimitViolation, match=r"marionette: waist.*rad/s"):
        Part.of(made(times, position), robot(), speed=1.7)


def test_joints_are_matched_by_name() -> None:
    times, position = still()
    names = robot().joint_names[::-1]
    part = Part.of(JointTrajectory(times, position[:, ::-1], names, "marionette"), robot())
    np.testing.assert_array_equal(part.trajectory.position, position)


def test_another_robots_trajectory_is_refused() -> None:
    times, position = still()
    with pytest.raises(LimitViolation, match="is for 'marionette'"):
        Part.of(made(times, position), load_robot("op3"))
