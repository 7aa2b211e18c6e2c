"""From any file of this project to clips that can be drawn."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from bridge.player.recording import Recording
from bridge.retarget.stage import PEOPLE, build_stage
from bridge.sources import ROLLOUT_SCHEMA, MotionRequest, load_robots, read, schema_of
from bridge.stages import TELEMETRY, TRAJECTORIES
from bridge.trajectory import SCHEMA as TRAJECTORY_SCHEMA
from bridge.trajectory import JointTrajectory
from generator.motion import DuetMotion
from robots.errors import MotionFileError
from robots.skeleton import FloatArray
from robots.spec import RobotSpec
from sim.clip import Clip
from sim.reference import make_reference
from sim.render import colour_people, dress
from sim.rollout import Rollout
from sim.scene import build_scene

CANVAS = 1024
"""Largest edge of a picture, pixels."""
TELEMETRY_SUFFIX = Path(TELEMETRY).suffix
"""What telemetry files end with."""
TELEMETRY_FPS = 60.0
"""Frames per second of what is shown of telemetry: no less than a player's usual rate."""
FACING = ((-0.25, 0.0, 1.0, 0.0, 0.0, 0.0), (0.25, 0.0, 0.0, 0.0, 0.0, 1.0))
"""x, y in m and attitude wxyz of a and b where nothing says where they stand."""

_Part = tuple[FloatArray, FloatArray | None]
"""Joint angles ``[N, D]`` rad and base poses ``[N, 7]`` of one robot."""


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
    count = min(len(a.times), len(b.times))
    parts: list[_Part] = []
    for person, trajectory in zip(PEOPLE, (a, b), strict=True):
        if trajectory.base is None:
            raise MotionFileError(f"the trajectory of {person} does not say where it stands")
        parts.append((trajectory.position[:count], trajectory.base[:count]))
    slowed_by = float(a.metadata.get("slowed_by", 1.0))
    fps = (count - 1) / float(a.times[count - 1]) * slowed_by
    pair = load_robots(*(robots or (a.robot, b.robot)))
    return _on_stage(pair, parts, fps, str(a.metadata.get("text", "")))


def clip_of_telemetry(
    path: Path,
    trajectories: Sequence[JointTrajectory] = (),
    robots: tuple[str, str] | None = None,
) -> Clip:
    """Return two robots as their servos moved, in the time that it took them.

    Servos know nothing of the stage: where the robots stand is taken from the trajectories that
    were played; without them the robots stand still and face each other.

    Args:
        path: A telemetry file.
        trajectories: Of a and b; if not given, those that lie beside the telemetry, if any.
        robots: Names or folders of the robots, if they are not built in.

    Raises:
        MotionFileError: A file cannot be read, or it tells of other joints.
        SpecError: A robot is not known.
    """
    recording = Recording.load(path)
    pair = load_robots(*(robots or (recording.people[0].robot, recording.people[1].robot)))
    beside = [path.parent / name for name in TRAJECTORIES]
    if not trajectories and all(file.exists() for file in beside):
        trajectories = [JointTrajectory.load(file) for file in beside]
    # Ticks may be missing; pictures need even time.
    times = np.arange(0.0, recording.times[-1] + 1e-9, 1 / TELEMETRY_FPS)
    phase = np.interp(times, recording.times, recording.phase)
    parts: list[_Part] = []
    for index, (robot, person) in enumerate(zip(pair, recording.people, strict=True)):
        if set(person.joint_names) != set(robot.joint_names):
            raise MotionFileError(f"tells of other joints than {robot.name} has", where=str(path))
        columns = [person.joint_names.index(name) for name in robot.joint_names]
        position = _sampled(times, recording.times, person.filled[:, columns])
        base = None
        if trajectories and trajectories[index].robot == robot.name:
            base = _base(trajectories[index], phase)
        parts.append((position, base))
    text = str(trajectories[0].metadata.get("text", "")) if trajectories else ""
    return _on_stage(pair, parts, TELEMETRY_FPS, text)


def _base(trajectory: JointTrajectory, phase: FloatArray) -> FloatArray | None:
    """Return base poses ``[N, 7]`` at some phases s; ``None`` if the trajectory has none."""
    if trajectory.base is None:
        return None
    base = np.array(trajectory.base)
    turns = np.where((base[1:, 3:] * base[:-1, 3:]).sum(axis=1) < 0, -1.0, 1.0)
    base[1:, 3:] *= np.cumprod(turns)[:, None]  # q and -q are one attitude: take the near one
    base = _sampled(phase, trajectory.times, base)
    base[:, 3:] /= np.linalg.norm(base[:, 3:], axis=1, keepdims=True)
    return base


def _sampled(at: FloatArray, times: FloatArray, values: FloatArray) -> FloatArray:
    """Return the columns of ``values`` at other times, straight between samples."""
    return np.column_stack([np.interp(at, times, column) for column in values.T])


def _on_stage(
    robots: tuple[RobotSpec, RobotSpec], parts: Sequence[_Part], fps: float, title: str
) -> Clip:
    """Return the clip of two robots on their stage."""
    stage = build_stage(robots)
    qpos = np.tile(stage.model.qpos0, (len(parts[0][0]), 1))
    model = dress(stage.spec, width=CANVAS, height=CANVAS, floor_tile=0.1).compile()
    for index, (actor, (position, base)) in enumerate(zip(stage.actors, parts, strict=True)):
        qpos[:, actor.qpos] = position
        if base is None:
            pose = stage.base(index, qpos[:1])[0]
            base = np.tile([*FACING[index][:2], *pose[2:3], *FACING[index][2:]], (len(qpos), 1))
        if actor.free:
            qpos[:, actor.base_qpos : actor.base_qpos + 7] = base
        else:
            model.body_pos[actor.root] = base[0, :3]
            model.body_quat[actor.root] = base[0, 3:]
    return Clip(model, qpos, fps, title)


def _dressed(xml: str) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(xml)
    return colour_people(dress(spec, width=CANVAS, height=CANVAS)).compile()


def clips_of(
    paths: Sequence[Path], request: MotionRequest, robots: tuple[str, str] | None = None
) -> list[Clip]:
    """Return the clips of files, in their order.

    Each motion, rollout and telemetry file is a clip, two trajectories together are one. Telemetry
    beside trajectories is shown where these stand: the plan next to the deed.

    Args:
        paths: The files.
        request: What motion files leave unsaid.
        robots: Names or folders of the trajectories' robots, if they are not built in.

    Raises:
        MotionFileError: A file cannot be read, or a trajectory stands alone.
    """
    clips: list[Clip] = []
    waiting: JointTrajectory | None = None
    schemas = [schema_of(path) for path in paths]
    played = [
        JointTrajectory.load(path)
        for path, schema in zip(paths, schemas, strict=True)
        if schema == TRAJECTORY_SCHEMA
    ]
    for path, schema in zip(paths, schemas, strict=True):
        if path.suffix == TELEMETRY_SUFFIX:
            clips.append(clip_of_telemetry(path, played if len(played) == 2 else (), robots))
        elif schema == ROLLOUT_SCHEMA:
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
