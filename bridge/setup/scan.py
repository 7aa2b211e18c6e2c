"""Who is on the wire? All bit rates, all ids, and what is wrong with what was found.

**The problem.** A servo hears one bit rate and answers to one id, and neither is known. Asking
every id at every rate takes minutes; one broadcast ping per rate takes a second and finds
everybody, unless two servos share an id. Those answer at the same moment: what arrives is damaged,
or, if both say the same bit by bit, a single clean answer. So

- bytes that form no packet make the scan ask every id at that rate on its own;
- two answers to one ping, or damaged answers to one id, are a clash;
- every servo found is asked a few times for registers in which two servos differ sooner or later
  (position, voltage, time): answers that get damaged then are a clash too.

Servos that speak Protocol 1.0 hear none of this, and no broadcast makes them answer. They are asked
one id after the other, by reading: the answer to a ping can be the very bytes of the ping, so that
an adapter's echo would look like a servo. That takes five seconds and more at each bit rate, and
servos with a Status Return Level of 0 stay hidden.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from bridge.servo import packets, protocol1
from bridge.servo.packets import ALERT, BROADCAST, MAX_ID, Packet, instruction
from bridge.servo.registers import (
    BAUD_RATES,
    OPERATING_MODES,
    RETURN_DELAY_UNIT,
    ControlTable,
    Register,
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
OLD_WAIT = 0.020
"""The same for each id of Protocol 1.0: a USB adapter's 16 ms and some."""
OLD_BAUDS = (57600, 1_000_000)
"""bit/s at which the Protocol 1.0 servos leave the factory: the MX, and the AX."""
ANSWER_BYTES, OLD_ANSWER_BYTES = 160, 24
"""More than question and answer here are long, in the two protocols."""
OLD_HEAD = 3
"""Bytes that a Protocol 1.0 servo is asked for first: model number and one more, so that the answer
has another length than the question."""
LOOKS = 3
"""How often a servo is asked to be sure that it is alone."""
LIVELY = (
    *("realtime_tick", "present_position", "present_input_voltage"),
    *("present_voltage", "present_load"),
)
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
    protocol: int = 2
    """Protocol that it speaks: 1 or 2."""

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


@dataclass(frozen=True, slots=True)
class _Call:
    """A line at one bit rate, in one protocol."""

    line: Line
    device: SerialPort
    baud: int
    protocol: int

    @property
    def wait(self) -> float:
        """Silence after which one servo will not answer any more, s."""
        if self.protocol == 1:
            return OLD_WAIT + OLD_ANSWER_BYTES * 10 / self.baud
        return WAIT + ANSWER_BYTES * 10 / self.baud

    def read(self, servo_id: int, address: int, length: int, patience: float = 1.0) -> Heard:
        """Ask a servo for bytes."""
        if self.protocol == 1:
            asked = protocol1.packet(servo_id, protocol1.READ, bytes((address, length)))
        else:
            params = address.to_bytes(2, "little") + length.to_bytes(2, "little")
            asked = instruction(servo_id, packets.READ, params)
        return self.line.exchange(self.device, asked, patience * self.wait, protocol=self.protocol)

    def ping(self, servo_id: int, wait: float) -> Heard:
        """Ask a servo, or all, to answer."""
        return self.line.exchange(self.device, instruction(servo_id, packets.PING), wait)

    def value(self, servo_id: int, register: Register) -> int | None:
        """Return a register's value; ``None`` without an intact answer."""
        for answer in self.read(servo_id, register.address, register.length).answers:
            refused = self.protocol == 2 and answer.params[0] & ~ALERT
            if not refused and len(answer.params) == register.length + 1:
                return register.decode(answer.params[1:])
        return None


def old_rates() -> tuple[int, ...]:
    """Return all bit/s that Protocol 1.0 servos can be set to."""
    tables = [control_table(name) for name in model_names()]
    rates = {rate for table in tables if table.protocol == 1 for rate in table.bauds.values()}
    return tuple(sorted(rates))


