import mujoco
import numpy as np
import pytest

from benchmarks.tracking.leaning import DEPTH, LEANS, leaning
from generator.motion import DuetMotion
from robots.humanoid import HumanBody
from sim.metrics.penetration import overlap
from sim.scene import Scene, build_scene

LEANED = 50
"""A frame at full lean."""


@pytest.fixture(scope="module", params=LEANS)
def duet(request) -> DuetMotion:
    return leaning(request.param)


@pytest.fixture(scope="module")
def scene(duet) -> Scene:
    a, b = (HumanBody.of(person.skeleton) for person in duet.people)
    return build_scene((a, b))


def poses(scene: Scene, duet: DuetMotion) -> np.ndarray:
    rotations = [p.rotations for p in duet.people if p.rotations is not None]
    return scene.qpos(duet.keypoints[:, :, 0], np.stack(rotations, axis=1))


def test_people_press_on_each_other_at_full_lean_and_only_then(duet, scene):
    depth = overlap(scene, poses(scene, duet)[[0, LEANED, -1]]).depth
    np.testing.assert_allclose(depth, [0.0, DEPTH, 0.0], atol=5e-4)


def test_feet_stand_flat_on_the_floor_all_the_time(duet, scene):
    feet = [duet.a.skeleton.index(n) for n in ("left_ankle", "left_foot", "right_foot")]
    np.testing.assert_allclose(np.ptp(duet.keypoints[:, :, feet], axis=0), 0.0, atol=1e-9)
    lowest = overlap(scene, poses(scene, duet)[::20]).lowest
    np.testing.assert_allclose(lowest, 0.0, atol=1e-3)


def test_who_leans_would_fall_alone(duet, scene):
    data = mujoco.MjData(scene.model)
    data.qpos[:] = poses(scene, duet)[LEANED]
    mujoco.mj_kinematics(scene.model, data)
    mujoco.mj_comPos(scene.model, data)
    leans = scene.maps[0]
    mass = data.subtree_com[leans.bodies[0], 0]
    soles = [leans.geoms[duet.a.skeleton.index(n)] for n in ("left_ankle", "left_foot")]
    ends = [data.geom_xpos[g, 0] + s * scene.model.geom_size[g, 0] for g in soles for s in (-1, 1)]
    assert not min(ends) < mass < max(ends)
