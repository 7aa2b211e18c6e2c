"""The Protocol 1.0 side of a virtual bus: for AX and MX servos, and X servos set to that protocol.

The same servos and registers as behind Protocol 2.0; only the packets differ. One byte is all that
a servo says about errors: what is wrong with itself and with the instruction. Bulk Read is only
known to the MX, Reboot and Sync Read to none. Nobody answers a broadcast, not even to a ping.
"""

from __future__ import annotations

from typing import Protocol

from bridge.servo import packets
from bridge.servo.protocol1 import (
    ACTION,
    BROADCAST,
    BULK_READ,
    ERROR_ANGLE,
    ERROR_CHECKSUM,
    ERROR_INSTRUCTION,
    ERROR_RANGE,
    FACTORY_RESET,
    HARDWARE_BITS,
    MAX_PARAMS,
    PING,
    READ,
    REG_WRITE,
    SYNC_WRITE,
    WRITE,
    Packet,
    Parser,
    packet,
)
from bridge.virtual.line_faults import Timed
from bridge.virtual.servo import VirtualServo

SILENCE = 0.05
"""Silence after which half a packet is forgotten, s."""
EVERYTHING = 0xFF
"""Level of a factory reset that keeps nothing: the only one here."""


class Wire(Protocol):
    """What the bus does for both protocols."""

    def hear(self, now: float, size: int, protocol: int) -> list[VirtualServo]:
        """Let a packet of ``size`` bytes arrive and return the servos that hear it."""
        ...

    def say(self, now: float, said: list[tuple[VirtualServo, bytes]]) -> Timed:
        """Return what is heard of servos that send a packet each, all at once."""
        ...

    def wait_for_absent(self) -> None:
        """Let the time pass that those behind an absent servo wait for it."""
        ...


class Protocol1:
    """Understands Protocol 1.0 on a wire and answers for its servos."""

    def __init__(self, wire: Wire) -> None:
        """Listen on a wire."""
        self._wire = wire
        self._parser = Parser()
        self._heard = 0.0

    def feed(self, now: float, data: bytes) -> Timed:
        """Take bytes that reached the wire and return the answers with their times."""
        if self._parser.pending and now - self._heard > SILENCE:
            self._parser.reset()
        self._heard = now
        answers: Timed = []
        for found in self._parser.feed(data):
            hearing = self._wire.hear(now, found.size, 1)
            if not found.intact:
                answers += self._each(now, found, hearing)
            elif found.code == SYNC_WRITE:
                _sync_write(found, hearing)
            elif found.code == BULK_READ:
                answers += self._bulk_read(now, found, hearing)
            else:
                answers += self._each(now, found, hearing)
        return answers

    def _each(self, now: float, found: Packet, hearing: list[VirtualServo]) -> Timed:
        """Act on every addressed servo; those of one id answer at once."""
        said: list[tuple[VirtualServo, bytes]] = []
        for servo in hearing:
            if found.servo_id != BROADCAST and not servo.answers_to(found.servo_id):
                continue
            answers = servo.return_level >= (0 if found.code == PING else 1 + (found.code != READ))
            error, data = _act(servo, found, now)
            if answers and found.servo_id != BROADCAST:
                status = packet(found.servo_id, servo.errors & HARDWARE_BITS | error, data)
                said.append((servo, status))
        return self._wire.say(now, said)

    def _bulk_read(self, now: float, found: Packet, hearing: list[VirtualServo]) -> Timed:
        """Answer one after the other; of an id that is named twice the first request counts."""
        params = found.params
        if found.servo_id != BROADCAST or len(params) < 4 or params[0] or len(params) % 3 != 1:
            return []
        answers: Timed = []
        asked: set[int] = set()
        for at in range(1, len(params), 3):
            length, servo_id, address = params[at : at + 3]
            if servo_id in asked:
                continue
            asked.add(servo_id)
            able = [servo for servo in hearing if servo.id == servo_id and servo.has("bulk_read")]
            request = Packet(servo_id, READ, bytes((address, length)), 0, intact=True)
            if able:
                answers += self._each(now, request, able)
            else:
                self._wire.wait_for_absent()
        return answers


def _act(servo: VirtualServo, found: Packet, now: float) -> tuple[int, bytes]:
    """Carry out an instruction on one servo and return (error bits, data)."""
    params, code, data = found.params, 0, b""
    if not found.intact:
        return ERROR_CHECKSUM, b""
    asked, count = found.code, len(params)
    if asked == PING and not count:
        return 0, b""
    if asked == READ and count == 2 and params[1] <= MAX_PARAMS:
        code, data = servo.read(params[0], params[1])
    elif asked in (WRITE, REG_WRITE) and count >= 2:
        write = servo.write if asked == WRITE else servo.register_write
        code = write(params[0], params[1:])
    elif asked == ACTION and not count:
        code = servo.action()
    elif asked == FACTORY_RESET and not count:
        everybody = found.servo_id == BROADCAST
        code = servo.factory_reset(EVERYTHING, now, everybody=everybody)
    elif asked in (PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET):
        return ERROR_RANGE, b""
    else:
        return ERROR_INSTRUCTION, b""
    return _error_bits(servo, code, params), data


def _error_bits(servo: VirtualServo, code: int, params: bytes) -> int:
    """Return an error of the servo's rules as Protocol 1.0 says it."""
    if not code:
        return 0
    if code in (packets.ERROR_RESULT, packets.ERROR_INSTRUCTION):
        return ERROR_INSTRUCTION
    if code == packets.ERROR_LIMIT and params[:1] == bytes((servo.table["goal_position"].address,)):
        return ERROR_ANGLE
    return ERROR_RANGE


def _sync_write(found: Packet, hearing: list[VirtualServo]) -> None:
    """Write to several servos; nobody answers."""
    params = found.params
    if found.servo_id != BROADCAST or len(params) < 2:
        return
    address, length = params[0], params[1]
    if (len(params) - 2) % (length + 1):
        return
    for at in range(2, len(params), length + 1):
        for servo in hearing:
            if servo.id == params[at]:
                servo.write(address, params[at + 1 : at + 1 + length])
