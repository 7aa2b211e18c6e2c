from dataclasses import replace

import mujoco
import numpy as np
import pytest

from robots.errors import SimDiverged
from sim.controllers.assist import AssistController
from sim.disturbance import NONE, Disturbance, Push
from sim.reference import make_reference
from sim.scene import AssistLimits, build_scene
from sim.simulation import MAX_SPEED, Simulation

FIELDS = ("qpos", "qvel", "ctrl", "assist", "torque")


@pytest.fixture(scope="module")
def reference(make_duet):
    return make_reference(make_duet(0.5), rate=120)


@pytest.fixture(scope="module")
def scene(reference):
    return build_scene(reference.bodies, assist=AssistLimits())


@pytest.fixture(scope="module")
def controls(scene, reference):
    """What the assist controller commands; followed blindly here."""
    return AssistController().run(scene, reference).ctrl


def follow(run, controls, until):
    """Step under given controls until a tick."""
    while run.tick < until:
        run.data.ctrl[:] = controls[run.tick]
        run.step()


def same(one, other):
    return all(np.array_equal(getattr(one, f), getattr(other, f)) for f in FIELDS)


def test_a_run_starts_on_the_first_pose_and_ends_with_the_reference(scene, reference, controls):
    run = Simulation(scene, reference)
    assert run.tick == 0
    assert run.data.qpos == pytest.approx(
        scene.qpos(reference.root[:1], reference.rotations[:1])[0], abs=1e-12
    )
    follow(run, controls, len(reference.root) - 1)
    assert run.done
    trace = run.trace()
    assert len(trace.qpos) == len(reference.root)
    assert np.array_equal(trace.qpos[-1], run.data.qpos)
    with pytest.raises(ValueError, match="ended"):
        run.step()


def test_a_trace_tells_what_was_set_at_each_tick(scene, reference, controls):
    run = Simulation(scene, reference)
    follow(run, controls, 20)
    trace = run.trace()
    assert np.array_equal(trace.ctrl[:20], controls[:20])
    assert np.array_equal(trace.ctrl[20], controls[19])
    assert np.array_equal(trace.assist[0], trace.assist[1])


def test_a_trace_can_be_taken_at_any_tick(scene, reference, controls):
    run = Simulation(scene, reference)
    assert [len(getattr(run.trace(), f)) for f in FIELDS] == [1] * 5
    follow(run, controls, 1)
    assert [len(getattr(run.trace(), f)) for f in FIELDS] == [2] * 5


def test_going_back_repeats_the_run_to_the_bit(scene, reference, controls):
    run = Simulation(scene, reference)
    follow(run, controls, 20)
    kept = run.snapshot()
    follow(run, controls, 45)
    first = run.trace()
    run.restore(kept)
    assert run.tick == 20
    assert len(run.trace().qpos) == 21
    follow(run, controls, 45)
    assert same(run.trace(), first)


def test_what_was_tried_in_vain_leaves_no_mark(scene, reference, controls):
    run, straight = (Simulation(scene, reference) for _ in range(2))
    follow(straight, controls, 45)
    follow(run, controls, 20)
    kept = run.snapshot()
    follow(run, controls * 0.5, 40)
    run.restore(kept)
    follow(run, controls, 45)
    assert same(run.trace(), straight.trace())


def test_there_is_no_way_to_what_was_forgotten(scene, reference, controls):
    run = Simulation(scene, reference)
    follow(run, controls, 20)
    fork = run.snapshot()
    follow(run, controls, 30)
    end = run.snapshot()
    run.restore(fork)
    follow(run, controls * 0.5, 35)
    with pytest.raises(ValueError, match="forgotten"):
        run.restore(end)
    run.restore(fork)
    assert run.tick == 20


