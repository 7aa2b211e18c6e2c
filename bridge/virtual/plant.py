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

INSTANT, SERVO, MUJOCO = PLANTS = ("instant", "servo", "mujoco")
"""Kinds of motion, as named on the command line."""


def require_plant(name: str) -> None:
    """Refuse what is not one of :data:`PLANTS`.

    Raises:
        SpecError: There is no such kind of motion.
    """
    if name not in PLANTS:
        raise SpecError(f"no plant '{name}'", allowed=", ".join(PLANTS), hint=nearest(name, PLANTS))


class Plant(Protocol):
    """The servos of a bus and the body that they move together."""

    def advance(self, now: float) -> None:
        """Let time pass until ``now`` s for the servos and the body."""
        ...
