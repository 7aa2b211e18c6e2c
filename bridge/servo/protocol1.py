"""Dynamixel Protocol 1.0 on the byte level: checksum, packets and a parser.

**The problem.** A packet is ``FF FF ID LEN CODE params CHK``, with LEN the number of parameters
plus two and CHK the complement of the sum of all between header and checksum. CODE is the
instruction, or the error in a status packet: nothing tells the two apart. The header may occur
inside, eight bits are all that guards the content, and Protocol 2.0 packets, ``FF FF FD 00``, may
run on the same wire. They are passed over as a whole: 0 is no length here.

Worked example, Ping to id 1: ``FF FF 01 02 01 FB``, because ``~(01 + 02 + 01) = FB``.

Source: ROBOTIS e-manual, "Protocol 1.0".
"""

from __future__ import annotations

from dataclasses import dataclass

from bridge.servo import packets

HEADER = b"\xff\xff"
BROADCAST = 0xFE
MAX_ID = 253
MAX_PARAMS = 253
"""Parameters that a packet can hold: LEN is one byte."""

PING, READ, WRITE, REG_WRITE, ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
FACTORY_RESET, SYNC_WRITE, BULK_READ = 0x06, 0x83, 0x92

ERROR_ANGLE, ERROR_RANGE, ERROR_CHECKSUM, ERROR_INSTRUCTION = 0x02, 0x08, 0x10, 0x40
"""Bits of the error byte that blame the instruction; the others are hardware errors."""
HARDWARE_BITS = 0x25
"""Bits of the error byte that stand for hardware errors: voltage, heat and load."""


def checksum(body: bytes | bytearray) -> int:
    """Return the checksum of what stands between header and checksum."""
    return ~sum(body) & 0xFF


def packet(servo_id: int, code: int, params: bytes = b"") -> bytes:
    """Return a packet; ``code`` is an instruction, or the error byte of a status.

    Raises:
        ValueError: The id is not one, or there are too many parameters.
    """
    if not 0 <= servo_id <= BROADCAST:
        raise ValueError(f"{servo_id} is not a servo id")
    if len(params) > MAX_PARAMS:
        raise ValueError(f"{len(params)} parameters are more than {MAX_PARAMS}")
    body = bytes((servo_id, len(params) + 2, code)) + params
    return HEADER + body + bytes((checksum(body),))


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet, or what looks like one."""

    servo_id: int
    """Whom it is for, or whom it is from."""
    code: int
    """Instruction, or error."""
    params: bytes
    """What follows."""
    size: int
    """Bytes it took on the wire."""
    intact: bool
    """Whether its checksum was right."""


class Parser(packets.StreamBuffer):
    """Finds packets in a stream of bytes.

    Never raises on any bytes. Of a packet with a wrong checksum, which is given out as such, only
    the first byte is dropped: a whole one may begin inside.
    """

    def feed(self, data: bytes | bytearray | memoryview) -> list[Packet]:
        """Take more bytes and return the packets that are now complete."""
        buffer = self._buffer
        buffer += data
        found: list[Packet] = []
        start = 0
        while True:
            start = self._seek(start)
            left = len(buffer) - start
            if left < 4:
                break
            size = self._foreign(start)
            if size:
                if left < size:
                    break
                start += size
                continue
            size = buffer[start + 3] + 4
            if buffer[start + 2] == 0xFF or size < 6:
                start += 1
                self.dropped += 1
                continue
            if left < size:
                break
            body = buffer[start + 2 : start + size - 1]
            intact = checksum(body) == buffer[start + size - 1]
            found.append(Packet(body[0], body[2], bytes(body[3:]), size, intact))
            start += size if intact else 1
            self.dropped += 0 if intact else 1
        del buffer[:start]
        return found

    def _foreign(self, start: int) -> int:
        """Return the size of a Protocol 2.0 packet (as far as it can be known), 0 if it is none."""
        buffer = self._buffer
        if buffer[start : start + 4] != packets.HEADER:
            return 0
        if len(buffer) - start < 7:
            return 7
        length = buffer[start + 5] | buffer[start + 6] << 8
        return 7 + length if 3 <= length <= packets.MAX_LENGTH else 0

    def _seek(self, start: int) -> int:
        """Return where the next header, or what may become one, begins."""
        buffer = self._buffer
        found = buffer.find(HEADER, start)
        if found < 0:
            found = len(buffer) - (len(buffer) > start and buffer[-1] == 0xFF)
        self.dropped += found - start
        return found
