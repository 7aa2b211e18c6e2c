from dataclasses import fields, replace
from typing import Any

import mujoco
import numpy as np
import pytest

from generator.choreographer import choreograph
from generator.motion import DuetMotion, Motion
from robots.errors import SpecError
from sim.controllers.assist import AssistController
from sim.controllers.mppi.controller import MppiController
from sim.controllers.mppi.planner import make_nominal, planner, planning_model
from sim.controllers.mppi.settings import CostWeights, MppiSettings
from sim.controllers.nominal import unwrapped
from sim.disturbance import Disturbance, Push
from sim.reference import make_reference
from sim.rollout import FALL_DISTANCE
from sim.scene import AssistLimits, build_scene
from sim.simulation import Simulation
from sim.track import TrackSettings, track

TINY = MppiSettings(samples=8, horizon=0.2, knots=3)


def stage(motion, assist=None):
    reference = make_reference(motion, rate=60)
    return build_scene(reference.bodies, timestep=1 / 60, assist=assist), reference


@pytest.fixture(scope="module")
def standing(make_duet):
    return stage(make_duet(0.5))


@pytest.fixture(scope="module")
def trace(standing):
    return MppiController(settings=TINY).run(*standing)


def test_the_same_seed_gives_the_same_run_and_another_seed_another(standing, trace):
    again = MppiController(settings=TINY).run(*standing)
    other = MppiController(settings=TINY, seed=1).run(*standing)
    assert np.array_equal(again.qpos, trace.qpos)
    assert np.array_equal(again.ctrl, trace.ctrl)
    assert not np.array_equal(other.qpos, trace.qpos)


def test_threads_do_not_change_the_run(standing, trace):
    settings = MppiSettings(samples=8, horizon=0.2, knots=3, threads=3)
    threaded = MppiController(settings=settings).run(*standing)
    assert np.array_equal(threaded.qpos, trace.qpos)


def test_people_who_stand_stay_close_to_the_reference(standing, trace):
    scene, reference = standing
    assert len(trace.qpos) == len(reference.root)
    assert "ended" not in trace.facts
    error = np.linalg.norm(scene.keypoints(trace.qpos) - reference.keypoints, axis=-1)
    assert error.mean() < 0.03
    assert not trace.assist.any()


def test_replanning_lowers_the_cost_of_each_person_from_where_it_is(standing):
    """After a shove, the plan must be better than following the reference blindly."""
    scene, reference = standing
    nominal = make_nominal(scene, reference, 1.0)
    data = Simulation(scene, reference).data
    for at in scene.maps:
        data.qvel[at.root_dof] += 0.5
    settings = MppiSettings(samples=32, horizon=0.3, knots=3)
    with planner(scene, reference, nominal, settings, seed=0) as sampler:
        for _ in range(3):
            sampler.replan(data, 0)
        plans = np.stack([np.zeros_like(sampler.plan), sampler.plan])
        blind, planned = sampler.costs(plans, data, 0)
    assert (planned < 0.98 * blind).all()


def test_a_plan_that_diverges_costs_more_than_any_other(standing):
    scene, reference = standing
    nominal = make_nominal(scene, reference, 1.0)
    data = Simulation(scene, reference).data
    with planner(scene, reference, nominal, TINY, seed=0) as sampler:
        plans = np.stack([np.zeros_like(sampler.plan)] * 2)
        data.qvel[scene.maps[0].root_dof] = 1e9
        assert (sampler.costs(plans, data, 0) >= 1e6).all()
        sampler.replan(data, 0)
        assert np.isfinite(sampler.plan).all()


def test_deviations_stay_within_the_clip(standing):
    scene, reference = standing
    data = Simulation(scene, reference).data
    settings = MppiSettings(samples=16, horizon=0.2, knots=3, clip=0.03)
    with planner(scene, reference, make_nominal(scene, reference, 1.0), settings, 0) as sampler:
        sampler.replan(data, 0)
        assert 0 < np.abs(sampler.plan).max() <= 0.03


def test_the_planning_model_moves_as_the_scene_does(standing):
    scene, reference = standing
    model = planning_model(scene, 1 / 60)
    ours, theirs = mujoco.MjData(model), Simulation(scene, reference).data
    ours.qpos[:], ours.qvel[:] = theirs.qpos, theirs.qvel
    ctrl = make_nominal(scene, reference, 1.0).ctrl
    for k in range(10):
        ours.ctrl[:] = theirs.ctrl[:] = ctrl[k]
        mujoco.mj_step(model, ours)
        mujoco.mj_step(scene.model, theirs)
    assert ours.qpos == pytest.approx(theirs.qpos, abs=1e-4)


