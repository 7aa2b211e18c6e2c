"""Virtual servos on a line in virtual time."""

from __future__ import annotations

from collections.abc import Sequence

from bridge.servo.clock import VirtualClock
from bridge.servo.registers import BAUD_RATES, control_table
from bridge.setup.line import Line
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualSerial, VirtualServo

XM430 = control_table("XM430-W350")
XL330 = control_table("XL330-M288")


def servo(servo_id: int, baud: int = 57600, table=XM430, angle: float = 0.0) -> VirtualServo:
    return VirtualServo(table, servo_id, baud_index=BAUD_RATES.index(baud), angle=angle)


class Merging(VirtualSerial):
    """A line on which servos that answer to one id at the same time pull at the same wire."""

    def write(self, data: bytes | bytearray | list[int]) -> int:
        due = self.bus.feed(self.clock.now(), bytes(data), baud=self.baudrate)
        together: dict[int, list[tuple[float, bytes]]] = {}
        for when, answer in due:
            together.setdefault(answer[4], []).append((when, answer))
        for answers in together.values():
            merged = bytearray(answers[0][1])
            for _, other in answers[1:]:
                merged = bytearray(a & b for a, b in zip(merged, other, strict=False))
            self._due.append((answers[0][0], bytes(merged)))
        return len(data)


class Rig:
    """A line and the servos on it."""

    def __init__(self, servos: Sequence[VirtualServo], *faults: Fault, serial=VirtualSerial):
        self.clock = VirtualClock(1.0)
        self.wire = VirtualBus(servos, faults=FaultPlan(faults))

        def opener(port: str, baud: int):
            self.wire.baud = baud
            return serial(self.wire, self.clock, baudrate=baud, timeout=0.005)

        self.line = Line("test", opener, self.clock)


def never(text: str) -> bool:
    raise AssertionError(f"asked: {text}")


def yes(text: str) -> bool:
    return True


def no(text: str) -> bool:
    return False
