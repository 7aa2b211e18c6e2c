"""From any file of this project to clips that can be drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from bridge.retarget.stage import build_stage
from bridge.sources import ROLLOUT_SCHEMA, MotionRequest, load_robots, read, schema_of
from bridge.trajectory import SCHEMA as TRAJECTORY_SCHEMA
from bridge.trajectory import JointTrajectory
from generator.motion import DuetMotion
from robots.errors import MotionFileError
from sim.clip import Clip
from sim.reference import make_reference
from sim.render import colour_people, dress
from sim.rollout import Rollout
from sim.scene import build_scene

CANVAS = 1024
"""Largest edge of a picture, pixels."""


def clip_of_motion(motion: DuetMotion) -> Clip:
    """Return two bodies that move exactly as the keypoints say, without physics."""
    reference = make_reference(motion, rate=motion.fps, smoothing=0.0, ground=False, repair=False)
    scene = build_scene(reference.bodies)
    return Clip(
        _dressed(scene.xml),
        scene.qpos(reference.root, reference.rotations),
        motion.fps,
        motion.text,
    )


def clip_of_rollout(rollout: Rollout) -> Clip:
    """Return what the physics did."""
    scene = rollout.scene()  # refuses MJCF that this project would not have made
    text = str(rollout.metadata.get("text", ""))
    return Clip(_dressed(scene.xml), rollout.qpos, rollout.rate, text)


def clip_of_puppets(
    a: JointTrajectory, b: JointTrajectory, robots: tuple[str, str] | None = None
) -> Clip:
    """Return two robots on their stage, at the speed of the people they follow.

    Args:
        a: Of person a.
        b: Of person b.
        robots: Names or folders, if the robots are not built in.

    Raises:
        MotionFileError: The trajectories do not say where the robots stand.
        SpecError: A robot is not known.
    """
    stage = build_stage(load_robots(*(robots or (a.robot, b.robot))))
    trajectories = (a, b)
    count = min(len(t.times) for t in trajectories)
    qpos = np.tile(stage.model.qpos0, (count, 1))
    model = dress(stage.spec, width=CANVAS, height=CANVAS, floor_tile=0.1).compile()
    for actor, trajectory in zip(stage.actors, trajectories, strict=True):
        if trajectory.base is None:
            raise MotionFileError(f"the trajectory of {actor.person} does not say where it stands")
        qpos[:, actor.qpos] = trajectory.position[:count]
        if actor.free:
            qpos[:, actor.base_qpos : actor.base_qpos + 7] = trajectory.base[:count]
        else:
            model.body_pos[actor.root] = trajectory.base[0, :3]
            model.body_quat[actor.root] = trajectory.base[0, 3:]
    slowed_by = float(a.metadata.get("slowed_by", 1.0))
    fps = (count - 1) / float(a.times[count - 1]) * slowed_by
    return Clip(model, qpos, fps, str(a.metadata.get("text", "")))


def _dressed(xml: str) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(xml)
    return colour_people(dress(spec, width=CANVAS, height=CANVAS)).compile()


def clips_of(
    paths: Sequence[Path], request: MotionRequest, robots: tuple[str, str] | None = None
) -> list[Clip]:
    """Return the clips of files: each motion or rollout is one, two trajectories together are one.

    Args:
        paths: The files.
        request: What motion files leave unsaid.
        robots: Names or folders of the trajectories' robots, if they are not built in.

    Raises:
        MotionFileError: A file cannot be read, or a trajectory stands alone.
    """
    clips: list[Clip] = []
    waiting: JointTrajectory | None = None
    for path in paths:
        schema = schema_of(path)
        if schema == ROLLOUT_SCHEMA:
            clips.append(clip_of_rollout(Rollout.load(path)))
        elif schema == TRAJECTORY_SCHEMA:
            trajectory = JointTrajectory.load(path)
            if waiting is None:
                waiting = trajectory
            else:
                clips.append(clip_of_puppets(waiting, trajectory, robots))
                waiting = None
        else:
            clips.append(clip_of_motion(read(path, request)))
    if waiting is not None:
        raise MotionFileError(
            "one trajectory alone is half a duet", hint="give trajectory-a.npz and trajectory-b.npz"
        )
    return clips
