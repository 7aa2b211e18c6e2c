import logging
import os
from contextlib import suppress
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generator.choreographer import choreograph
from generator.io import read_motion
from generator.kinematics import fit_rotations, forward_kinematics
from generator.motion import DuetMotion, Motion
from robots.errors import SimDiverged, SpecError
from robots.humanoid import HumanBody
from sim.controllers.assist import AssistController
from sim.controllers.base import quiet_mujoco, within_effort
from sim.fitting import fit_person
from sim.footing import FOOT_BODIES, clear_floor, ground_shift, sole_corners
from sim.inverse import inverse_dynamics
from sim.reference import make_reference
from sim.scene import GRAVITY, AssistLimits, build_scene
from sim.score import score
from sim.track import CONTROLLERS, TrackSettings, track

ASSIST = TrackSettings(controller="assist")


@pytest.fixture(scope="module")
def rollout(duet):
    return track(duet, settings=ASSIST)


def test_standing_people_are_tracked_on_their_feet(rollout):
    assert rollout.fell == {"a": False, "b": False}
    assert rollout.error.mean() < 0.03
    assert np.isfinite(rollout.qpos).all()


def test_tracking_is_deterministic(duet, rollout):
    again = track(duet, settings=ASSIST)
    assert np.array_equal(again.qpos, rollout.qpos)
    assert np.array_equal(again.assist, rollout.assist)


def test_tracking_says_nothing_on_the_terminal(make_duet, move, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    base = make_duet(0.5)
    rng = np.random.default_rng(0)
    wild = move(base.a, lambda k: k + rng.normal(size=k.shape) * 0.05)
    with suppress(SimDiverged):
        track(DuetMotion(wild, base.b), settings=ASSIST)
    out, err = capfd.readouterr()
    assert out == ""
    assert err == ""
    assert os.listdir(tmp_path) == []


def test_warnings_of_mujoco_go_to_the_log(caplog, capfd):
    xml = "<mujoco><option timestep='1'/><worldbody><body><joint type='hinge' stiffness='1e9'/>"
    model = mujoco.MjModel.from_xml_string(xml + "<geom size='.1'/></body></worldbody></mujoco>")
    data = mujoco.MjData(model)
    data.qvel[:] = 1e9
    with caplog.at_level(logging.INFO), quiet_mujoco():
        mujoco.mj_step(model, data)
        mujoco.mj_step(model, data)
    assert "MuJoCo" in caplog.text
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_the_assist_is_what_keeps_walkers_up():
    """Nobody balances in this controller, so without help people who step fall."""
    motion = choreograph("handshake", seed=0)
    alone = track(motion, settings=replace(ASSIST, assist=AssistLimits(max_force=0, max_torque=0)))
    helped = track(motion, settings=ASSIST)
    assert not alone.assist.any()
    assert alone.fell == {"a": True, "b": True}
    assert helped.fell == {"a": False, "b": False}


def test_assist_stays_within_its_bound(make_duet, move):
    base = make_duet(0.8)

    def hover(k):
        return k + np.array([0, 0, 0.6])

    up = DuetMotion(move(base.a, hover), move(base.b, hover))
    rollout = track(up, settings=replace(ASSIST, assist=AssistLimits(max_force=0.3)))
    weights = rollout.weight[:, None] * GRAVITY
    assert np.abs(rollout.assist[..., :3]).max() <= (0.3 * weights).max() * (1 + 1e-9)
    assert (np.abs(rollout.assist[20, :, 2]) > 0.29 * weights[:, 0]).all()


def test_progress_reaches_one(make_duet):
    seen = []
    track(make_duet(0.2), settings=ASSIST, progress=seen.append)
    assert seen[-1] == 1.0
    assert seen == sorted(seen)


def test_moments_cover_the_motion_whatever_its_frame_rate(make_duet):
    motion = make_duet(0.5, fps=24.0)
    rollout = track(motion, settings=ASSIST)
    assert rollout.times[-1] >= motion.duration - 1e-9
    assert rollout.times[-1] < motion.duration + 1 / 60
    back = rollout.as_motion()
    assert (back.frames, back.fps, back.kind) == (motion.frames, 24.0, "simulated")


def test_absurd_speed_ends_the_run_at_its_first_pose(make_duet, move):
    base = make_duet(0.3)
    away = np.arange(base.frames)[:, None, None] * [1e3, 0, 0]
    rollout = track(DuetMotion(move(base.a, lambda k: k + away), base.b), settings=ASSIST)
    assert rollout.ended is not None
    assert rollout.ended["time"] == 0
    assert "diverged at 0.000 s" in rollout.ended["why"]
    assert rollout.frames == 2
    assert np.isfinite(rollout.as_motion().keypoints).all()


def test_a_fall_is_shown_for_half_a_second_and_then_the_run_ends(make_duet, move):
    base = make_duet(1.6)
    up = DuetMotion(*(move(person, lambda k: k + np.array([0, 0, 0.6])) for person in base.people))
    rollout = track(up, settings=replace(ASSIST, assist=AssistLimits(max_force=0, max_torque=0)))
    assert rollout.ended is not None
    assert "fell at" in rollout.ended["why"]
    assert rollout.fall_time["a"] is not None
    assert rollout.ended["time"] == pytest.approx(rollout.fall_time["a"] + 0.5, abs=0.05)
    report = score(rollout)
    assert {"fell", "ended_early"} <= {m.name for m in report.metrics if not m.passed}


class Quitter:
    """Stands up to a tick, and diverges or gives up there."""

    def __init__(self, tick):
        self.tick = tick

    def run(self, scene, reference, progress=None, **_):
        trace = AssistController().run(scene, reference, progress)
        kept = {
            name: getattr(trace, name)[: self.tick + 1]
            for name in ("qpos", "qvel", "ctrl", "assist", "torque")
        }
        if self.tick % 2:  # gives up without a word
            return replace(trace, **kept)
        raise SimDiverged("it diverged", time=self.tick / 120, trace=replace(trace, **kept))


@pytest.mark.parametrize(("tick", "why"), [(50, "it diverged"), (61, "gave up at 0.508 s")])
def test_a_run_that_ends_early_keeps_what_was_simulated(make_duet, monkeypatch, tick, why):
    monkeypatch.setitem(CONTROLLERS, "assist", lambda _: Quitter(tick))
    rollout = track(make_duet(1.0), settings=ASSIST)
    assert rollout.ended is not None
    assert rollout.ended["time"] == pytest.approx(tick / 120)
    assert why in rollout.ended["why"]
    assert rollout.times[-1] == pytest.approx(tick // 2 / 60)
    assert rollout.frames == int(rollout.times[-1] * 30 + 1e-9) + 1
    assert rollout.as_motion().frames == rollout.frames
    report = score(rollout)
    assert not report.passed
    assert "ended_early" in {m.name for m in report.metrics if not m.passed}


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"controller": "asist"}, "did you mean 'assist'"),
        ({"rate": 1.0}, "moments per second"),
        ({"steps": 17}, "steps per second"),
        ({"smoothing": -1.0}, "smoothing"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting, message):
    with pytest.raises(SpecError, match=message):
        TrackSettings(**setting)


