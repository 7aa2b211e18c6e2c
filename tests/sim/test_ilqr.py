"""Two people keep their balance by planning half a second ahead."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from generator.choreographer import choreograph
from generator.motion import Contact, DuetMotion, Motion
from robots.errors import SimDiverged, SpecError
from robots.skeleton import FloatArray
from sim.controllers.ilqr.controller import IlqrController, _Run
from sim.controllers.ilqr.cost import TrackingCost
from sim.controllers.ilqr.knots import KnotDerivatives, Path
from sim.controllers.ilqr.person import person_model
from sim.controllers.ilqr.settings import IlqrSettings, Weights
from sim.controllers.ilqr.touch import RAMP, body_point, find_touches
from sim.disturbance import NONE
from sim.outcome import Cost, outcome
from sim.reference import Reference, make_reference
from sim.scene import AssistLimits, Scene, build_scene
from sim.simulation import reference_qvel
from sim.track import TrackSettings, track

RATE = 60.0


def cut(motion: DuetMotion, start: float, end: float) -> DuetMotion:
    """Return a part of a motion; touches move along."""
    first, last = round(start * motion.fps), round(end * motion.fps)
    people = [
        replace(
            person,
            keypoints=person.keypoints[first:last],
            rotations=None if person.rotations is None else person.rotations[first:last],
            foot_contacts=None,
        )
        for person in motion.people
    ]
    labels = tuple(replace(c, start=c.start - start, end=c.end - start) for c in motion.contacts)
    inside = tuple(c for c in labels if c.start >= 0 and c.end <= end - start)
    return replace(motion, a=people[0], b=people[1], contacts=inside)


@pytest.fixture(scope="module")
def motion() -> DuetMotion:
    return cut(choreograph("fist_bump", seed=0), 1.3, 2.7)


@pytest.fixture(scope="module")
def reference(motion: DuetMotion) -> Reference:
    return make_reference(motion, rate=RATE)


@pytest.fixture(scope="module")
def scene(reference: Reference) -> Scene:
    return build_scene(reference.bodies, timestep=1 / RATE)


@pytest.fixture(scope="module")
def rollout(motion: DuetMotion):
    return track(motion)


def test_people_without_any_hand_from_above_stay_up_and_close_to_the_reference(rollout):
    assert not any(rollout.fell.values())
    assert np.abs(rollout.assist).max() == 0
    assert rollout.error.mean() < 0.02


def test_hands_that_are_to_meet_do(rollout, motion):
    contact = motion.contacts[0]
    a, b = rollout.as_motion().people
    gap = np.linalg.norm(a.point(contact.a) - b.point(contact.b), axis=1)
    assert gap.min() < contact.gap + 0.02


@pytest.mark.slow
def test_the_same_seed_gives_the_same_rollout_on_one_thread_or_two(motion):
    short = cut(motion, 0.3, 0.9)
    one, two = (
        track(short, settings=TrackSettings(ilqr=IlqrSettings(threads=threads)))
        for threads in (1, 2)
    )
    assert np.array_equal(one.qpos, two.qpos)


@pytest.mark.slow
def test_springs_without_plans_fall_where_plans_stand(motion):
    walk = cut(choreograph("walk_together", seed=0), 1.0, 2.8)
    springs = track(
        walk,
        settings=TrackSettings(controller="assist", assist=AssistLimits(max_force=0, max_torque=0)),
    )
    plans = track(walk)
    assert any(springs.fell.values())
    assert not any(plans.fell.values())


def test_who_is_lost_is_brought_back_and_the_report_says_so(scene, reference, monkeypatch):
    from sim.controllers.ilqr import controller

    monkeypatch.setattr(controller, "TROUBLE", 1e-3)
    short = replace(
        reference,
        root=reference.root[:20],
        rotations=reference.rotations[:20],
        keypoints=reference.keypoints[:20],
    )
    settings = IlqrSettings(recovery=2, horizon=0.2)
    trace = IlqrController(settings=settings).run(scene, short)
    events = trace.facts["recoveries"]
    assert len(trace.qpos) == 20
    assert len(events) == 2
    assert all(e["back_to"] <= e["lost_at"] for e in events)


def test_a_fall_that_nothing_saves_ends_the_run_and_says_when(scene, reference, monkeypatch):
    from sim.controllers.ilqr import controller

    monkeypatch.setattr(controller, "TROUBLE", 1e-3)
    monkeypatch.setattr(controller, "FALL_DISTANCE", 1.5e-3)
    monkeypatch.setattr(controller, "_AFTER_FALL", 0.05)
    trace = IlqrController(settings=IlqrSettings(recovery=0, horizon=0.2)).run(scene, reference)
    assert len(trace.qpos) < len(reference.root)
    assert "fell at" in trace.facts["ended"]["why"]


def test_of_tries_that_diverge_the_one_that_came_furthest_is_kept(scene, reference, monkeypatch):
    ends = iter([24, 8])
    settings = IlqrSettings(recovery=1, horizon=0.1, threads=1)
    with ThreadPoolExecutor(1) as pool:
        run = _Run(settings, scene, reference, NONE, pool)
        advance, end = run._advance, [next(ends)]

        def failing() -> None:
            if run.simulation.tick == end[0]:
                end[0] = next(ends, 0)
                raise np.linalg.LinAlgError
            advance()

        monkeypatch.setattr(run, "_advance", failing)
        with pytest.raises(SimDiverged, match=r"diverged at 0\.400 s") as caught:
            run.to_end(None)
    assert len(run.recovery.events) == 1
    assert len(caught.value.trace.qpos) == 25


def test_what_planners_keep_does_not_grow_with_the_clip(scene, reference):
    settings = IlqrSettings(horizon=0.1, replan=6, threads=1)
    short = replace(
        reference,
        root=reference.root[:40],
        rotations=reference.rotations[:40],
        keypoints=reference.keypoints[:40],
    )
    with ThreadPoolExecutor(1) as pool:
        run = _Run(settings, scene, short, NONE, pool)
        run.to_end(None)
    for planner in run.planners:
        assert 0 < len(planner.cost._hessians) <= planner.horizon + 2
        assert len(planner.derivatives._kept) <= planner.horizon + 1


@pytest.mark.parametrize(("allowed", "most"), [(8, 2), (1, 1), (0, 0)])
def test_a_short_motion_is_not_tried_many_times(scene, reference, allowed, most):
    settings = IlqrSettings(recovery=allowed, threads=1)
    with ThreadPoolExecutor(1) as pool:
        run = _Run(settings, scene, reference, NONE, pool)
    assert len(reference.root) < 3 * RATE
    assert run._most_tries == most


def hovering(points: FloatArray) -> FloatArray:
    return points + np.array([0.0, 0.0, 0.6])


def jumping(points: FloatArray) -> FloatArray:
    points[6:, :, 0] -= 1.0
    return points


@pytest.mark.slow
@pytest.mark.parametrize("change", [hovering, jumping])
def test_what_nobody_can_do_ends_and_says_when_and_why(motion, change):
    people = [Motion(p.fps, change(p.keypoints.copy()), skeleton=p.skeleton) for p in motion.people]
    impossible = replace(motion, a=people[0], b=people[1])
    hasty = IlqrSettings(horizon=0.2, recovery=1, threads=1)
    rollout = track(impossible, settings=TrackSettings(ilqr=hasty))
    assert rollout.ended is not None
    assert rollout.ended["time"] < motion.duration - 0.2
    assert "at 0." in rollout.ended["why"]
    assert len(rollout.metadata["recoveries"]) == 1
    assert not outcome(rollout, Cost(1.0, 1.0)).success


@pytest.mark.parametrize("p", [0, 1])
@pytest.mark.parametrize("assist", [None, AssistLimits()])
def test_the_planning_model_moves_as_the_scene_does_where_nobody_touches(reference, p, assist):
    scene = build_scene(reference.bodies, timestep=1 / RATE, assist=assist)
    person = person_model(scene, p)
    whole, own = mujoco.MjData(scene.model), mujoco.MjData(person.model)
    whole.qpos[:] = scene.qpos(reference.root[:1], reference.rotations[:1])[0]
    rng = np.random.default_rng(p)
    whole.qvel[:] = 0.1 * rng.standard_normal(scene.model.nv)
    control = 0.1 * rng.standard_normal(person.nu)
    whole.ctrl[scene.maps[p].targets.reshape(-1)] = control
    own.qpos[:], own.qvel[:] = whole.qpos[person.qpos], whole.qvel[person.qvel]
    own.ctrl[person.targets] = control
    own.mocap_pos[person.ghost] = [50.0, 0.0, 0.0]
    if assist is not None:
        own.mocap_quat[person.at.mocap] = whole.mocap_quat[scene.maps[p].mocap]
    for _ in range(5):
        mujoco.mj_step(scene.model, whole)
        mujoco.mj_step(person.model, own)
    np.testing.assert_allclose(own.qpos, whole.qpos[person.qpos], atol=1e-6)


def test_the_ghost_stops_a_hand(scene, reference):
    person = person_model(scene, 0)
    data = mujoco.MjData(person.model)
    data.qpos[:] = scene.qpos(reference.root[:1], reference.rotations[:1])[0][person.qpos]
    positions, turns = person.poses(data.qpos[None])
    data.mocap_pos[person.ghost] = positions[0] + [0.0, 0.03, 0.0]
    data.mocap_quat[person.ghost] = turns[0]
    mujoco.mj_forward(person.model, data)
    assert any(set(pair) & set(person.at.geoms.tolist()) for pair in data.contact.geom.tolist())
    assert data.ncon > 8


def test_the_cost_is_the_square_of_what_its_parts_say(scene, reference):
    person = person_model(scene, 0)
    goal = scene.qpos(reference.root, reference.rotations)[:, person.qpos]
    speed = reference_qvel(scene, reference)[:, person.qvel]
    weights = Weights(
        root_position=0, root_rotation=0, joint=0, joint_velocity=0, foot_rotation=0,
        foot_velocity=0, com=7.0, com_velocity=0, angular_momentum=0, body=0,
    )  # fmt: skip
    cost = TrackingCost(person, goal, speed, weights)
    moved = goal[3].copy()
    moved[:3] += [0.02, -0.01, 0.03]
    e = cost.error(3, moved, speed[3]).reshape(2, -1)
    for _ in range(2):
        square = np.einsum("bi,bij,bj", e, cost.hessians([3])[0], e)
        assert 0.5 * square == pytest.approx(0.5 * 7.0 * (4e-4 + 1e-4 + 9e-4), rel=1e-5)
        cost.forget(10)


def test_beyond_its_end_the_reference_stands_still(scene, reference):
    person = person_model(scene, 1)
    goal = scene.qpos(reference.root, reference.rotations)[:, person.qpos]
    cost = TrackingCost(person, goal, np.zeros((len(goal), person.nv)), Weights())
    np.testing.assert_allclose(cost.error(10_000, goal[-1], np.zeros(person.nv)), 0, atol=1e-12)


def test_touches_last_from_before_to_after_their_label(scene, reference):
    poses = [
        person_model(scene, p).poses(
            scene.qpos(reference.root, reference.rotations)[:, person_model(scene, p).qpos]
        )
        for p in range(2)
    ]
    label = Contact("right_hand", "left_hand", 0.5, 0.8, 0.06)
    (a,), (b,) = find_touches(reference.bodies, poses, [label], RATE)
    times = reference.times
    np.testing.assert_array_equal(a.weight[(times >= 0.5) & (times <= 0.8)], 1)
    assert not a.weight[(times < 0.5 - RAMP) | (times > 0.8 + RAMP)].any()
    np.testing.assert_allclose(a.offset, -b.offset)


def test_hands_that_come_close_without_a_label_are_taken_to_touch(scene, reference):
    people = [person_model(scene, p) for p in range(2)]
    goal = scene.qpos(reference.root, reference.rotations)
    poses = [person.poses(goal[:, person.qpos]) for person in people]
    (a,), _ = find_touches(reference.bodies, poses, [], RATE)
    right = body_point(reference.bodies[0], "right_hand")
    assert a.own.body == right.body
    assert a.weight.max() == 1


def test_derivatives_are_kept_while_the_plan_stays_and_taken_anew_when_it_moves(scene, reference):
    person = person_model(scene, 0, ghost=False)
    qpos = scene.qpos(reference.root, reference.rotations)[:4, person.qpos]
    qpos[1:, 0] += [0.1, 0.2, 0.3]  # far from each other
    H = 3
    control = np.zeros((H, person.nu))
    still, rest = np.zeros((H + 1, person.nv)), np.zeros((H, person.nv))
    path = Path(qpos, still, control, rest, [b""] * H, 0.0)
    knots = KnotDerivatives(person, 1.0, exact=False)
    first = knots.along(0, path, lambda data, tick: None)
    knots.along(0, path, lambda data, tick: None)
    assert knots.taken == H
    moved = replace(path, control=control + 0.06)
    knots.along(0, moved, lambda data, tick: None)
    assert knots.taken == 2 * H
    knots.along(0, replace(moved, touching=[b"hand"] * H), lambda data, tick: None)
    assert knots.taken == 3 * H
    assert [c.shape for c in first.change] == [(person.nv, 2 * person.nv + person.nu)] * H


def test_derivatives_serve_the_ticks_beside_their_own_where_nothing_moves(scene, reference):
    person = person_model(scene, 0, ghost=False)
    qpos = np.repeat(scene.qpos(reference.root, reference.rotations)[:1, person.qpos], 4, axis=0)
    H = 3
    control, rest = np.zeros((H, person.nu)), np.zeros((H, person.nv))
    path = Path(qpos, np.zeros((H + 1, person.nv)), control, rest, [b""] * H, 0.0)
    knots = KnotDerivatives(person, 1.0, exact=False)
    knots.along(0, path, lambda data, tick: None)
    assert knots.taken == 1


def test_settings_out_of_range_are_refused():
    with pytest.raises(SpecError, match=r"horizon.*0\.1 to 3"):
        IlqrSettings(horizon=10)
