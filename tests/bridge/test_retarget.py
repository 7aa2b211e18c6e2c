"""Two people's motion onto two servo robots."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bridge.retarget import Retargeted, RetargetSettings, retarget
from bridge.retarget.avoid import AvoidTask
from bridge.retarget.build import measure
from bridge.retarget.human import observe
from bridge.retarget.ik import TouchTask
from bridge.retarget.stage import build_stage
from bridge.retarget.targets import about_up, seated_targets, standing_targets
from bridge.retarget.touch import touches
from generator.choreographer import choreograph
from generator.io import read_motion
from generator.motion import DuetMotion, Motion
from robots.errors import SpecError
from robots.registry import load_robot

PAIRS = [("op3", "op3"), ("marionette", "marionette"), ("op3", "marionette")]


@cache
def duet(name: str) -> DuetMotion:
    return choreograph(name, seed=0)


@cache
def done(name: str, a: str, b: str) -> Retargeted:
    return retarget(duet(name), (load_robot(a), load_robot(b)))


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_shaking_hands_survives_on_every_pair_of_robots(a: str, b: str) -> None:
    report = done("handshake", a, b).report
    assert report.contact_recall >= 0.98
    assert report.contact_gap_error_max_mm <= 6
    assert report.hand_error_percent <= 12
    assert report.penetration_max_mm <= 3
    assert report.floor_penetration_mm <= 3
    assert report.limit_violations == 0


def test_real_mocap_keeps_its_handshake(duets: Path) -> None:
    motion = read_motion(duets / "pseudo" / "cmu_18_01_handshake_sym.npz")
    for name in ("op3", "marionette"):
        report = retarget(motion, (load_robot(name), load_robot(name))).report
        assert report.contact_recall >= 0.9
        assert report.contact_gap_error_max_mm <= 30


@pytest.mark.parametrize(("a", "b"), PAIRS)
def test_both_trajectories_run_on_one_clock_within_their_speed(a: str, b: str) -> None:
    first, second = done("handshake", a, b).trajectories
    assert np.array_equal(first.times, second.times)
    for trajectory in (first, second):
        robot = load_robot(trajectory.robot)
        assert (trajectory.position >= robot.lower - 1e-9).all()
        assert (trajectory.position <= robot.upper + 1e-9).all()
        velocity = np.abs(np.diff(trajectory.position, axis=0)) / np.diff(trajectory.times)[:, None]
        assert (velocity <= 0.65 * robot.max_velocity * (1 + 1e-9)).all()


def test_time_is_stretched_only_when_a_servo_is_too_slow() -> None:
    robots = (load_robot("marionette"), load_robot("marionette"))
    slow = retarget(duet("handshake"), robots, settings=RetargetSettings(speed_share=0.05))
    fast = retarget(duet("handshake"), robots)
    assert fast.report.slowed_by == 1.0
    assert slow.report.slowed_by > 1.5
    assert slow.trajectories[0].duration == pytest.approx(
        fast.trajectories[0].duration * slow.report.slowed_by
    )


def test_the_same_motion_gives_the_same_trajectories() -> None:
    robots = (load_robot("marionette"), load_robot("marionette"))
    again = retarget(duet("handshake"), robots)
    for one, other in zip(
        again.trajectories, done("handshake", "marionette", "marionette").trajectories, strict=True
    ):
        assert np.array_equal(one.position, other.position)


def test_robots_that_walk_side_by_side_do_not_walk_into_each_other() -> None:
    """Scaled by their short legs alone, two OP3 walked 30 mm inside each other all the way."""
    report = done("walk_together", "op3", "op3").report
    assert report.penetration_max_mm <= 2


def test_feet_on_legs_stand_where_the_people_stand() -> None:
    result = done("handshake", "op3", "op3")
    motion = duet("handshake")
    for index, person in enumerate(motion.people):
        at = result.stage.landmarks(result.qpos)[index]
        assert person.foot_contacts is not None
        for column, side in ((0, "left"), (2, "right")):
            stands = person.foot_contacts[:, column]
            inner = stands & np.roll(stands, 4) & np.roll(stands, -4)
            speed = np.linalg.norm(np.gradient(at[f"{side}_ankle"], axis=0), axis=1) * motion.fps
            assert np.percentile(speed[inner], 95) < 0.03


def test_trajectories_know_which_motion_they_come_from() -> None:
    first, second = done("handshake", "op3", "op3").trajectories
    assert first.metadata["motion_sha256"] == second.metadata["motion_sha256"]
    other = done("handshake", "op3", "marionette").trajectories[0]
    assert first.metadata["motion_sha256"] == other.metadata["motion_sha256"]
    waved = done("walk_together", "op3", "op3").trajectories[0]
    assert first.metadata["motion_sha256"] != waved.metadata["motion_sha256"]
    assert first.metadata["licence"] == "CC0-1.0"


def test_near_hands_are_one_touch_and_passing_hands_none() -> None:
    """Without hysteresis a noisy handshake fell into many short touches."""
    motion = duet("handshake")
    rng = np.random.default_rng(0)
    noisy = DuetMotion(
        Motion(motion.fps, motion.a.keypoints + rng.normal(0, 0.008, motion.a.keypoints.shape)),
        motion.b,
    )
    robots = (load_robot("op3"), load_robot("op3"))
    (touch,) = touches(noisy, robots, 0.4)
    labelled = motion.contacts[0]
    start, end = np.flatnonzero(touch.active)[[0, -1]] / motion.fps
    assert abs(start - labelled.start) < 0.25
    assert abs(end - labelled.end) < 0.25
    away = np.array([0.0, 3.0, 0.0])
    far = DuetMotion(motion.a, Motion(motion.fps, motion.b.keypoints + away))
    assert touches(far, robots, 0.4) == []


def test_a_robot_without_arms_is_refused_by_name(tmp_path: Path) -> None:
    source = load_robot("marionette").folder
    (tmp_path / "robot.xml").write_text((source / "robot.xml").read_text())
    text = (source / "robot.toml").read_text().replace("left_hand", "left_paw")
    (tmp_path / "robot.toml").write_text(text)
    robot = load_robot(tmp_path)
    with pytest.raises(SpecError, match="left_hand"):
        retarget(duet("handshake"), (robot, robot))


def test_targets_turn_with_the_person() -> None:
    """Turning both people about the vertical turns free robots' targets and nothing else."""
    stage = build_stage((load_robot("op3"), load_robot("marionette")))
    motion = duet("handshake").a
    turn = Rotation.from_euler("z", 0.7)
    turned = Motion(
        motion.fps,
        turn.apply(np.array(motion.keypoints).reshape(-1, 3)).reshape(motion.keypoints.shape),
        skeleton=motion.skeleton,
    )
    build = measure(stage, stage.actors[0])
    here, there = (standing_targets(observe(m), build) for m in (motion, turned))
    for name, path in here.points.items():
        np.testing.assert_allclose(turn.apply(path), there.points[name], atol=1e-9)
    seated = measure(stage, stage.actors[1])
    here, there = (seated_targets(observe(m), seated) for m in (motion, turned))
    for name, path in here.points.items():
        np.testing.assert_allclose(path, there.points[name], atol=1e-9)


