"""How often a second a bus can be written and read: arithmetic, before anything is plugged in.

Source: ROBOTIS e-manual, "Protocol 2.0"; a byte is ten bits on the wire. Bytes of one cycle for N
servos, goals of 4 bytes and states of 10::

    sync write           14 + 5 N
    sync read            14 + N  asked,  21 N  answered      + Return Delay Time for each servo
    fast sync read       14 + N  asked,  8 + 14 N  answered  + Return Delay Time once

Worked example, 20 servos at 1 Mbit/s: 568 bytes, 176 cycles a second; fast 436 bytes, 229; with the
factory's Return Delay Time of 500 us it is 64 and 206.
"""

from __future__ import annotations

from dataclasses import dataclass

from bridge.servo.registers import control_table
from robots.spec import RobotSpec

FACTORY_DELAY = 500e-6
"""Return Delay Time of a servo out of the box, s."""


@dataclass(frozen=True, slots=True)
class Budget:
    """What the wire of one bus allows."""

    bus: str
    servos: int
    baud: int
    """bit/s."""
    plain: float
    """Cycles a second with Sync Read."""
    fast: float | None
    """Cycles a second with Fast Sync Read; ``None`` if a model on the bus does not know it."""
    factory: float
    """:attr:`plain` with the factory's Return Delay Time."""

    @property
    def best(self) -> float:
        """Cycles a second at most."""
        return self.plain if self.fast is None else self.fast


def cycles(servos: int, baud: int, *, delay: float = 0.0, fast: bool = False) -> float:
    """Return how often a second goals can be written and states read.

    Args:
        servos: On one bus.
        baud: bit/s.
        delay: Return Delay Time, s.
        fast: With Fast Sync Read.
    """
    asked = (14 + 5 * servos) + (14 + servos)
    answered = 8 + 14 * servos if fast else 21 * servos
    return 1 / ((asked + answered) * 10 / baud + delay * (1 if fast else servos))


def budgets(robot: RobotSpec) -> list[Budget]:
    """Return the budget of each of a robot's buses that has servos.

    Raises:
        SpecError: There is no control table for a servo's model.
    """
    found: list[Budget] = []
    for bus in robot.buses.values():
        joints = [joint for joint in robot.joints if joint.servo.bus == bus.name]
        if not joints:
            continue
        able = all(control_table(joint.servo.model).fast_read_firmware for joint in joints)
        count = len(joints)
        found.append(
            Budget(
                bus=bus.name,
                servos=count,
                baud=bus.baud,
                plain=cycles(count, bus.baud),
                fast=cycles(count, bus.baud, fast=True) if able else None,
                factory=cycles(count, bus.baud, delay=FACTORY_DELAY),
            )
        )
    return found