def test_velocities_are_those_of_mujoco(duet):
    reference = make_reference(duet, rate=60)
    scene = build_scene(reference.bodies)
    qpos = scene.qpos(reference.root, reference.rotations)
    linear, angular = reference.steps()
    want = np.zeros(scene.model.nv)
    for t in (3, 20):
        mujoco.mj_differentiatePos(scene.model, want, 1 / 60, qpos[t], qpos[t + 1])
        for p, at in enumerate(scene.maps):
            assert want[at.root_dof : at.root_dof + 3] == pytest.approx(linear[t, p], abs=1e-9)
            assert want[at.dofs] == pytest.approx(angular[t, p], abs=1e-7)


def test_a_standing_person_demands_its_weight_of_the_floor(make_duet):
    reference = make_reference(make_duet(1.0), rate=60)
    scene = build_scene(reference.bodies)
    demand = inverse_dynamics(scene, reference)
    weights = np.array([b.weight * GRAVITY for b in reference.bodies])
    assert demand.support.mean(axis=0) == pytest.approx(weights, rel=0.02)
    share = np.linalg.norm(demand.residual[..., :3], axis=-1) / weights
    assert share.mean() < 0.03
    assert share.max() < 0.1


def test_a_hovering_person_demands_what_no_floor_gives(make_duet, move):
    base = make_duet(1.0)

    def hover(k):
        return k + np.array([0, 0, 0.5])

    up = DuetMotion(move(base.a, hover), move(base.b, hover))
    reference = make_reference(up, rate=60)
    demand = inverse_dynamics(build_scene(reference.bodies), reference)
    weights = np.array([b.weight * GRAVITY for b in reference.bodies])
    share = np.linalg.norm(demand.residual[..., :3], axis=-1) / weights
    assert share.mean() == pytest.approx(1.0, abs=0.05)
    assert not demand.support.any()


def test_rotations_of_a_motion_are_kept_where_they_fit(make_sway):
    person = make_sway()
    skeleton, rotations = fit_person(person)
    assert skeleton is person.skeleton
    assert np.abs(np.abs((rotations * person.rotations).sum(-1)) - 1).max() < 1e-9


def test_rotations_that_contradict_the_keypoints_are_not_believed(make_sway):
    person = make_sway()
    wrong = Motion(person.fps, person.keypoints, np.roll(person.rotations, 3, axis=1))
    skeleton, rotations = fit_person(wrong)
    made = forward_kinematics(skeleton, person.keypoints[:, 0], rotations)
    assert np.linalg.norm(made - person.keypoints, axis=-1).mean() < 0.005