def test_going_back_restores_the_push_and_the_delay(scene, reference, controls):
    push = Push(person="a", force=(80, 0, 0), start=0.1, duration=0.2)
    disturbance = Disturbance(pushes=(push,), latency=0.05)
    run, straight = (Simulation(scene, reference, disturbance) for _ in range(2))
    follow(straight, controls, 45)
    follow(run, controls, 20)
    kept = run.snapshot()
    follow(run, controls * 0.5, 40)
    run.restore(kept)
    follow(run, controls, 45)
    assert same(run.trace(), straight.trace())


@pytest.mark.parametrize("late", [1, 3])
def test_controls_reach_the_actuators_so_many_ticks_late(scene, reference, controls, late):
    """The late run does what a punctual one does under controls shifted by hand."""
    rows = np.concatenate([m.targets.ravel() for m in scene.maps])
    shifted = controls.copy()
    shifted[late:, rows] = controls[:-late, rows]
    shifted[:late, rows] = controls[0, rows]
    punctual = Simulation(scene, reference)
    follow(punctual, shifted, 40)
    run = Simulation(scene, reference, Disturbance(latency=late / 120))
    follow(run, controls, 40)
    assert np.array_equal(run.trace().qpos, punctual.trace().qpos)
    assert np.array_equal(run.trace().ctrl[:40], controls[:40])


def test_latency_is_rounded_to_whole_ticks():
    late = Disturbance(latency=0.02)
    assert [late.ticks_late(rate) for rate in (60, 120, 240)] == [1, 2, 5]


def test_controls_stay_as_they_were_set(scene, reference, controls):
    run = Simulation(scene, reference, Disturbance(latency=0.05))
    follow(run, controls, 10)
    assert np.array_equal(run.data.ctrl, controls[9])


def test_an_undisturbed_run_simulates_the_scene_itself(scene, reference, controls):
    run, plain = Simulation(scene, reference, NONE), mujoco.MjData(scene.model)
    plain.qpos[:], plain.qvel[:] = run.data.qpos, run.data.qvel
    mujoco.mj_forward(scene.model, plain)
    for k in range(10):
        plain.ctrl[:] = controls[k]
        mujoco.mj_step(scene.model, plain)
    follow(run, controls, 10)
    assert np.array_equal(run.data.qpos, plain.qpos)


def test_divergence_says_when_and_keeps_what_happened_before(scene, reference, controls):
    run = Simulation(scene, reference)
    follow(run, controls, 12)
    before = run.trace()
    run.data.qvel[:] = 2 * MAX_SPEED
    with pytest.raises(SimDiverged, match=r"diverged at 0\.108 s") as caught:
        run.step()
    assert caught.value.time == pytest.approx(13 / 120)
    assert same(caught.value.trace, before)
    assert run.tick == 12


def test_a_run_can_go_back_after_divergence(scene, reference, controls):
    run, straight = (Simulation(scene, reference) for _ in range(2))
    follow(straight, controls, 20)
    follow(run, controls, 12)
    kept = run.snapshot()
    run.data.qvel[:] = np.nan
    with pytest.raises(SimDiverged):
        run.step()
    run.restore(kept)
    follow(run, controls, 20)
    assert same(run.trace(), straight.trace())


def test_no_trace_holds_a_number_that_is_none(scene, reference, controls):
    run = Simulation(scene, reference)
    follow(run, controls, 5)
    run.data.ctrl[3] = np.nan
    with pytest.raises(SimDiverged, match=r"control diverged at 0\.042 s") as caught:
        run.step()
    assert all(np.isfinite(getattr(caught.value.trace, f)).all() for f in FIELDS)


def test_a_first_pose_that_is_not_finite_is_divergence_at_the_start(scene, reference):
    root = reference.root.copy()
    root[0, 0, 2] = np.nan
    with pytest.raises(SimDiverged, match=r"at 0\.000 s") as caught:
        Simulation(scene, replace(reference, root=root))
    assert caught.value.trace is None


def test_a_tick_may_be_several_steps(reference, controls):
    fine = build_scene(reference.bodies, timestep=1 / 240, assist=AssistLimits())
    run = Simulation(fine, reference)
    follow(run, controls, 12)
    assert run.data.time == pytest.approx(0.1)
