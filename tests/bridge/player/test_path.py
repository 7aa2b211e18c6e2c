"""The way between samples: smooth, and never beyond a limit that the samples keep."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.player.path import SmoothPath
from bridge.trajectory import JointTrajectory


def path(times, position, *, lower=-10.0, upper=10.0, max_velocity=1e3) -> SmoothPath:
    position = np.asarray(position, float).reshape(len(times), -1)
    names = tuple(f"joint_{k}" for k in range(position.shape[1]))
    bounds = (np.full(len(names), bound) for bound in (lower, upper, max_velocity))
    low, high, fastest = bounds
    trajectory = JointTrajectory(np.asarray(times, float), position, names, "robot")
    return SmoothPath(trajectory, lower=low, upper=high, max_velocity=fastest)


def sampled(way: SmoothPath, times: np.ndarray) -> np.ndarray:
    return np.array([way.at(time) for time in times])


def test_samples_are_met_and_both_ends_are_held():
    times, position = np.arange(6) * 0.1, np.sin(np.arange(6))[:, None]
    way = path(times, position)
    np.testing.assert_allclose(sampled(way, times), position, atol=1e-12)
    assert way.at(-1.0) == position[0]
    assert way.at(9.0) == position[-1]


def test_a_sine_of_few_samples_is_met_far_better_than_by_straight_lines():
    times = np.arange(0, 2 + 1e-9, 1 / 30)
    fine = np.linspace(0.2, 1.8, 900)
    way = path(times, np.sin(2 * np.pi * times))
    truth = np.sin(2 * np.pi * fine)
    smooth = np.abs(sampled(way, fine)[:, 0] - truth).max()
    straight = np.abs(np.interp(fine, times, np.sin(2 * np.pi * times)) - truth).max()
    assert smooth < straight / 100


def test_the_speed_does_not_jump_at_samples():
    times = np.arange(0, 1 + 1e-9, 1 / 30)
    way = path(times, np.sin(5 * times))
    eps = 1e-6
    for time in times[1:-1]:
        before = (way.at(time) - way.at(time - eps)) / eps
        after = (way.at(time + eps) - way.at(time)) / eps
        assert before == pytest.approx(after, abs=1e-3)


def test_a_sample_on_the_limit_is_reached_without_swinging_over():
    way = path([0, 1, 2], [0, 1, 1], upper=1.0)
    fine = sampled(way, np.linspace(0, 2, 400))
    assert fine.max() <= 1.0 + 1e-12
    free = sampled(path([0, 1, 2], [0, 1, 1]), np.linspace(0, 2, 400))
    assert free.max() == pytest.approx(1.125, abs=1e-4)


def test_samples_at_full_speed_stay_at_full_speed():
    times = np.arange(8) * 0.1
    way = path(times, np.array([0, 0, 0.1, 0.2, 0.3, 0.3, 0.3, 0.3]), max_velocity=1.0)
    fine = np.linspace(0, 0.7, 4001)
    speed = np.abs(np.diff(sampled(way, fine)[:, 0])) / np.diff(fine)
    assert speed.max() <= 1.0 + 1e-9


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9))
def test_no_samples_within_the_limits_lead_out_of_them(seed, count):
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.2, count - 1))])
    position = np.clip(rng.normal(0, 0.8, (count, 3)), -1, 1)
    fastest = (np.abs(np.diff(position, axis=0)) / np.diff(times)[:, None]).max()
    way = path(times, position, lower=-1.0, upper=1.0, max_velocity=fastest)
    fine = np.linspace(0, times[-1], 600)
    values = sampled(way, fine)
    assert np.abs(values).max() <= 1 + 1e-12
    speed = np.abs(np.diff(values, axis=0)) / np.diff(fine)[:, None]
    assert speed.max() <= fastest * (1 + 1e-6) + 1e-9
