"""A virtual Dynamixel bus: bytes in, timed bytes out.

**The problem.** To prove a player without hardware, the other end must be what a real client cannot
tell from servos: every instruction, every status rule, the timing of a half-duplex wire. And to be
of use in tests it must be deterministic and know neither threads nor sockets. So the core is one
pure call::

    feed(now, bytes)  ->  [(due, bytes), ...]

``now`` is when the last byte arrived, ``due`` when the last byte of the answer has arrived at the
host. Front ends (:mod:`bridge.virtual.pty`, :mod:`bridge.virtual.serial`) add the transport.

Timing, if a baud rate is set: ten bits per byte both ways, then Return Delay Time before each
status. Example at 1 Mbit/s with no delay: a ping (10 bytes) fed at 0 is heard at 0.10 ms and its
answer (14 bytes) is due at 0.24 ms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from bridge.servo import packets
from bridge.servo.packets import Packet, Parser
from bridge.servo.registers import RETURN_DELAY_UNIT
from bridge.virtual.faults import FaultPlan
from bridge.virtual.instructions import Act, single, word
from bridge.virtual.line_faults import LineFaults, Timed, collide
from bridge.virtual.plant import Plant
from bridge.virtual.protocol1 import Protocol1
from bridge.virtual.servo import VirtualServo
from bridge.virtual.servo_faults import ServoFaults

SILENCE = 0.05
"""Silence after which half a packet is forgotten, s."""
ABSENT_WAIT = 0.0005
"""How long the servos behind an absent one wait for it in a sync read, s."""
Request = tuple[int, int, int]
"""Servo id, address and length of one part of a sync or bulk read."""
Hearing = list[VirtualServo]
"""Servos that a packet has reached."""


class VirtualBus:
    """Servos on one wire."""

    def __init__(
        self,
        servos: Iterable[VirtualServo],
        *,
        baud: int | None = None,
        faults: FaultPlan | None = None,
        plant: Plant | None = None,
    ) -> None:
        """Connect servos.

        Args:
            servos: In any order. Two with the same id both answer, at once, as on a real bus.
            baud: bit/s for the wire's timing; ``None`` for an infinitely fast wire.
            faults: What goes wrong.
            plant: The body that all the servos move together; ``None`` if each turns for itself.
        """
        self.servos = list(servos)
        self.baud = baud
        self.faults = faults or FaultPlan()
        self.plant = plant
        self._line = LineFaults(self.faults)
        self._mishaps = ServoFaults(self.faults, self.servos)
        self.instructions = 0
        """Instruction packets understood so far."""
        self._parser = Parser()
        self._protocol1 = Protocol1(self)
        self._heard = 0.0
        self._free = 0.0
        self._line_baud: int | None = None
        self._handlers: dict[int, Callable[[float, Packet, Hearing], Timed]] = {
            packets.PING: self._ping,
            packets.SYNC_READ: self._sync_read,
            packets.FAST_SYNC_READ: self._sync_read,
            packets.SYNC_WRITE: self._sync_write,
            packets.BULK_READ: self._bulk_read,
            packets.FAST_BULK_READ: self._bulk_read,
            packets.BULK_WRITE: self._bulk_write,
        }

    def servo(self, servo_id: int) -> VirtualServo:
        """Return the servo with an id.

        Raises:
            KeyError: There is none.
        """
        for servo in self.servos:
            if servo.id == servo_id:
                return servo
        raise KeyError(servo_id)

    def advance(self, now: float) -> None:
        """Let time pass for all servos and faults."""
        if self.faults.faults:
            for when, index, begins in self._mishaps.changes(now):
                self._move(when)
                self._mishaps.change(when, index, begins)
        self._move(now)

    def _move(self, now: float) -> None:
        for twin in self._mishaps.twins:
            twin.advance(now)
        if self.plant is not None:
            self.plant.advance(now)
            return
        for servo in self.servos:
            if now >= servo.due:
                servo.advance(now)

    def feed(self, now: float, data: bytes, *, baud: int | None = None) -> Timed:
        """Take bytes that reached the wire and return the answers with their times.

        Args:
            now: s, any clock that never runs backwards.
            data: The bytes.
            baud: Rate the client sends at: servos set to another rate hear nothing. ``None`` if the
                transport has no rate.
        """
        if self._parser.pending and now - self._heard > SILENCE:
            self._parser.reset()
        self._heard = now
        self._line_baud = baud
        answers: Timed = []
        sent = max(now, self._free) + self._duration(len(data))
        for packet in self._parser.feed(data):
            if packet.code == packets.STATUS:
                continue
            hearing = self.hear(now, packet.size, 2)
            answers += self._handlers.get(packet.code, self._single)(now, packet, hearing)
        if any(servo.protocol == 1 for servo in self.servos):
            answers += self._protocol1.feed(now, data)
        if self.faults.faults:
            answers = self._line.deliver(now, data, sent, answers, self._duration(1))
        return answers

    # -- who hears, who answers, when -------------------------------------------------------------

    def _duration(self, size: int) -> float:
        return size * 10 / self.baud if self.baud else 0.0

    def hear(self, now: float, size: int, protocol: int) -> Hearing:
        """Let a packet of ``size`` bytes arrive and return the servos that understand it."""
        self._free = max(now, self._free) + self._duration(size)
        self.advance(now)
        self.instructions += 1
        hearing = [servo for servo in self._hearing(now) if servo.protocol == protocol]
        for servo in hearing:
            servo.hear(now)
        return hearing

    def wait_for_absent(self) -> None:
        """Let the time pass that those behind an absent servo wait for it."""
        self._free += ABSENT_WAIT

    def _hearing(self, now: float) -> Hearing:
        """Return the servos that hear a packet now: awake, at its rate, and not cut off."""
        rate, faults = self._line_baud, self.faults
        every = [*self.servos, *self._mishaps.twins] if faults.faults else self.servos
        servos = [
            servo
            for servo in every
            if now >= servo.boots_at and (rate is None or rate == servo.baud)
        ]
        if faults.faults:
            lost = [fault.servo_id for fault in faults.of("deaf", now) if faults.chance(fault)]
            lost += [fault.servo_id for fault in faults.of("silence", now)]
            if lost:
                servos = [s for s in servos if None not in lost and s.id not in lost]
        return servos

    def _said(self, now: float, servo: VirtualServo, packet: bytes) -> Timed:
        """Return the timed status packet of one servo."""
        delay = servo.return_delay * RETURN_DELAY_UNIT
        if self.faults.faults:
            delay += self._line.lateness(now, servo.id)
        self._free = max(self._free, now) + delay + self._duration(len(packet))
        if self.faults.faults:
            packet = self._line.answer(now, servo.id, packet)
        return [(self._free, packet)] if packet else []

    def _statuses(
        self, now: float, answers: list[tuple[VirtualServo, int, bytes]], answer_as: int = -1
    ) -> Timed:
        """Return what is heard of servos that answer to one id: of several, all at once."""
        said: list[tuple[VirtualServo, bytes]] = []
        for servo, error, data in answers:
            servo_id = servo.id if answer_as < 0 else answer_as
            said.append((servo, packets.status(servo_id, error | servo.alert, data)))
        return self.say(now, said)

    def say(self, now: float, said: list[tuple[VirtualServo, bytes]]) -> Timed:
        """Return what is heard of servos that send a packet each: of several, all at once."""
        if not said:
            return []
        if len(said) == 1:
            return self._said(now, *said[0])
        free, byte = max(self._free, now), self._duration(1)
        pieces: Timed = []
        ends = [free]
        for servo, packet in said:
            self._free = free
            pieces += [
                (end - len(heard) * byte, heard) for end, heard in self._said(now, servo, packet)
            ]
            ends.append(self._free)
        self._free = max(ends)
        return collide(pieces, byte)

    # -- instructions -----------------------------------------------------------------------------

    def _ping(self, now: float, packet: Packet, hearing: Hearing) -> Timed:
        answers: Timed = []
        everybody = packet.servo_id == packets.BROADCAST
        called = _addressed(packet.servo_id, hearing)
        groups = sorted(_by_id(called).items()) if everybody else [(packet.servo_id, called)]
        for servo_id, servos in groups:
            said = [(servo, 0, _introduction(servo)) for servo in servos]
            answers += self._statuses(now, said, answer_as=servo_id)
        return answers

    def _single(self, now: float, packet: Packet, hearing: Hearing) -> Timed:
        """Carry out an instruction for one servo (or, without answers, for all)."""
        act, level = single(packet, now)
        return self._each(now, packet, hearing, act, level=level)

    def _each(
        self,
        now: float,
        packet: Packet,
        hearing: Hearing,
        act: Act,
        *,
        level: int,
    ) -> Timed:
        """Act on every addressed servo; answer if its Status Return Level is ``level`` or more."""
        said: list[tuple[VirtualServo, int, bytes]] = []
        for servo in _addressed(packet.servo_id, hearing):
            answering = servo.return_level >= level
            error, data = act(servo)
            if answering and packet.servo_id != packets.BROADCAST:
                said.append((servo, error, data))
        return self._statuses(now, said, answer_as=packet.servo_id)

    def _sync_read(self, now: float, packet: Packet, hearing: Hearing) -> Timed:
        params = packet.params
        if packet.servo_id != packets.BROADCAST or len(params) < 5:
            return []
        address, length = word(params, 0), word(params, 2)
        requests = [(servo_id, address, length) for servo_id in params[4:]]
        fast = packet.code == packets.FAST_SYNC_READ
        return (self._read_fast if fast else self._read_plain)(now, requests, hearing)

    def _bulk_read(self, now: float, packet: Packet, hearing: Hearing) -> Timed:
        params = packet.params
        if packet.servo_id != packets.BROADCAST or not params or len(params) % 5:
            return []
        requests = [
            (params[at], word(params, at + 1), word(params, at + 3))
            for at in range(0, len(params), 5)
        ]
        fast = packet.code == packets.FAST_BULK_READ
        return (self._read_fast if fast else self._read_plain)(now, requests, hearing)

    def _read_plain(self, now: float, requests: list[Request], hearing: Hearing) -> Timed:
        """Answer with one packet per servo, each when the one before it has ended."""
        servos = _by_id(hearing)
        answers: Timed = []
        for servo_id, address, length in requests:
            present = servos.get(servo_id)
            if present is None:
                self._free += ABSENT_WAIT
                continue
            said = [
                (servo, *servo.read(address, length))
                for servo in present
                if servo.return_level >= 1
            ]
            answers += self._statuses(now, said)
        return answers

    def _read_fast(self, now: float, requests: list[Request], hearing: Hearing) -> Timed:
        """Answer with one chained packet; it breaks off at the first servo that is not there."""
        if 1 + sum(length + 4 for _, _, length in requests) > packets.MAX_LENGTH:
            return []
        servos = _by_id(hearing)
        entries: list[tuple[int, int, bytes]] = []
        delay = 0
        whole = True
        for servo_id, address, length in requests:
            servo = servos[servo_id][0] if servo_id in servos else None
            if servo is None or not servo.reads_fast:
                whole = False
                break
            delay = max(delay, servo.return_delay)
            error, data = servo.read(address, length)
            entries.append((error | servo.alert, servo_id, data))
        missing = len(requests) - len(entries)
        filler = [(0, 0, bytes(length)) for _, _, length in requests[-missing:]] if missing else []
        pieces = packets.fast_status(entries + filler)[: 1 + len(entries)]
        for at, (_, servo_id, _) in enumerate(entries):
            for other in servos[servo_id][1:]:  # of the same id: both send their part at once
                error, data = other.read(*requests[at][1:])
                theirs = [*entries[:at], (error | other.alert, servo_id, data)]
                part = packets.fast_status(theirs + filler)[at + 1]
                pieces[at + 1] = bytes(a & b for a, b in zip(pieces[at + 1], part, strict=True))
        late = delay * RETURN_DELAY_UNIT
        size = sum(map(len, pieces)) if whole or entries else 0
        packet = b"".join(pieces) if size else b""
        if self.faults.faults and size:
            ids = [servo_id for _, servo_id, _ in entries]
            late += self._line.lateness(now, *ids)
            parts = [b"".join(pieces[:2]), *pieces[2:]]
            packet = self._line.chain(now, list(zip(ids, parts, strict=True)))
        self._free = max(self._free, now) + late + self._duration(size)
        return [(self._free, packet)] if packet else []

    def _sync_write(self, now: float, packet: Packet, hearing: Hearing) -> Timed:
        params = packet.params
        if packet.servo_id != packets.BROADCAST or len(params) < 4:
            return []
        address, length = word(params, 0), word(params, 2)
        if (len(params) - 4) % (length + 1):
            return []
        servos = _by_id(hearing)
        for at in range(4, len(params), length + 1):
            for servo in servos.get(params[at], ()):
                servo.write(address, params[at + 1 : at + 1 + length])
        return []

    def _bulk_write(self, now: float, packet: Packet, hearing: Hearing) -> Timed:
        params, at = packet.params, 0
        servos = _by_id(hearing)
        while packet.servo_id == packets.BROADCAST and at + 5 <= len(params):
            length = word(params, at + 3)
            data = params[at + 5 : at + 5 + length]
            for servo in servos.get(params[at], ()):
                if len(data) == length:
                    servo.write(word(params, at + 1), data)
            at += 5 + length
        return []


def _introduction(servo: VirtualServo) -> bytes:
    """Return what a servo says of itself in answer to a ping: model number and firmware."""
    number = servo.memory.get("model_number").to_bytes(2, "little")
    return number + bytes((servo.memory.get("firmware_version"),))


def _by_id(hearing: Hearing) -> dict[int, Hearing]:
    """Return servos by id: more than one if ids clash."""
    servos: dict[int, Hearing] = {}
    for servo in hearing:
        servos.setdefault(servo.id, []).append(servo)
    return servos


def _addressed(servo_id: int, hearing: Hearing) -> Hearing:
    """Return the servos that an instruction to an id is for."""
    if servo_id == packets.BROADCAST:
        return hearing
    return [servo for servo in hearing if servo.answers_to(servo_id)]
