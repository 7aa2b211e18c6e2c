"""From two people to two robots: :class:`DuetMotion` in, two :class:`JointTrajectory` out.

In order: what each person does in directions (:mod:`.human`), limb-normalised targets
(:mod:`.targets`), where the robots stand (:mod:`.placement`), inverse kinematics of both in one
model (:mod:`.ik`), refinement over time (:mod:`.polish`), and one common slowing-down so that no
servo is asked for more speed than it has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bridge.plan import Part
from bridge.retarget.build import Build, measure
from bridge.retarget.human import Person, observe
from bridge.retarget.ik import Costs, solve
from bridge.retarget.placement import place
from bridge.retarget.polish import polish
from bridge.retarget.report import (
    RetargetReport,
    collision_figures,
    contact_figures,
    hand_error,
)
from bridge.retarget.stage import PEOPLE, Stage, build_stage
from bridge.retarget.touch import Touch, touches
from bridge.trajectory import JointTrajectory
from generator.motion import DuetMotion
from robots.errors import SpecError
from robots.skeleton import FloatArray
from robots.spec import RobotSpec
from sim.rollout import motion_sha256


@dataclass(frozen=True, slots=True, kw_only=True)
class RetargetSettings:
    """How to retarget.

    Raises:
        SpecError: A value is out of range.
    """

    speed_share: float = 0.65
    """Share of a servo's no-load speed that it may be asked for; the rest is for its load."""
    iterations: int = 1
    """Solves per moment."""
    polish: int = 8
    """Steps of the refinement over the whole motion; 0 leaves it out."""
    costs: Costs = Costs()  # noqa: RUF009 - frozen
    """Weights of the tasks."""

    def __post_init__(self) -> None:
        """Validate."""
        if not 0.05 <= self.speed_share <= 1:
            raise SpecError(f"speed_share {self.speed_share}", allowed="0.05 to 1")
        if not 0 <= self.polish <= 100:
            raise SpecError(f"{self.polish} steps of polish", allowed="0 to 100")
        if not 1 <= self.iterations <= 100:
            raise SpecError(f"{self.iterations} iterations", allowed="1 to 100")


@dataclass(frozen=True, slots=True, eq=False)
class Retargeted:
    """Two robots doing what two people did."""

    trajectories: tuple[JointTrajectory, JointTrajectory]
    """Of a and b, on one clock."""
    report: RetargetReport
    """How well it went."""
    stage: Stage
    """The two robots."""
    qpos: FloatArray
    """``[N, nq]``, poses on the stage at the trajectories' times."""


def retarget(
    motion: DuetMotion,
    robots: tuple[RobotSpec, RobotSpec],
    *,
    settings: RetargetSettings | None = None,
    source_sha256: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> Retargeted:
    """Return joint trajectories that let two robots do a duet.

    Args:
        motion: What the people do.
        robots: Who plays a and b.
        settings: How.
        source_sha256: Hash of the motion that a report will judge, if not this one (a rollout's).
        progress: Told the share done.

    Raises:
        SpecError: A robot lacks a landmark.
        LimitViolation: No posture within the limits was found.
    """
    settings = settings or RetargetSettings()
    stage = build_stage(robots)
    builds = (measure(stage, stage.actors[0]), measure(stage, stage.actors[1]))
    people = (observe(motion.a), observe(motion.b))
    scales = [b.arm_length / p.arm_length for b, p in zip(builds, people, strict=True)]
    touching = touches(motion, robots, float(np.mean(scales)))
    free = (stage.actors[0].free, stage.actors[1].free)
    targets, yaw = place(people, builds, free, touching)
    for index, (on_legs, target) in enumerate(zip(free, targets, strict=True)):
        if not on_legs:
            stage.place(index, target.base[0], yaw if index else 0.0)
    qpos = solve(
        stage,
        builds,
        targets,
        touching,
        fps=motion.fps,
        costs=settings.costs,
        iterations=settings.iterations,
        progress=None if progress is None else lambda share: progress(0.4 * share),
    )
    if settings.polish:
        qpos = polish(
            stage,
            builds,
            targets,
            touching,
            qpos,
            fps=motion.fps,
            iterations=settings.polish,
            progress=None if progress is None else lambda share: progress(0.4 + 0.6 * share),
        )
    slowed_by = _slowing(stage, qpos, motion.fps, settings.speed_share)
    times = np.arange(len(qpos)) / motion.fps * slowed_by
    trajectories = [
        _trajectory(stage, index, times, qpos, motion, slowed_by, source_sha256)
        for index in range(2)
    ]
    report = _report(stage, builds, people, touching, qpos, motion.fps, slowed_by, yaw)
    return Retargeted((trajectories[0], trajectories[1]), report, stage, qpos)


def _slowing(stage: Stage, qpos: NDArray, fps: float, share: float) -> float:
    """Return the factor on time that brings every servo under its share of no-load speed."""
    ratios = [
        (np.abs(np.diff(qpos[:, a.qpos], axis=0)) * fps / a.robot.max_velocity).max()
        for a in stage.actors
    ]
    return max(1.0, float(max(ratios)) / share)


def _trajectory(
    stage: Stage,
    index: int,
    times: FloatArray,
    qpos: FloatArray,
    motion: DuetMotion,
    slowed_by: float,
    source_sha256: str | None,
) -> JointTrajectory:
    actor = stage.actors[index]
    trajectory = JointTrajectory(
        times,
        qpos[:, actor.qpos],
        actor.robot.joint_names,
        actor.robot.name,
        {
            "person": PEOPLE[index],
            "text": motion.text,
            "licence": motion.licence,
            "slowed_by": slowed_by,
            "motion_sha256": source_sha256 or motion_sha256(motion),
        },
        stage.base(index, qpos),
    )
    Part.of(trajectory, actor.robot)  # raises if a limit is broken
    return trajectory


def _report(
    stage: Stage,
    builds: tuple[Build, Build],
    people: tuple[Person, Person],
    touching: list[Touch],
    qpos: FloatArray,
    fps: float,
    slowed_by: float,
    yaw: float,
) -> RetargetReport:
    landmarks = stage.landmarks(qpos)
    scale = float(
        np.mean([b.arm_length / p.arm_length for b, p in zip(builds, people, strict=True)])
    )
    joints = np.concatenate([qpos[:, actor.qpos] for actor in stage.actors], axis=1)
    jerk = np.diff(joints, n=3, axis=0) * fps**3
    outside = [
        (qpos[:, a.qpos] > a.robot.upper + 1e-6) | (qpos[:, a.qpos] < a.robot.lower - 1e-6)
        for a in stage.actors
    ]
    return RetargetReport(
        hand_error_percent=hand_error(
            people, builds, landmarks, _turns(stage, people, yaw), touching
        ),
        **contact_figures(touching, landmarks, scale),
        **collision_figures(stage, qpos),
        peak_velocity_rad_s=float(np.abs(np.diff(joints, axis=0)).max() * fps),
        jerk_rms_rad_s3=float(np.sqrt((jerk**2).mean())) if len(jerk) else 0.0,
        slowed_by=slowed_by,
        limit_violations=int(sum(o.sum() for o in outside)),
    )


def _turns(
    stage: Stage, people: tuple[Person, Person], yaw: float
) -> tuple[FloatArray, FloatArray]:
    """Return by how much each person is turned from the world to the stage, ``[T]`` rad."""
    free = [actor.free for actor in stage.actors]
    still = np.zeros_like(people[0].heading)
    if all(free):
        return still, still
    if not any(free):
        return -people[0].heading, yaw - people[1].heading
    turn = -people[free.index(False)].heading
    return turn, turn
