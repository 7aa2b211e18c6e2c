"""What moves when the servos of a bus turn: nothing but themselves, or a body they share.

Three kinds of motion hang behind the same registers:

======== ======================================================================================
instant  horns are where they are told to be (:mod:`bridge.virtual.instant`): for tests of programs
servo    each horn has a motor of its own that lags, saturates and warms up (:mod:`~.motor`)
mujoco   the servos' torques move the robot's own model (:mod:`bridge.virtual.mujoco_plant`)
======== ======================================================================================

The first two are a matter of each servo's :class:`~bridge.virtual.drive.Drive`. The third couples
the servos, an arm's weight pulls at the waist, so that they must be stepped together: the bus then
leaves the time to a :class:`Plant`.
"""

from __future__ import annotations

from typing import Protocol

from robots.errors import SpecError, nearest
from robots.spec import RobotSpec

INSTANT, SERVO, MUJOCO = PLANTS = ("instant", "servo", "mujoco")
"""Kinds of motion, as named on the command line."""


def require_plant(name: str, robot: RobotSpec) -> None:
    """Refuse what is not one of :data:`PLANTS`, or is none for this robot.

    Raises:
        SpecError: There is no such kind of motion, or the robot's body hangs on several buses.
    """
    if name not in PLANTS:
        raise SpecError(f"no plant '{name}'", allowed=", ".join(PLANTS), hint=nearest(name, PLANTS))
    if name == MUJOCO and len(robot.buses) > 1:
        raise SpecError(
            f"{robot.name} has {len(robot.buses)} buses, and its body hangs on all of them",
            where=f"plant {MUJOCO}",
            allowed=f"{INSTANT} or {SERVO} for robots with several buses",
        )


class Plant(Protocol):
    """The servos of a bus and the body that they move together."""

    def advance(self, now: float) -> None:
        """Let time pass until ``now`` s for the servos and the body."""
        ...