@given(st.floats(-3, 3), st.floats(-3, 3))
@settings(max_examples=30, deadline=None)
def test_turning_targets_twice_is_turning_once_by_the_sum(one: float, other: float) -> None:
    twice = (about_up(np.array([one])) * about_up(np.array([other]))).as_matrix()
    once = about_up(np.array([one + other])).as_matrix()
    np.testing.assert_allclose(twice, once, atol=1e-12)


@pytest.mark.parametrize("kind", ["touch", "avoid"])
def test_jacobians_are_the_derivatives_of_the_errors(kind: str) -> None:
    """Checked against central differences on a posture where the robots overlap."""
    import mink

    stage = build_stage((load_robot("op3"), load_robot("op3")))
    rng = np.random.default_rng(1)
    qpos = np.array(stage.model.qpos0)
    for index, actor in enumerate(stage.actors):
        qpos[actor.base_qpos : actor.base_qpos + 7] = [0.09 * index, 0.02, 0.3, 1, 0, 0, 0]
        qpos[actor.qpos] = rng.uniform(-0.3, 0.3, len(actor.qpos))
    sites = (stage.actors[0].sites["right_hand"], stage.actors[1].sites["right_hand"])
    task = TouchTask(sites, 0.03) if kind == "touch" else AvoidTask(stage.model, 0.002, 1.0)
    configuration = mink.Configuration(stage.model, qpos)
    error = task.compute_error(configuration)
    assert np.abs(error).max() > 1e-3
    jacobian = task.compute_jacobian(configuration)
    velocity = rng.normal(size=stage.model.nv)
    velocity /= np.linalg.norm(velocity)
    step = 1e-6
    ends = []
    for sign in (1, -1):
        moved = qpos.copy()
        mujoco.mj_integratePos(stage.model, moved, velocity, sign * step)
        ends.append(task.compute_error(mink.Configuration(stage.model, moved)))
    numeric = (ends[0] - ends[1]) / (2 * step)
    if kind == "touch":  # its direction is held: compare along it
        direction = error / np.linalg.norm(error)
        np.testing.assert_allclose(direction @ numeric, direction @ jacobian @ velocity, atol=2e-2)
    else:
        deepest = int(np.argmax(error))
        np.testing.assert_allclose(numeric[deepest], jacobian[deepest] @ velocity, atol=2e-3)