def test_without_deviations_it_does_what_the_springs_of_assist_do(make_duet):
    """One nominal control for all: targets ahead by damping and torque, and the helping hand."""
    scene, reference = stage(make_duet(0.3), AssistLimits())
    still = MppiSettings(samples=2, horizon=0.2, knots=3, clip=0.0)
    ours = MppiController(settings=still).run(scene, reference)
    theirs = AssistController().run(scene, reference)
    assert ours.assist.any()
    assert ours.qpos == pytest.approx(theirs.qpos, abs=1e-6)
    assert ours.assist == pytest.approx(theirs.assist, abs=1e-3)


def test_a_fall_ends_the_run_and_is_told(make_duet, move):
    base = make_duet(1.2)

    def leave(k):
        k[10:] += [3.0, 0, 0]
        return k

    away = DuetMotion(base.a, move(base.b, leave))
    scene, reference = stage(away)
    trace = MppiController(settings=TINY).run(scene, reference)
    assert len(trace.qpos) < len(reference.root)
    assert "a person fell at 0.3" in trace.facts["ended"]["why"]
    made = scene.keypoints(trace.qpos[-1:]) - reference.keypoints[len(trace.qpos) - 1]
    assert np.linalg.norm(made[0, 1], axis=-1).mean() > FALL_DISTANCE


def test_a_push_reaches_the_simulation_and_not_the_plan(standing, trace):
    push = Disturbance(
        pushes=(Push(person="a", body="spine3", force=(300.0, 0.0, 0.0), start=0.2, duration=0.2),)
    )
    pushed = MppiController(settings=TINY).run(*standing, disturbance=push)
    assert np.array_equal(pushed.ctrl[:12], trace.ctrl[:12])
    assert np.abs(pushed.qvel - trace.qvel).max() > 0.1


def test_rotation_vectors_go_on_beyond_half_a_turn():
    angles = np.linspace(0, 8, 50)
    axis = np.array([0.6, 0.0, 0.8])
    wrapped = ((angles + np.pi) % (2 * np.pi) - np.pi)[:, None] * axis
    assert unwrapped(wrapped) == pytest.approx(angles[:, None] * axis)


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 1},
        {"horizon": 0.0},
        {"knots": 1},
        {"rate": 0.5},
        {"temperature": float("nan")},
        {"clip": -0.1},
        {"fade": 1.1},
        {"feed_forward": 2.0},
        {"threads": 0},
        {"weights": CostWeights(spin=-1.0)},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(SpecError, match="mppi"):
        MppiSettings(**wrong)


def test_every_number_among_the_settings_has_a_range():
    for name in {setting.name for setting in fields(MppiSettings)} - {"weights"}:
        wrong: dict[str, Any] = {name: -1}
        with pytest.raises(SpecError, match=name):
            MppiSettings(**wrong)


def test_the_tracker_takes_seed_and_settings(make_duet):
    motion = make_duet(0.3)
    runs = [
        track(motion, settings=TrackSettings(controller="mppi", seed=seed, mppi=TINY))
        for seed in (0, 0, 1)
    ]
    assert np.array_equal(runs[0].qpos, runs[1].qpos)
    assert not np.array_equal(runs[0].qpos, runs[2].qpos)
    assert runs[0].metadata["settings"]["mppi"]["samples"] == 8


@pytest.mark.slow
def test_walkers_stay_on_their_feet_where_springs_alone_fall():
    whole = choreograph("walk_together", seed=0)
    people = [Motion(p.fps, p.keypoints[:96], skeleton=p.skeleton) for p in whole.people]
    motion = replace(whole, a=people[0], b=people[1])
    none = AssistLimits(max_force=0, max_torque=0)
    alone = track(motion, settings=TrackSettings(controller="assist", assist=none))
    planned = track(
        motion, settings=TrackSettings(controller="mppi", mppi=MppiSettings(samples=32))
    )
    assert any(alone.fell.values())
    assert planned.fell == {"a": False, "b": False}
    assert not planned.assist.any()
    assert planned.error.mean() < 0.08
