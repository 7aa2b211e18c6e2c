"""The bounds on every single goal."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.player.governor import PERIODS, Governor
from bridge.player.telemetry import read_telemetry
from tests.bridge.player.stage import BRISK, SMALL, Stage

ROBOT = SMALL[0]
H = 0.02
UNKNOWN = np.full(3, np.nan)
ACCELERATION_TIME = 0.1


def governor() -> Governor:
    return Governor(ROBOT, period=H, acceleration_time=ACCELERATION_TIME, reach=0.6)


def test_what_keeps_the_limits_passes_unchanged():
    bounds = governor()
    times = np.arange(0, 2, H)
    path = ROBOT.rest + 0.2 * (1 - np.cos(4 * times))[:, None]
    path = np.clip(path, ROBOT.lower, ROBOT.upper)
    for asked in path:
        np.testing.assert_allclose(bounds.bound(asked, asked, H), asked, atol=1e-12)
        assert not bounds.held_back.any()


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_no_sequence_of_goals_and_delays_breaks_a_bound(seed):
    rng = np.random.default_rng(seed)
    bounds, before, velocity = governor(), ROBOT.rest.copy(), np.zeros(3)
    for _ in range(40):
        asked = rng.uniform(ROBOT.lower - 1, ROBOT.upper + 1)
        elapsed = float(rng.choice([0.0, 0.3 * H, H, 7 * H]))
        told = bounds.bound(asked, UNKNOWN, elapsed)
        h = min(max(elapsed, H / 4), PERIODS * H)
        assert ((told >= ROBOT.lower) & (told <= ROBOT.upper)).all()
        speed = (told - before) / h
        assert (np.abs(speed) <= ROBOT.max_velocity * (1 + 1e-9)).all()
        inside = (told > ROBOT.lower) & (told < ROBOT.upper)
        change = np.abs(speed - velocity)[inside]
        assert (change <= (ROBOT.max_velocity * h / ACCELERATION_TIME)[inside] + 1e-9).all()
        before, velocity = told, speed


def test_a_leap_is_made_up_for_without_swinging_over():
    bounds = governor()
    goal = np.clip(ROBOT.rest + 0.8, ROBOT.lower, ROBOT.upper)
    told = np.array([bounds.bound(goal, UNKNOWN, H) for _ in range(60)])
    assert (np.diff(told, axis=0) >= -1e-12).all()
    np.testing.assert_allclose(told[-1], goal, atol=1e-9)
    assert bounds.held_back.tolist() == [False] * 3


def test_after_a_gap_no_goal_is_further_than_two_periods_of_full_speed():
    bounds = governor()
    asked = before = ROBOT.rest.copy()
    for _ in range(20):
        asked = asked - 0.01
        before = bounds.bound(asked, UNKNOWN, H)
    told = bounds.bound(asked - 0.2, UNKNOWN, 20 * H)
    assert (np.abs(told - before) <= 2 * H * ROBOT.max_velocity).all()


def test_a_goal_stays_near_a_joint_that_is_held():
    bounds = governor()
    held = told = ROBOT.rest
    for _ in range(100):
        told = bounds.bound(ROBOT.upper, held, H)
    assert (told - held <= 0.6 + 1e-9).all()
    assert bounds.held_back[0]


def test_joints_that_are_not_told_what_was_asked_are_named_in_the_telemetry(tmp_path):
    stage, path = Stage(robots=SMALL), tmp_path / "t.jsonl"
    servo = stage.wires[0].servos[2]

    def hold(state: str, share: float) -> None:
        if state == "PLAY" and 0.3 < share < 0.5:
            servo.place(ROBOT.rest[2] + 1.0)  # a hand, further away than a goal may be

    settings = dataclasses.replace(BRISK, stray=5.0)
    assert stage.play(telemetry=path, on_progress=hold, settings=settings).completed
    events = [x for x in read_telemetry(path) if x.get("event") == "held back"]
    assert events[0]["joints"] == [ROBOT.joint_names[2]]
    assert events[-1]["joints"] == []