def test_people_with_other_feet_stand_level(make_sway):
    """A source may put the ankle 4 cm above the sole where ours is 7.5; feet must come out flat."""
    person = make_sway(with_rotations=False)
    points = person.keypoints.copy()
    names = person.skeleton.names
    for side in ("left", "right"):
        points[:, names.index(f"{side}_ankle"), 2] -= 0.04
    odd = Motion(person.fps, points)
    skeleton, rotations = fit_person(odd)
    body = HumanBody.of(skeleton)
    heights = sole_corners(body, points[:, 0], rotations)[..., 2]
    assert np.ptp(heights) < 0.006
    made = forward_kinematics(skeleton, points[:, 0], rotations)
    assert np.linalg.norm(made - points, axis=-1).max() < 0.005
    plain = fit_rotations(person.skeleton, points)
    assert np.ptp(sole_corners(body, points[:, 0], plain)[..., 2]) > 0.02


@pytest.mark.parametrize(("height", "expected"), [(0.03, -0.03), (-0.05, 0.05), (0.5, 0.0)])
def test_standing_soles_are_put_on_the_floor_unless_it_is_far(make_sway, height, expected):
    person = make_sway()
    root = person.keypoints[:, 0] + [0, 0, height]
    body = HumanBody.of(person.skeleton)
    assert ground_shift(body, root, person.rotations, 30.0) == pytest.approx(expected, abs=1e-6)


def test_swinging_feet_clear_the_floor_and_standing_feet_stay(make_sway):
    person = make_sway(2.0)
    body = HumanBody.of(person.skeleton)
    count = person.frames
    turns = Rotation.from_quat(person.rotations.reshape(-1, 4), scalar_first=True)
    quats = turns.as_quat(scalar_first=True).reshape(count, 22, 4)
    speed = np.clip((np.arange(count) / 30 - 1) * 4, 0, 3)
    root = person.keypoints[:, 0] + np.cumsum(speed)[:, None] / 30 * [1, 0, 0]
    before = sole_corners(body, root, quats)[..., 2].min(axis=(1, 2))
    lifted, most = clear_floor(body, root, quats, 30.0)
    after = sole_corners(body, root, lifted)[..., 2].min(axis=(1, 2))
    assert np.abs(before).max() < 1e-6
    assert after[-15:-2].min() > 0.02
    assert np.abs(after[:20]).max() < 1e-3
    assert 0.02 < most.max() < 0.05
    assert len(FOOT_BODIES) == 4


def test_targets_stay_within_effort():
    rng = np.random.default_rng(0)
    now = Rotation.from_rotvec(rng.normal(size=(50, 3)) * 0.5)
    target = now * Rotation.from_rotvec(rng.normal(size=(50, 3)) * 0.5)
    velocity = rng.normal(size=(50, 3)) * 3
    bounded = within_effort(target, now, velocity, 0.1, np.full(50, 0.4))
    pull = (now.inv() * bounded).as_rotvec() - 0.1 * velocity
    assert np.linalg.norm(pull, axis=1).max() <= 0.4 + 1e-9
    free = within_effort(target, now, velocity, 0.1, np.full(50, 10.0))
    assert (free.inv() * target).magnitude().max() < 1e-9


def test_feed_forward_beats_springs_alone(make_duet):
    reference = make_reference(make_duet(1.0), rate=120)
    scene = build_scene(reference.bodies, assist=AssistLimits())
    errors = []
    for share in (0.0, 1.0):
        trace = AssistController(feed_forward=share).run(scene, reference)
        made = scene.keypoints(trace.qpos)
        errors.append(np.linalg.norm(made - reference.keypoints, axis=-1).mean())
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
@pytest.mark.parametrize("interaction", ["handshake", "hug", "waltz", "walk_together"])
def test_choreographed_duets_are_tracked(interaction):
    rollout = track(choreograph(interaction, seed=0), settings=ASSIST)
    assert rollout.fell == {"a": False, "b": False}
    assert rollout.error.mean() < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    "clip", ["cmu_18_01_handshake_sym", "cmu_007_01_side", "cmu_005_02_mirror"]
)
def test_captured_duets_are_tracked(duets, clip):
    rollout = track(read_motion(duets / "pseudo" / f"{clip}.npz"), settings=ASSIST)
    assert rollout.fell == {"a": False, "b": False}
    assert rollout.error.mean() < 0.04


def test_limbs_that_are_nobodys_are_refused_by_name(duet, move):
    tiny = move(duet.b, lambda points: points[:, :1] + 0.2 * (points - points[:, :1]))
    with pytest.raises(SpecError, match="person b of the motion: by the keypoints, a person of"):
        make_reference(replace(duet, b=tiny))
