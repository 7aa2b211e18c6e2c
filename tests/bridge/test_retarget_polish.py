"""Refinement over time: the equations are solved exactly, and the motion gets better by them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.retarget import RetargetSettings, polish, retarget
from bridge.retarget.bands import second_difference_bands, solve_blocks
from bridge.retarget.build import measure
from bridge.retarget.human import observe
from bridge.retarget.placement import place
from bridge.retarget.polish import PolishCosts, _Polisher
from bridge.retarget.stage import build_stage
from bridge.retarget.touch import touches
from generator.choreographer import choreograph
from generator.io import read_motion
from robots.errors import SpecError
from robots.registry import load_robot


@given(count=st.integers(1, 7), n=st.integers(1, 4), seed=st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_block_equations_are_solved_like_dense_ones(count: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, n, n))
    blocks = root @ root.swapaxes(1, 2) + 9 * np.eye(n)
    below, far = rng.uniform(-1, 1, (2, count, n))
    right = rng.normal(size=(count, n))
    dense = np.zeros((count * n, count * n))
    for t in range(count):
        dense[t * n : (t + 1) * n, t * n : (t + 1) * n] = blocks[t]
        for k, diagonal in ((1, below), (2, far)):
            if t + k < count:
                at = (slice((t + k) * n, (t + k + 1) * n), slice(t * n, (t + 1) * n))
                dense[at] = np.diag(diagonal[t])
                dense[at[::-1]] = np.diag(diagonal[t])
    expected = np.linalg.solve(dense, right.ravel()).reshape(count, n)
    np.testing.assert_allclose(solve_blocks(blocks, below, far, right), expected, atol=1e-9)


def test_equations_that_are_not_positive_are_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        solve_blocks(-np.eye(2)[None], np.zeros((1, 2)), np.zeros((1, 2)), np.ones((1, 2)))


@given(count=st.integers(2, 9), seed=st.integers(0, 2**31))
@settings(max_examples=30, deadline=None)
def test_bands_are_those_of_second_differences(count: int, seed: int) -> None:
    path = np.random.default_rng(seed).normal(size=(count, 3))
    difference = np.diff(np.eye(count), n=2, axis=0)
    bands, gradient = second_difference_bands(np.diff(path, n=2, axis=0), count)
    square = difference.T @ difference
    for k, band in enumerate(bands):
        np.testing.assert_allclose(band[: count - k], np.diagonal(square, -k))
        assert not band[count - k :].any()
    np.testing.assert_allclose(gradient, square @ path, atol=1e-12)


@cache
def rough(robot: str, frames: int = 24):
    """A stretch of a handshake with its problem, not refined."""
    motion = choreograph("handshake", seed=0)
    robots = (load_robot(robot), load_robot(robot))
    stage = build_stage(robots)
    builds = (measure(stage, stage.actors[0]), measure(stage, stage.actors[1]))
    people = (observe(motion.a), observe(motion.b))
    touching = touches(motion, robots, builds[0].arm_length / people[0].arm_length)
    free = (stage.actors[0].free, stage.actors[1].free)
    targets, yaw = place(people, builds, free, touching)
    for index, target in enumerate(targets):
        if not free[index]:
            stage.place(index, target.base[0], yaw if index else 0.0)
    result = retarget(motion, robots, settings=RetargetSettings(polish=0))
    return stage, builds, targets, touching, result.qpos, motion.fps


def cost(solver: _Polisher, qpos: np.ndarray) -> float:
    """The cost, from its definition and not from the solver's normal equations.

    Collisions are left out: which geoms overlap changes in jumps.
    """
    goals, data, total = solver.goals, solver.data, 0.0
    angles = []
    for t, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(solver.model, data)
        miss = np.linalg.norm(data.site_xpos[goals.sites] - goals.positions[t], axis=1)
        total += ((goals.position_weights[t] * miss) ** 2).sum()
        for body, frame, weight in zip(
            goals.bodies, goals.orientations[t], goals.orientation_weights, strict=True
        ):
            cosine = (np.trace(frame.T @ data.xmat[body].reshape(3, 3)) - 1) / 2
            total += (weight * np.arccos(np.clip(cosine, -1, 1))) ** 2
        for touch, a, b, weights in solver.touches:
            distance = np.linalg.norm(data.site_xpos[b] - data.site_xpos[a])
            total += (weights[t] * (distance - touch.gap)) ** 2
        angles.append(pose[np.concatenate([a.qpos for a in solver.stage.actors])])
    dofs = np.concatenate([a.dof for a in solver.stage.actors])
    total += ((solver.rest_weights[dofs] * (np.array(angles) - solver.rest[dofs])) ** 2).sum()
    total += ((solver.inertia[dofs] * np.diff(angles, n=2, axis=0)) ** 2).sum()
    return 0.5 * total


def test_the_gradient_is_the_derivative_of_the_cost() -> None:
    """Central differences in random directions of all joints of 24 frames of a touch."""
    stage, builds, targets, touching, qpos, fps = rough("marionette")
    solver = _Polisher(stage, builds, targets, touching, fps, PolishCosts(collision=0.0, floor=0.0))
    middle = int(np.flatnonzero(touching[0].weight > 0)[0])
    start, stop = middle, middle + 24
    rng = np.random.default_rng(3)
    _, gradient = solver._tracking(qpos, start, stop)
    gradient += solver.rest_weights**2 * (solver._angles(qpos[start:stop]) - solver.rest)
    gradient += solver._smoothness(qpos, start, stop)[1]
    dofs = np.concatenate([a.dof for a in stage.actors])
    columns = np.concatenate([a.qpos for a in stage.actors])
    for _ in range(5):
        direction = rng.normal(size=(stop - start, len(dofs)))
        direction /= np.linalg.norm(direction)
        ends = []
        for sign in (1, -1):
            moved = qpos.copy()
            moved[start:stop, columns] += sign * 1e-5 * direction
            ends.append(cost(solver, moved))
        slope = (ends[0] - ends[1]) / 2e-5
        assert slope == pytest.approx((gradient[:, dofs] * direction).sum(), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("robot", ["op3", "marionette"])
def test_refined_motion_is_smoother_and_still_meets(robot: str) -> None:
    stage, builds, targets, touching, qpos, fps = rough(robot)
    better = polish.polish(stage, builds, targets, touching, qpos, fps=fps)
    columns = np.concatenate([actor.qpos for actor in stage.actors])
    jerk = [np.sqrt((np.diff(q[:, columns], n=3, axis=0) ** 2).mean()) for q in (qpos, better)]
    assert jerk[1] < 0.5 * jerk[0]
    a, b = stage.landmarks(better)
    (touch,) = touching
    gap = np.linalg.norm(a[touch.a] - b[touch.b], axis=1)[touch.active]
    assert np.abs(gap - touch.gap).max() < 2e-3
    for actor in stage.actors:
        assert (better[:, actor.qpos] >= actor.robot.lower).all()
        assert (better[:, actor.qpos] <= actor.robot.upper).all()


def test_stretches_of_a_long_motion_join_without_a_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, builds, targets, touching, qpos, fps = rough("marionette")
    whole = polish.polish(stage, builds, targets, touching, qpos, fps=fps)
    monkeypatch.setattr(polish, "STRETCH", 80)
    monkeypatch.setattr(polish, "OVERLAP", 30)
    pieces = polish.polish(stage, builds, targets, touching, qpos, fps=fps)
    assert np.abs(pieces - whole).max() < 0.05
    sharpest = [np.abs(np.diff(q, n=2, axis=0)).max() for q in (whole, pieces)]
    assert sharpest[1] < 1.5 * sharpest[0]


def test_progress_grows_to_one() -> None:
    stage, builds, targets, touching, qpos, fps = rough("marionette")
    told: list[float] = []
    polish.polish(
        stage, builds, targets, touching, qpos, fps=fps, iterations=2, progress=told.append
    )
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_robots_do_not_run_through_each_other_in_real_mocap(duets: Path) -> None:
    """Moment by moment, forearms of two OP3 overlapped by 12 mm on the way to this handshake."""
    motion = read_motion(duets / "pseudo" / "cmu_18_01_handshake_sym.npz")
    for pair in (("op3", "op3"), ("marionette", "marionette"), ("op3", "marionette")):
        report = retarget(motion, (load_robot(pair[0]), load_robot(pair[1]))).report
        assert report.penetration_max_mm <= 2
        assert report.jerk_rms_rad_s3 <= 60
        assert report.contact_recall >= 0.98
        assert report.floor_penetration_mm <= 2


def test_a_fixed_robot_is_raised_to_its_partners_shoulders() -> None:
    """On the floor, a marionette's hand was out of reach of an OP3 that stood upright."""
    motion = choreograph("handshake", seed=0)
    result = retarget(motion, (load_robot("op3"), load_robot("marionette")))
    a, b = result.stage.landmarks(result.qpos)
    first = a["right_shoulder"][0, 2] - b["right_shoulder"][0, 2]
    assert abs(first) < 0.03
    assert result.trajectories[1].base is not None
    assert result.trajectories[1].base[0, 2] > 0.1


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(SpecError, match="polish"):
        RetargetSettings(polish=-1)
