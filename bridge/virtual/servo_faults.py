"""What happens to the servos of a bus themselves.

**The problem.** Heat, load and a weak supply are not bits that somebody sets: they act on the
motor, and the servo notices. So these faults change what surrounds a servo (air, load, supply,
grip, bit rate, a twin) at the moment they begin, and change it back when they end; what follows
from it, the registers show. Faults overlap: two loads add up, and when one of them ends the other
stays. So what a servo was like before is kept once, and every beginning and end works out anew what
holds now.

A servo without power forgets its RAM and comes back limp, as on metal.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

from bridge.virtual.faults import Fault, FaultPlan
from bridge.virtual.servo import VirtualServo

RESET_SHARE = 1 / 3
"""Share of its nominal voltage below which a servo's processor stops: about what the 3.3 V
regulator of a 12 V servo needs."""


@dataclasses.dataclass(slots=True)
class _Held:
    """Something about a servo that faults have changed."""

    before: Any
    """What it was."""
    values: dict[int, float]
    """What each fault that holds now wants, by its number, in the order in which they began."""


class ServoFaults:
    """Begins and ends the faults of a plan that concern servos."""

    def __init__(self, plan: FaultPlan, servos: Sequence[VirtualServo]) -> None:
        """Do to these servos what the plan says."""
        self.plan = plan
        self._servos = servos
        self._meant: dict[int, list[VirtualServo]] = {}
        self._over: set[int] = set()
        self._held: dict[tuple[VirtualServo, str], _Held] = {}
        self._twins: dict[int, list[VirtualServo]] = {}

    @property
    def twins(self) -> list[VirtualServo]:
        """Servos that came onto the bus with an id that was taken."""
        return [twin for twins in self._twins.values() for twin in twins]

    def changes(self, now: float) -> list[tuple[float, int, bool]]:
        """Return what has come due: when (s), which fault, and whether it begins; in order."""
        origin = self.plan.origin
        due: list[tuple[float, int, bool]] = []
        for index, fault in enumerate(self.plan.faults):
            if index in self._over or fault.kind not in _CONCERNED:
                continue
            if index not in self._meant and origin + fault.start <= now:
                due.append((origin + fault.start, index, True))
            if origin + fault.end <= now:
                due.append((origin + fault.end, index, False))
        return sorted(due, key=lambda change: change[0])

    def change(self, when: float, index: int, begins: bool) -> None:
        """Let a fault begin or end at a time, s."""
        fault = self.plan.faults[index]
        if begins:
            self._meant[index] = [s for s in self._servos if fault.servo_id in (None, s.id)]
        else:
            self._over.add(index)
        for servo in self._meant[index]:
            self._change(servo, fault, index, when, begins)

    def _change(
        self, servo: VirtualServo, fault: Fault, index: int, when: float, begins: bool
    ) -> None:
        if fault.kind == "unplug" and fault.servo_id is None:
            return  # it is the adapter that goes away, which its front end sees to
        if fault.kind == "hardware":
            if begins:
                servo.trip(int(fault.value))
        elif fault.kind == "clash":
            twins = self._twins.setdefault(index, [])
            if begins:
                twins.append(_twin(servo, fault.value, when))
            else:
                twins.clear()
        else:
            subject, get, take = _CHANGED[fault.kind]
            held = self._held.get((servo, subject))
            if held is None:
                held = self._held[servo, subject] = _Held(get(servo), {})
            if begins:
                held.values[index] = 0.0 if fault.kind == "unplug" else fault.value
            else:
                del held.values[index]
            take(servo, held.before, list(held.values.values()), when)


def _twin(servo: VirtualServo, away: float, when: float) -> VirtualServo:
    """Return a limp servo with the same EEPROM that stands so far away, rad."""
    twin = VirtualServo(servo.table, servo.id, angle=servo.angle + away)
    for name, register in servo.table.registers.items():
        if register.area == "eeprom":
            twin.memory.set(name, servo.memory.get(name))
    twin.reboot(when)
    twin.advance(when)
    return twin


def _supply(servo: VirtualServo, before: float, values: list[float], when: float) -> None:
    least = RESET_SHARE * servo.table.voltage
    was_on = servo.supply >= least
    servo.supply = min([before, *values])
    is_on = servo.supply >= least
    if is_on and not was_on:
        servo.reboot(when)
    elif was_on and not is_on:
        servo.reboot(math.inf)


def _baud(servo: VirtualServo, before: int, values: list[float], when: float) -> None:
    rates = servo.table.bauds.items()
    index = before
    if values:  # a servo that does not know the rate keeps its own
        index = next((count for count, rate in rates if rate == values[-1]), before)
    if index != servo.baud_index:
        servo.memory.set("baud_rate", index)
        servo.reboot(when if math.isfinite(servo.boots_at) else math.inf)


def _firmware(servo: VirtualServo, before: int, values: list[float], when: float) -> None:
    version = int(values[-1]) if values else before
    servo.table = dataclasses.replace(servo.table, firmware=version)
    servo.memory.set("firmware_version", version)


def _heat(servo: VirtualServo, before: float, values: list[float], when: float) -> None:
    servo.motor.ambient = max(values, default=before)


def _load(
    servo: VirtualServo,
    before: Callable[[float], float] | None,
    values: list[float],
    when: float,
) -> None:
    more = sum(values)
    servo.load = (lambda angle: (before(angle) if before else 0.0) + more) if values else before
    servo.drive.wake()


def _stuck(servo: VirtualServo, before: bool, values: list[float], when: float) -> None:
    servo.motor.stuck = before or bool(values)
    servo.drive.wake()


_Get = Callable[[VirtualServo], Any]
_Take = Callable[[VirtualServo, Any, list[float], float], None]
_SUPPLY: tuple[str, _Get, _Take] = ("supply", lambda servo: servo.supply, _supply)
_CHANGED: dict[str, tuple[str, _Get, _Take]] = {
    "unplug": _SUPPLY,
    "brownout": _SUPPLY,
    "baud": ("baud", lambda servo: servo.baud_index, _baud),
    "firmware": ("firmware", lambda servo: servo.table.firmware, _firmware),
    "heat": ("heat", lambda servo: servo.motor.ambient, _heat),
    "load": ("load", lambda servo: servo.load, _load),
    "stuck": ("stuck", lambda servo: servo.motor.stuck, _stuck),
}
"""By kind: what it changes, how that is looked up, and how it is worked out anew."""
_CONCERNED = {*_CHANGED, "hardware", "clash"}
