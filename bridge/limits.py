"""Last word before a trajectory is written or played: joint limits and speeds, by name and time."""

from __future__ import annotations

import numpy as np

from bridge.trajectory import JointTrajectory
from robots.errors import LimitViolation
from robots.skeleton import FloatArray
from robots.spec import RobotSpec

TOLERANCE = 1e-6
"""rad; rounding is no violation."""


def speeds(times: FloatArray, position: FloatArray) -> FloatArray:
    """Return the joint velocities ``[N-1, D]`` rad/s between samples."""
    return np.diff(position, axis=0) / np.diff(times)[:, None]


def require_within_limits(trajectory: JointTrajectory, robot: RobotSpec) -> None:
    """Do nothing if every joint stays within its range and no-load speed.

    Raises:
        LimitViolation: Names the joint, the time, the value and what is allowed.
    """
    if trajectory.joint_names != robot.joint_names:
        raise LimitViolation(
            f"the trajectory's joints are not those of {robot.name}",
            allowed=", ".join(robot.joint_names),
        )
    over = np.maximum(trajectory.position - robot.upper, robot.lower - trajectory.position)
    row, column = np.unravel_index(np.argmax(over), over.shape)
    joint = robot.joints[column]
    if over[row, column] > TOLERANCE:
        raise LimitViolation(
            f"{trajectory.position[row, column]:.3f} rad at {trajectory.times[row]:.3f} s",
            where=f"{robot.name}.{joint.name}",
            allowed=f"{joint.lower:.3f} to {joint.upper:.3f} rad",
        )
    velocity = np.abs(speeds(trajectory.times, trajectory.position))
    ratio = velocity / robot.max_velocity
    row, column = np.unravel_index(np.argmax(ratio), ratio.shape)
    joint = robot.joints[column]
    if ratio[row, column] > 1 + TOLERANCE:
        raise LimitViolation(
            f"{velocity[row, column]:.2f} rad/s at {trajectory.times[row]:.3f} s",
            where=f"{robot.name}.{joint.name}",
            allowed=f"at most {joint.max_velocity:.2f} rad/s",
        )
