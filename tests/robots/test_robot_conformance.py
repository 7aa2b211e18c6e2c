"""What every built-in robot folder promises; robots broken on purpose are in test_conformance."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from robots.conformance import check_robot
from robots.mjcf import load_mjspec
from robots.registry import load_robot, robot_names
from robots.servos import SERVO_MODELS
from robots.spec import RobotSpec


@pytest.fixture(params=robot_names())
def robot(request: pytest.FixtureRequest) -> RobotSpec:
    return load_robot(request.param)


@pytest.fixture
def model(robot: RobotSpec):
    return load_mjspec(robot).compile()


@pytest.fixture
def at_rest(robot: RobotSpec, model):
    return posed(robot, model, robot.rest)


def posed(robot: RobotSpec, model, angles):
    data = mujoco.MjData(model)
    for joint, angle in zip(robot.joints, angles, strict=True):
        data.joint(joint.name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    return data


def landmark_position(robot: RobotSpec, model, data, name: str) -> np.ndarray:
    landmark = robot.landmarks[name]
    body = model.body(landmark.body).id
    return data.xpos[body] + data.xmat[body].reshape(3, 3) @ landmark.pos


def test_the_two_robots_of_the_project_are_there():
    assert {"op3", "marionette"} <= set(robot_names())


def test_every_rule_is_kept(robot: RobotSpec):
    assert [str(finding) for finding in check_robot(robot)] == []


def test_the_name_is_that_of_the_folder(robot: RobotSpec):
    assert robot.name == robot.folder.name
    assert robot.title


def test_every_hinge_has_an_actuator_as_strong_as_its_servo(robot: RobotSpec, model):
    hinges = {
        model.joint(j).name
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
    }
    assert hinges == set(robot.joint_names)
    driven = {model.joint(model.actuator_trnid[i, 0]).name: i for i in range(model.nu)}
    assert set(driven) == hinges
    for joint in robot.joints:
        force = model.actuator_forcerange[driven[joint.name]]
        assert force == pytest.approx([-joint.max_effort, joint.max_effort]), joint.name


def test_no_joint_is_promised_more_than_its_servo_gives(robot: RobotSpec):
    for joint in robot.joints:
        hardware = SERVO_MODELS[joint.servo.model]
        power = hardware.no_load_speed * hardware.stall_torque
        assert joint.max_velocity * joint.max_effort <= power * (1 + 1e-9), joint.name


def test_a_free_robot_stands_on_the_floor_and_over_its_feet(robot: RobotSpec, model, at_rest):
    lowest = min(lowest_point(model, at_rest, g) for g in range(model.ngeom))
    if robot.base == "fixed":
        assert lowest >= -1e-6
        return
    assert lowest == pytest.approx(0.0, abs=1e-3)
    corners = []
    for side in ("left", "right"):
        body = model.body(robot.landmarks[f"{side}_foot"].body).id
        for g in range(model.ngeom):
            if model.geom_bodyid[g] == body and lowest_point(model, at_rest, g) < 1e-3:
                corners += [*box_corners(model, at_rest, g)]
    feet = np.array(corners)[:, :2]
    centre = at_rest.subtree_com[1][:2]
    assert (feet.min(axis=0) + 0.005 < centre).all()
    assert (centre < feet.max(axis=0) - 0.005).all()


def box_corners(model, data, g: int) -> np.ndarray:
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    return data.geom_xpos[g] + signs * model.geom_size[g] @ data.geom_xmat[g].reshape(3, 3).T


def lowest_point(model, data, g: int) -> float:
    """Exact for the shapes robots are drawn with."""
    height, axis = data.geom_xpos[g][2], data.geom_xmat[g].reshape(3, 3)[2]
    size = model.geom_size[g]
    match model.geom_type[g]:
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return height - size[0]
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return height - size[0] - abs(axis[2]) * size[1]
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return height - size[0] * np.hypot(axis[0], axis[1]) - abs(axis[2]) * size[1]
        case mujoco.mjtGeom.mjGEOM_BOX:
            return height - np.abs(axis) @ size
        case other:
            pytest.fail(f"geom of type {other} in a robot that is drawn without meshes")


def test_left_and_right_mirror_each_other_in_every_pose(robot: RobotSpec, model):
    """Mirrored angles give mirrored landmarks, and limits, rest and servos are mirrored too."""
    zero = posed(robot, model, np.zeros(len(robot.joints)))
    rng = np.random.default_rng(7)
    drawn = dict(zip(robot.joint_names, rng.uniform(robot.lower, robot.upper), strict=True))
    pose, mirrored = {}, {}
    for name, angle in drawn.items():
        if name.startswith("r_"):
            continue
        joint = robot.joint(name)
        axis = zero.xaxis[model.joint(name).id]
        twin = robot.joint("r_" + name[2:]) if name.startswith("l_") else joint
        # A rotation axis is a pseudovector: the mirror turns its x and z over.
        other = zero.xaxis[model.joint(twin.name).id]
        sign = float(np.sign(other @ (-axis[0], axis[1], -axis[2])))
        assert other * sign == pytest.approx([-axis[0], axis[1], -axis[2]], abs=1e-6), name
        ends = sorted((sign * joint.lower, sign * joint.upper))
        assert ends == pytest.approx([twin.lower, twin.upper]), name
        assert twin.rest == pytest.approx(sign * joint.rest), name
        assert twin.servo.model == joint.servo.model, name
        pose[name], mirrored[twin.name] = angle, sign * angle
        if twin is not joint:
            pose[twin.name] = drawn[twin.name]
            mirrored[name] = sign * drawn[twin.name]
    first = posed(robot, model, [pose[name] for name in robot.joint_names])
    second = posed(robot, model, [mirrored[name] for name in robot.joint_names])
    for name in robot.landmarks:
        twin = name.replace("left_", "r#").replace("right_", "left_").replace("r#", "right_")
        there = landmark_position(robot, model, first, name) * (1, -1, 1)
        assert landmark_position(robot, model, second, twin) == pytest.approx(there, abs=1e-6), name


def test_the_model_is_stable_under_its_own_servos(robot: RobotSpec, model):
    """Half a second of holding the rest pose: nothing falls over, bursts or drifts."""
    data = posed(robot, model, robot.rest)
    for i in range(model.nu):
        name = model.joint(model.actuator_trnid[i, 0]).name
        data.ctrl[i] = robot.joint(name).rest
    if robot.base == "free":
        model.opt.gravity[:] = 0  # servos alone; standing is a matter of the floor
    for _ in range(int(0.5 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    angles = [data.joint(name).qpos[0] for name in robot.joint_names]
    assert angles == pytest.approx(list(robot.rest), abs=0.1)


def test_a_folder_that_is_moved_still_loads(robot: RobotSpec, tmp_path: Path):
    for file in robot.folder.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    moved = load_robot(tmp_path)
    assert moved.joints == robot.joints
    assert load_mjspec(moved).compile().nq == load_mjspec(robot).compile().nq


def test_the_op3_has_the_measures_of_the_real_one():
    """Against what its maker publishes: op3_description, op3_kinematics_dynamics, OP3.robot."""
    robot = load_robot("op3")
    model = load_mjspec(robot).compile()
    data = posed(robot, model, np.zeros(len(robot.joints)))
    at = {name: landmark_position(robot, model, data, name) for name in robot.landmarks}

    def apart(one: str, other: str) -> float:
        return float(np.linalg.norm(at[one] - at[other]))

    assert (model.nq, model.nv, model.nu) == (27, 26, 20)
    assert model.body_subtreemass[0] == pytest.approx(3.15, abs=0.01)
    assert apart("left_shoulder", "right_shoulder") == pytest.approx(0.177, abs=1e-3)
    assert apart("left_hip", "right_hip") == pytest.approx(0.108, abs=1e-3)
    for side in ("left", "right"):
        assert apart(f"{side}_shoulder", f"{side}_elbow") == pytest.approx(0.0904, abs=1e-4)
        assert apart(f"{side}_elbow", f"{side}_hand") == pytest.approx(0.150, abs=1e-3)
        assert apart(f"{side}_hip", f"{side}_knee") == pytest.approx(0.110, abs=1e-4)
        assert apart(f"{side}_knee", f"{side}_ankle") == pytest.approx(0.110, abs=1e-4)
    sides = ("sho_pitch", "sho_roll", "el", "hip_yaw", "hip_roll", "hip_pitch", "knee")
    sides += ("ank_pitch", "ank_roll")
    in_order = [f"{side}_{part}" for part in sides for side in "rl"] + ["head_pan", "head_tilt"]
    assert [(j.servo.id, j.name) for j in robot.joints] == list(enumerate(in_order, start=1))
    share = {"r_sho_roll": (-0.5, 0.3), "l_sho_roll": (-0.3, 0.5), "r_knee": (-0.7, 0.1)}
    share |= {"l_knee": (-0.1, 0.7)}
    by_part = {"hip_yaw": 0.45, "hip_roll": 0.3, "hip_pitch": 0.4, "ank_pitch": 0.45}
    by_part |= {"ank_roll": 0.45, "sho_pitch": 0.5, "el": 0.5, "head_pan": 0.5, "head_tilt": 0.5}
    for joint in robot.joints:
        part = joint.name.removeprefix("r_").removeprefix("l_")
        low, high = share.get(joint.name) or (-by_part[part], by_part[part])
        assert (joint.lower, joint.upper) == pytest.approx((low * np.pi, high * np.pi)), joint.name


# joint, its angle, a landmark, and the direction in which the angle moves it from the zero pose
MOVES = [
    ("op3", {"r_sho_roll": -np.pi / 2}, "right_hand", (0, 0, -1)),
    ("op3", {"l_sho_roll": np.pi / 2}, "left_hand", (0, 0, -1)),
    ("op3", {"r_sho_roll": -np.pi / 2, "r_sho_pitch": 0.5}, "right_hand", (1, 0, 0)),
    ("op3", {"l_sho_roll": np.pi / 2, "l_sho_pitch": -0.5}, "left_hand", (1, 0, 0)),
    ("op3", {"r_hip_pitch": 0.5}, "right_knee", (1, 0, 0)),
    ("op3", {"l_hip_pitch": -0.5}, "left_knee", (1, 0, 0)),
    ("op3", {"r_knee": -0.5}, "right_ankle", (-1, 0, 0)),
    ("op3", {"l_knee": 0.5}, "left_ankle", (-1, 0, 0)),
    ("op3", {"r_ank_pitch": 0.5}, "right_foot", (0, 0, -1)),
    ("op3", {"l_ank_pitch": -0.5}, "left_foot", (0, 0, -1)),
    ("marionette", {"r_sho_roll": 1.0}, "right_hand", (0, 0, -1)),
    ("marionette", {"l_sho_roll": 1.0}, "left_hand", (0, 0, -1)),
    ("marionette", {"r_elbow": 1.0}, "right_hand", (1, 0, 0)),
    ("marionette", {"l_elbow": 1.0}, "left_hand", (1, 0, 0)),
    ("marionette", {"l_sho_roll": 1.4, "l_sho_pitch": 1.0}, "left_hand", (1, 0, 0)),
    ("marionette", {"waist": 0.5}, "left_hand", (-1, 0, 0)),
]


@pytest.mark.parametrize(("name", "angles", "landmark", "direction"), MOVES)
def test_an_angle_moves_a_limb_the_right_way(name, angles, landmark, direction):
    robot = load_robot(name)
    model = load_mjspec(robot).compile()
    ends = [
        landmark_position(robot, model, posed(robot, model, pose), landmark)
        for pose in (
            [0.0] * len(robot.joints),
            [angles.get(joint, 0.0) for joint in robot.joint_names],
        )
    ]
    assert float((ends[1] - ends[0]) @ direction) > 0.01
