"""Who is on the wire? All bit rates, all ids, and what is wrong with what was found.

**The problem.** A servo hears one bit rate and answers to one id, and neither is known. Asking
every id at every rate takes minutes; one broadcast ping per rate takes a second and finds
everybody, unless two servos share an id. Those answer at the same moment: what arrives is damaged,
or, if both say the same bit by bit, a single clean answer. So

- bytes that form no packet make the scan ask every id at that rate on its own;
- two answers to one ping, or damaged answers to one id, are a clash;
- every servo found is asked a few times for registers in which two servos differ sooner or later
  (position, voltage, time): answers that get damaged then are a clash too.

A servo set to Protocol 1.0 is not found.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from bridge.servo import packets
from bridge.servo.packets import ALERT, BROADCAST, MAX_ID, Packet, instruction
from bridge.servo.registers import (
    BAUD_RATES,
    OPERATING_MODES,
    RETURN_DELAY_UNIT,
    ControlTable,
    control_table,
    hardware_error_names,
    model_name,
    model_names,
)
from bridge.servo.serial_port import SerialPort
from bridge.setup.line import Heard, Line
from robots.spec import RobotSpec

BROADCAST_WAIT = 0.8
"""Silence after which nobody else answers a broadcast ping, s: each id has a slot of 3 ms."""
WAIT = 0.030
"""Silence after which one servo will not answer any more, s, beyond the time on the wire."""
ANSWER_BYTES = 160
"""More than any single answer here is long."""
LOOKS = 3
"""How often a servo is asked to be sure that it is alone."""
LIVELY = ("realtime_tick", "present_position", "present_input_voltage")
"""Registers in which two servos of one id differ."""


@dataclass(frozen=True, slots=True)
class FoundServo:
    """One id that answered."""

    id: int
    baud: int
    """bit/s at which it answered."""
    number: int | None
    """Model number; ``None`` if no answer was intact."""
    firmware: int | None
    clash: bool
    """Whether several servos answer to this id (or its answers get damaged on the way)."""
    notes: tuple[str, ...] = ()
    """What to know before playing."""

    @property
    def model(self) -> str:
        """The maker's name of the model."""
        return "?" if self.number is None else model_name(self.number)


@dataclass(frozen=True, slots=True)
class Scan:
    """What was found on a port."""

    port: str
    bauds: tuple[int, ...]
    """Rates that were tried, bit/s."""
    servos: tuple[FoundServo, ...]
    """By rate and id."""
    noisy: tuple[int, ...]
    """Rates at which damaged bytes came that no single servo explains, bit/s."""
    echo: bool
    """Whether the adapter hears what it sends."""


def scan(
    line: Line,
    bauds: Sequence[int] = BAUD_RATES,
    *,
    progress: Callable[[float], None] = lambda share: None,
) -> Scan:
    """Ask everybody at each bit rate; about a second per rate.

    Nothing is written to any servo.

    Raises:
        PortLost: The port cannot be opened at any of the rates, or went away.
    """
    servos: list[FoundServo] = []
    noisy: list[int] = []
    echo = False
    for count, baud in enumerate(bauds):
        progress(count / len(bauds))
        with line.raw(baud) as device:
            every = line.exchange(device, _ping(BROADCAST), BROADCAST_WAIT)
            echo |= every.echo
            ids = set(_ids(every.answers))
            if every.garbled:
                ids.update(range(MAX_ID + 1))
            found = [_look(line, device, baud, servo_id, every) for servo_id in sorted(ids)]
        known = [servo for servo in found if servo is not None]
        if every.garbled and not any(servo.clash for servo in known):
            noisy.append(baud)
        servos += known
    progress(1.0)
    return Scan(line.port, tuple(bauds), tuple(servos), tuple(noisy), echo)


def _ping(servo_id: int) -> bytes:
    return instruction(servo_id, packets.PING)


def _ids(answers: Iterable[Packet]) -> list[int]:
    return [answer.servo_id for answer in answers if len(answer.params) == 4]


