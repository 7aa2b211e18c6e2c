"""What two robots are about to do: checked as a whole before anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bridge.trajectory import JointTrajectory
from robots.errors import LimitViolation, SpecError, nearest
from robots.skeleton import FloatArray
from robots.spec import RobotSpec

SLACK = 1e-6
"""rad (and share of a speed) that rounding in files may cost."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One robot's part in a performance.

    Raises:
        LimitViolation: The trajectory is for another robot, names other joints, or leaves a
            position or speed limit.
    """

    robot: RobotSpec
    """Who."""
    trajectory: JointTrajectory
    """Positions in the robot's own joint order."""

    @classmethod
    def of(cls, trajectory: JointTrajectory, robot: RobotSpec, *, speed: float = 1.0) -> Part:
        """Match a trajectory to a robot by joint name and check it, played at ``speed``."""
        if trajectory.robot != robot.name:
            raise LimitViolation(
                f"the trajectory is for '{trajectory.robot}'",
                where=robot.name,
                hint=f"retarget the motion to {robot.name}",
            )
        columns = _columns(trajectory, robot)
        ordered = JointTrajectory(
            trajectory.times,
            trajectory.position[:, columns],
            robot.joint_names,
            robot.name,
            trajectory.metadata,
        )
        part = cls(robot, ordered)
        part.require_within(ordered.position, ordered.times)
        _require_speed(part, speed)
        return part

    def only(self, names: Sequence[str]) -> Part:
        """Return the part of these joints alone; the others are left as they are."""
        columns = [i for i, name in enumerate(self.robot.joint_names) if name in names]
        robot = replace(self.robot, joints=tuple(self.robot.joints[i] for i in columns))
        trajectory = JointTrajectory(
            self.trajectory.times,
            self.trajectory.position[:, columns],
            robot.joint_names,
            robot.name,
            self.trajectory.metadata,
        )
        return Part(robot, trajectory)

    def require_within(self, position: FloatArray, times: FloatArray | None = None) -> None:
        """Refuse positions ``[D]`` or ``[N, D]`` rad outside the robot's limits.

        Raises:
            LimitViolation: Naming joint, value, limit and, if ``times`` ``[N]`` s is given, when.
        """
        rows = np.atleast_2d(position)
        lower, upper = self.robot.lower, self.robot.upper
        bad = np.argwhere(~((rows >= lower - SLACK) & (rows <= upper + SLACK)))
        if not len(bad):
            return
        row, column = (int(n) for n in bad[0])
        when = f" at {times[row]:.3f} s" if times is not None else ""
        raise LimitViolation(
            f"{rows[row, column]:.4f} rad{when}",
            where=f"{self.robot.name}: {self.robot.joint_names[column]}",
            allowed=f"{lower[column]:.4f} to {upper[column]:.4f} rad",
            hint="retarget the motion again",
        )


def _columns(trajectory: JointTrajectory, robot: RobotSpec) -> list[int]:
    have, need = trajectory.joint_names, robot.joint_names
    for name in have:
        if name not in need:
            raise LimitViolation(
                f"the trajectory moves '{name}', which {robot.name} does not have",
                where=robot.name,
                hint=nearest(name, need),
            )
    missing = [name for name in need if name not in have]
    if missing:
        raise LimitViolation(
            f"the trajectory says nothing about {', '.join(missing)}", where=robot.name
        )
    return [have.index(name) for name in need]


def _require_speed(part: Part, speed: float) -> None:
    times, position = part.trajectory.times, part.trajectory.position
    velocity = np.abs(np.diff(position, axis=0)) / np.diff(times)[:, None] * speed
    limit = part.robot.max_velocity
    over = velocity / limit
    row, column = (int(n) for n in np.unravel_index(int(over.argmax()), over.shape))
    if over[row, column] > 1 + SLACK:
        raise LimitViolation(
            f"{velocity[row, column]:.2f} rad/s at {times[row]:.3f} s",
            where=f"{part.robot.name}: {part.robot.joint_names[column]}",
            allowed=f"{limit[column]:.2f} rad/s",
            hint="play it slower with speed, or retarget the motion again",
        )


def plan(
    trajectories: Sequence[JointTrajectory], robots: Sequence[RobotSpec], *, speed: float = 1.0
) -> tuple[Part, ...]:
    """Match and check all parts; see :meth:`Part.of`."""
    return tuple(
        Part.of(trajectory, robot, speed=speed)
        for trajectory, robot in zip(trajectories, robots, strict=True)
    )


def select(
    parts: Sequence[Part], *, only: Sequence[str] | None = None, without: Sequence[str] = ()
) -> tuple[Part, ...]:
    """Return the parts of some joints alone: of those in ``only`` (``None``: all) but ``without``.

    Raises:
        SpecError: No robot has such a joint, or one would be left with none.
    """
    known = [name for part in parts for name in part.robot.joint_names]
    for name in (*(only or ()), *without):
        if name not in known:
            raise SpecError(f"no joint '{name}'", hint=nearest(name, known))
    chosen: list[Part] = []
    for part in parts:
        names = [
            name
            for name in part.robot.joint_names
            if (only is None or name in only) and name not in without
        ]
        if not names:
            raise SpecError(
                "no joint is left to play", where=part.robot.name, hint="name one of its joints"
            )
        chosen.append(part if len(names) == len(part.robot.joints) else part.only(names))
    return tuple(chosen)
