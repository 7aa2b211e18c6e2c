"""A partner who bears weight gives way, and a plan can know."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from benchmarks.tracking.leaning import leaning
from generator.given import cut_motion
from robots.errors import SpecError
from sim.controllers.ilqr.controller import IlqrController
from sim.controllers.ilqr.person import CARRIAGE, PersonModel, person_model
from sim.controllers.ilqr.settings import IlqrSettings
from sim.controllers.nominal import nominal_targets
from sim.reference import Reference, make_reference
from sim.scene import Scene, build_scene

RATE, STEPS = 60.0, 30


@pytest.fixture(scope="module")
def reference() -> Reference:
    """Half a second from full lean on: b bears a, who threw both hands against its chest."""
    return make_reference(cut_motion(leaning("shove"), 1.3, 1.9), rate=RATE)


@pytest.fixture(scope="module")
def scene(reference: Reference) -> Scene:
    return build_scene(reference.bodies, timestep=1 / RATE)


def targets(scene: Scene, reference: Reference, ankles: float) -> np.ndarray:
    """Return controls ``[STEPS, nu]``, with a's ankles turned by an angle."""
    nominal = nominal_targets(scene, reference, 0.0)[:STEPS]
    for side in ("left", "right"):
        nominal[:, 0, scene.bodies[0].skeleton.index(f"{side}_ankle") - 1, 1] += ankles
    out = np.zeros((STEPS, scene.model.nu))
    for p, at in enumerate(scene.maps):
        out[:, at.targets.reshape(-1)] = nominal[:, p].reshape(STEPS, -1)
    return out


def simulated(scene: Scene, reference: Reference, controls: np.ndarray):
    """Return ``qpos`` over time, and the level force ``[STEPS, 2]`` N of b on a."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos(reference.root[:1], reference.rotations[:1])[0]
    path, pushes, force = [data.qpos.copy()], [], np.zeros(6)
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(scene.model, data)
        push = np.zeros(3)
        for c in range(data.ncon):
            of_b = np.isin(data.contact.geom[c], scene.maps[1].geoms)
            of_a = np.isin(data.contact.geom[c], scene.maps[0].geoms)
            if of_a.any() and of_b.any():
                mujoco.mj_contactForce(scene.model, data, c, force)
                world = data.contact.frame[c].reshape(3, 3).T @ force[:3]
                push += world if of_b[0] else -world
        path.append(data.qpos.copy())
        pushes.append(push[:2])
    return np.array(path), np.array(pushes)


def foreseen(person: PersonModel, start, controls, positions, turns, pushes) -> np.ndarray:
    """Return where a's pelvis is at the end by its planning model."""
    data = mujoco.MjData(person.model)
    data.qpos[:] = person.padded(start)
    for h, control in enumerate(controls):
        person.set_ghost(data, positions[h], turns[h], pushes[h])
        data.ctrl[person.targets] = control
        mujoco.mj_step(person.model, data)
    return data.qpos[:3].copy()


def test_who_leans_on_a_partner_foresees_that_the_partner_gives_way(scene, reference):
    planned, pushes = simulated(scene, reference, targets(scene, reference, 0.0))
    other = person_model(scene, 1)
    poses = other.poses(planned[:, other.qpos])
    controls = targets(scene, reference, 0.12)
    true = simulated(scene, reference, controls)[0][-1]
    error = {}
    for ghost in (True, "yielding"):
        person = person_model(scene, 0, ghost=ghost)
        own = controls[:, scene.maps[0].targets.reshape(-1)]
        pelvis = foreseen(person, planned[0, person.qpos], own, *poses, pushes)
        error[ghost] = float(np.linalg.norm(pelvis - true[person.qpos][:3]))
    assert error[True] > 0.03
    assert error["yielding"] < 0.4 * error[True]


def test_nothing_but_the_partners_weight_holds_a_ghost_that_yields(scene, reference):
    person = person_model(scene, 0, ghost="yielding")
    data = mujoco.MjData(person.model)
    start = scene.qpos(reference.root[:1], reference.rotations[:1])[0]
    data.qpos[:] = person.padded(start[person.qpos])
    other = person_model(scene, 1)
    positions, turns = other.poses(start[None, other.qpos])
    aside = positions[0] + [3.0, 0.0, 0.0]
    for _ in range(STEPS):
        person.set_ghost(data, aside, turns[0], np.array([0.0, 50.0]))
        mujoco.mj_step(person.model, data)
    weight = scene.bodies[1].weight
    assert person.model.body(CARRIAGE).subtreemass[0] == pytest.approx(weight)
    expected = [0.0, 50.0 / weight * STEPS / RATE]
    np.testing.assert_allclose(data.qvel[-2:], expected, atol=1e-9)


def test_people_whose_ghosts_yield_bear_each_other(scene, reference):
    short = replace(
        reference,
        root=reference.root[:12],
        rotations=reference.rotations[:12],
        keypoints=reference.keypoints[:12],
    )
    settings = IlqrSettings(ghost="yielding", horizon=0.2, recovery=0, threads=1)
    trace = IlqrController(settings=settings).run(scene, short)
    assert len(trace.qpos) == 12
    assert "ended" not in trace.facts
    off = np.linalg.norm(scene.keypoints(trace.qpos) - short.keypoints, axis=-1)
    assert off.mean() < 0.03


def test_an_unknown_kind_of_ghost_is_refused():
    with pytest.raises(SpecError, match=r"ilqr\.ghost.*yielding"):
        IlqrSettings(ghost="holy")  # pyright: ignore[reportArgumentType]