def scan(
    line: Line,
    bauds: Sequence[int] = BAUD_RATES,
    *,
    old_bauds: Sequence[int] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> Scan:
    """Ask everybody at each bit rate; about a second per rate.

    Nothing is written to any servo.

    Args:
        line: Where.
        bauds: Rates at which Protocol 2.0 is tried, bit/s.
        old_bauds: Rates at which Protocol 1.0 is tried, bit/s.
        progress: Told how much is done.

    Raises:
        PortLost: The port cannot be opened at any of the rates, or went away.
    """
    servos: list[FoundServo] = []
    noisy: list[int] = []
    echo = False
    rounds = [(baud, 2) for baud in bauds] + [(baud, 1) for baud in old_bauds]
    for count, (baud, protocol) in enumerate(rounds):
        progress(count / len(rounds))
        with line.raw(baud) as device:
            call = _Call(line, device, baud, protocol)
            found, heard = _everybody(call) if protocol == 2 else _one_by_one(call)
        echo |= heard.echo
        if heard.garbled and baud not in noisy and not any(servo.clash for servo in found):
            noisy.append(baud)
        servos += found
    progress(1.0)
    rates = tuple(dict.fromkeys((*bauds, *old_bauds)))
    return Scan(line.port, rates, tuple(servos), tuple(noisy), echo)


def _everybody(call: _Call) -> tuple[list[FoundServo], Heard]:
    """Return the Protocol 2.0 servos at a rate, and what a broadcast ping made heard."""
    every = call.ping(BROADCAST, BROADCAST_WAIT)
    ids = set(_ids(every.answers))
    if every.garbled:
        ids.update(range(MAX_ID + 1))
    found = [_look(call, servo_id, every) for servo_id in sorted(ids)]
    return [servo for servo in found if servo is not None], every


def _one_by_one(call: _Call) -> tuple[list[FoundServo], Heard]:
    """Return the Protocol 1.0 servos at a rate, and whether an echo came."""
    found: list[FoundServo] = []
    echo = False
    for servo_id in range(protocol1.MAX_ID + 1):
        heard = call.read(servo_id, 0, OLD_HEAD)
        echo |= heard.echo
        if heard.answers or heard.garbled:
            found.append(_look_old(call, servo_id, heard))
    return found, Heard((), garbled=False, echo=echo)


def _ids(answers: Iterable[Packet]) -> list[int]:
    return [answer.servo_id for answer in answers if len(answer.params) == 4]


def _look(call: _Call, servo_id: int, every: Heard) -> FoundServo | None:
    """Return the servo (or servos) of an id; ``None`` if nobody answers to it."""
    heard = call.ping(servo_id, call.wait)
    if not heard.answers and not heard.garbled and servo_id not in _ids(every.answers):
        return None
    clash = heard.garbled or Counter(_ids(every.answers))[servo_id] > 1
    clash |= len(heard.answers) > 1
    if not heard.answers:
        return FoundServo(servo_id, call.baud, None, None, clash, ("its answers are damaged",))
    params = heard.answers[0].params
    number, firmware = params[1] | params[2] << 8, params[3]
    clash, notes = _judge(call, servo_id, number, clash)
    return FoundServo(servo_id, call.baud, number, firmware, clash, notes)


def _look_old(call: _Call, servo_id: int, heard: Heard) -> FoundServo:
    """Return the Protocol 1.0 servo (or servos) of an id that something was heard of."""
    whole = [answer for answer in heard.answers if len(answer.params) == OLD_HEAD + 1]
    clash = heard.garbled or len(heard.answers) > 1
    if not whole:
        notes = ("its answers are damaged",)
        return FoundServo(servo_id, call.baud, None, None, clash, notes, protocol=1)
    params = whole[0].params
    number, firmware = params[1] | params[2] << 8, None
    if model_name(number) in model_names():
        firmware = call.value(servo_id, control_table(model_name(number))["firmware_version"])
    clash, notes = _judge(call, servo_id, number, clash)
    return FoundServo(servo_id, call.baud, number, firmware, clash, notes, protocol=1)


def _judge(call: _Call, servo_id: int, number: int, clash: bool) -> tuple[bool, tuple[str, ...]]:
    """Return whether several servos answer to an id, and what to know about the one that does."""
    if model_name(number) not in model_names():
        notes = ["no control table for this model"]
    else:
        table = control_table(model_name(number))
        # Twice, with more patience: an answer that comes late looks like one too many.
        clash = clash or not any(_is_alone(call, servo_id, table, more) for more in (1, 4))
        notes = [] if clash else _notes(call, servo_id, table)
    if clash:
        notes = ["several servos answer to this id, or the wire damages what it says"]
    elif call.protocol == 1:
        notes.insert(0, "speaks Protocol 1.0: cannot be played")
    return clash, tuple(notes)


def _is_alone(call: _Call, servo_id: int, table: ControlTable, patience: float) -> bool:
    for _ in range(LOOKS):
        for name in LIVELY:
            if name in table:
                register = table[name]
                heard = call.read(servo_id, register.address, register.length, patience)
                if heard.garbled or len(heard.answers) > 1:
                    return False
    return True


def _notes(call: _Call, servo_id: int, table: ControlTable) -> list[str]:
    """Return what stands in the way of playing, or is slower than it need be."""
    value: dict[str, int] = {}
    for name in (
        *("return_delay_time", "drive_mode", "homing_offset", "operating_mode"),
        *("status_return_level", "torque_enable", "hardware_error_status"),
    ):
        found = call.value(servo_id, table[name]) if name in table else None
        if found is not None:
            value[name] = found
    notes: list[str] = []
    if value.get("hardware_error_status"):
        errors = ", ".join(hardware_error_names(value["hardware_error_status"], table.errors))
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
