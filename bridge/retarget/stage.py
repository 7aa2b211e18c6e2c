"""Two robots in one MuJoCo model: where their numbers lie, and where their landmarks are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.errors import SpecError
from robots.mjcf import load_mjspec
from robots.skeleton import FloatArray
from robots.spec import RobotSpec

PEOPLE = ("a", "b")
LANDMARK = "landmark:"
"""Prefix of the sites that mark landmarks."""

BLOCK = 1.0
"""Length of the block under a fixed base, m: the highest it can be raised in a picture."""


@dataclass(frozen=True, slots=True, eq=False)
class Actor:
    """Where one robot's numbers lie in the arrays of the stage's model."""

    person: str
    """``a`` or ``b``."""
    robot: RobotSpec
    """What it is."""
    qpos: NDArray[np.intp]
    """``[D]`` addresses of its joints in ``qpos``, in the order of the robot's joints."""
    dof: NDArray[np.intp]
    """``[D]`` addresses of its joints in ``qvel``."""
    root: int
    """Body id of its root."""
    base_qpos: int
    """Address of the base pose (7) in ``qpos``; -1 for a fixed base."""
    sites: dict[str, int]
    """Site id of each landmark."""

    @property
    def free(self) -> bool:
        """Whether the base moves."""
        return self.base_qpos >= 0


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """The compiled model of two robots and a floor."""

    spec: Any
    """``mujoco.MjSpec`` it was compiled from, for pictures."""
    model: Any
    """``mujoco.MjModel``; bodies carry the prefixes ``a/`` and ``b/``."""
    actors: tuple[Actor, Actor]
    """Who plays a and b."""

    def place(self, index: int, position: NDArray, yaw: float) -> None:
        """Put the fixed base of a robot somewhere: ``position [3]`` m and heading rad."""
        root = self.actors[index].root
        self.model.body_pos[root] = position
        self.model.body_quat[root] = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]

    def base(self, index: int, qpos: NDArray) -> FloatArray:
        """Return the base poses ``[N, 7]`` (m, wxyz) of a robot in ``qpos [N, nq]``."""
        actor = self.actors[index]
        if actor.free:
            return np.array(qpos[:, actor.base_qpos : actor.base_qpos + 7])
        pose = np.concatenate([self.model.body_pos[actor.root], self.model.body_quat[actor.root]])
        return np.tile(pose, (len(qpos), 1))

    def landmarks(self, qpos: NDArray) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Return per robot the path ``[N, 3]`` m of every landmark over ``qpos [N, nq]``."""
        data = mujoco.MjData(self.model)
        points = np.empty((len(qpos), self.model.nsite, 3))
        for t, pose in enumerate(qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(self.model, data)
            points[t] = data.site_xpos
        a, b = (
            {name: points[:, site] for name, site in actor.sites.items()} for actor in self.actors
        )
        return a, b


def build_stage(robots: tuple[RobotSpec, RobotSpec]) -> Stage:
    """Return the stage of two robots, both at the origin.

    Raises:
        SpecError: MuJoCo refuses a robot.
    """
    scene = mujoco.MjSpec()
    scene.compiler.degree = False
    scene.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], rgba=[0.8, 0.8, 0.8, 1]
    )
    for person, robot in zip(PEOPLE, robots, strict=True):
        child = load_mjspec(robot)
        for key in list(child.keys):
            child.delete(key)
        # Options belong to the stage; where they differ MuJoCo would warn on the terminal.
        child.option.timestep = scene.option.timestep
        child.option.integrator = scene.option.integrator
        for landmark in robot.landmarks.values():
            child.body(landmark.body).add_site(
                name=LANDMARK + landmark.name, pos=landmark.pos, group=4
            )
        if robot.base == "fixed":
            _add_block(child)
        scene.attach(child, prefix=f"{person}/", frame=scene.worldbody.add_frame())
    try:
        model = scene.compile()
    except ValueError as error:
        raise SpecError(f"the two robots do not fit one scene: {error}") from error
    a, b = (_actor(model, person, robot) for person, robot in zip(PEOPLE, robots, strict=True))
    return Stage(scene, model, (a, b))


def _add_block(child: mujoco.MjSpec) -> None:
    """Hang a block under a fixed base: in the floor, unless the robot is raised onto it."""
    root = child.worldbody.first_body()
    root.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[0.05, BLOCK / 2, 0.0],
        pos=[0.0, 0.0, -BLOCK / 2],
        rgba=[0.5, 0.42, 0.33, 1.0],
        contype=0,
        conaffinity=0,
        mass=0.0,
        group=1,
    )


def _actor(model: Any, person: str, robot: RobotSpec) -> Actor:
    try:
        joints = [model.joint(f"{person}/{joint.name}") for joint in robot.joints]
    except KeyError as error:
        raise SpecError(
            f"a joint of robot.toml is not in the model: {error}",
            where=robot.name,
            hint=f"see 'pasdedeux robots {robot.name}'",
        ) from error
    sites = {name: model.site(f"{person}/{LANDMARK}{name}").id for name in robot.landmarks}
    body = int(model.jnt_bodyid[joints[0].id])
    root = int(model.body_rootid[body])
    base = -1
    if model.body_jntnum[root]:
        first = int(model.body_jntadr[root])
        if model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE:
            base = int(model.jnt_qposadr[first])
    return Actor(
        person,
        robot,
        np.array([model.jnt_qposadr[joint.id] for joint in joints]),
        np.array([model.jnt_dofadr[joint.id] for joint in joints]),
        root,
        base,
        sites,
    )