def _look(
    line: Line, device: SerialPort, baud: int, servo_id: int, every: Heard
) -> FoundServo | None:
    """Return the servo (or servos) of an id; ``None`` if nobody answers to it."""
    wait = WAIT + ANSWER_BYTES * 10 / baud
    heard = line.exchange(device, _ping(servo_id), wait)
    if not heard.answers and not heard.garbled and servo_id not in _ids(every.answers):
        return None
    clash = heard.garbled or Counter(_ids(every.answers))[servo_id] > 1
    clash |= len(heard.answers) > 1
    if not heard.answers:
        return FoundServo(servo_id, baud, None, None, clash, ("its answers are damaged",))
    params = heard.answers[0].params
    number, firmware = params[1] | params[2] << 8, params[3]
    notes: list[str] = []
    name = model_name(number)
    if name in model_names():
        table = control_table(name)
        # Twice, with more patience: an answer that comes late looks like one too many.
        clash = clash or not any(
            _is_alone(line, device, servo_id, table, patience) for patience in (wait, 4 * wait)
        )
        if not clash:
            notes = _notes(line, device, servo_id, table, wait)
    else:
        notes.append("no control table for this model")
    if clash:
        notes = ["several servos answer to this id, or the wire damages what it says"]
    return FoundServo(servo_id, baud, number, firmware, clash, tuple(notes))


def _is_alone(
    line: Line, device: SerialPort, servo_id: int, table: ControlTable, wait: float
) -> bool:
    for _ in range(LOOKS):
        for name in LIVELY:
            register = table[name]
            asked = _read(servo_id, register.address, register.length)
            heard = line.exchange(device, asked, wait)
            if heard.garbled or len(heard.answers) > 1:
                return False
    return True


def _read(servo_id: int, address: int, length: int) -> bytes:
    params = address.to_bytes(2, "little") + length.to_bytes(2, "little")
    return instruction(servo_id, packets.READ, params)


def _notes(
    line: Line, device: SerialPort, servo_id: int, table: ControlTable, wait: float
) -> list[str]:
    """Return what stands in the way of playing, or is slower than it need be."""
    value: dict[str, int] = {}
    for name in (
        *("return_delay_time", "drive_mode", "homing_offset", "operating_mode"),
        *("status_return_level", "torque_enable", "hardware_error_status"),
    ):
        register = table[name]
        heard = line.exchange(device, _read(servo_id, register.address, register.length), wait)
        for answer in heard.answers:
            if not answer.params[0] & ~ALERT and len(answer.params) == register.length + 1:
                value[name] = register.decode(answer.params[1:])
    notes: list[str] = []
    if value.get("hardware_error_status"):
        errors = ", ".join(hardware_error_names(value["hardware_error_status"]))
        notes.append(f"hardware error: {errors}")
    if value.get("torque_enable"):
        notes.append("torque is on")
    for name in ("homing_offset", "drive_mode"):
        if value.get(name):
            notes.append(f"{name} {value[name]}: play refuses it, calibrate clears it")
    if value.get("operating_mode", 3) not in OPERATING_MODES.values():
        notes.append(f"operating mode {value['operating_mode']}")
    if value.get("return_delay_time"):
        delay = value["return_delay_time"] * RETURN_DELAY_UNIT * 1e6
        notes.append(f"return delay {delay:.0f} us: play sets 0")
    return notes


def mismatches(found: Scan, robot: RobotSpec, bus: str) -> list[str]:
    """Return how what was found differs from what a robot's file says, one line each."""
    lines: list[str] = []
    baud = robot.buses[bus].baud
    expected = {joint.servo.id: joint for joint in robot.joints if joint.servo.bus == bus}
    for servo_id, joint in expected.items():
        who = f"{joint.name} (id {servo_id})"
        here = [servo for servo in found.servos if servo.id == servo_id]
        if not here:
            lines.append(f"{who}: missing")
        for servo in here:
            if servo.baud != baud:
                lines.append(f"{who}: set to {servo.baud} bit/s, not {baud}")
            if servo.number is not None and servo.model != joint.servo.model:
                lines.append(f"{who}: is {servo.model}, not {joint.servo.model}")
    lines += [
        f"id {servo.id} ({servo.model}, {servo.baud} bit/s): not in the robot's file"
        for servo in found.servos
        if servo.id not in expected
    ]
    return lines
