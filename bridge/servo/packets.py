r"""Dynamixel Protocol 2.0 on the byte level: checksum, stuffing, packets and a parser.

**The problem.** A packet is ``FF FF FD 00 ID LEN_L LEN_H INST params CRC_L CRC_H``. The header may
not occur inside, so wherever ``FF FF FD`` appears from INST to the last parameter, an ``FD`` is
stuffed behind it; LEN and CRC are computed after stuffing. A receiver may be switched on in the
middle of a packet, lose bytes or see noise: it must find the next header, never trust LEN without
the CRC, and never give out what the CRC does not confirm.

Worked example, parameters ``FF FF FD FD`` (one real ``FD`` follows the pattern)::

    sent      FF FF FD [FD] FD     the bracketed byte is the stuffing
    received  FF FF FD FD FD  ->  FF FF FD FD

The parser keeps what may still become a packet, at most :data:`MAX_PACKET` bytes; when a candidate
fails, only its first byte is dropped and the search goes on behind it.

Source: ROBOTIS e-manual, "Protocol 2.0".
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from functools import cache
from struct import Struct

import numpy as np
from numpy.typing import NDArray

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
MAX_ID = 252
MAX_LENGTH = 1024 - 7
"""Largest LEN field that is believed: packets of up to 1024 bytes."""
MAX_PACKET = MAX_LENGTH + 7
FAST_OVERHEAD = 4
"""Bytes of one servo's part of a fast read's answer beside its data: error, id and CRC."""

PING, READ, WRITE, REG_WRITE, ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
FACTORY_RESET, REBOOT, CLEAR, BACKUP = 0x06, 0x08, 0x10, 0x20
STATUS = 0x55
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ = 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x92, 0x93, 0x9A

ERROR_RESULT, ERROR_INSTRUCTION, ERROR_CRC, ERROR_RANGE = 1, 2, 3, 4
ERROR_LENGTH, ERROR_LIMIT, ERROR_ACCESS = 5, 6, 7
ALERT = 0x80
"""Bit of a status packet's error byte: look at Hardware Error Status."""

ERROR_NAMES = {
    ERROR_RESULT: "could not process the instruction",
    ERROR_INSTRUCTION: "unknown instruction",
    ERROR_CRC: "received a damaged packet",
    ERROR_RANGE: "value out of range",
    ERROR_LENGTH: "wrong data length",
    ERROR_LIMIT: "value beyond a configured limit",
    ERROR_ACCESS: "address not accessible",
}


def _byte_table() -> tuple[int, ...]:
    table = []
    for index in range(256):
        crc = index << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        table.append(crc)
    return tuple(table)


_BYTES = _byte_table()
LONG = 128
"""Bytes from which on the CRC is summed up by numpy instead of word by word."""
_WORDS_OF = tuple(Struct(f">{count}H").unpack_from for count in range(MAX_PACKET // 2 + 1))
"""Take so many big-endian words out of bytes."""


def _word_table() -> array[int]:
    """Return the CRC of two zero bytes by the CRC before them.

    A CRC is linear and this one has 16 bits: two bytes of data enter it by exclusive or, and what
    follows is the table. Half as many steps as with the usual table of single bytes.
    """
    single = np.array(_BYTES, np.uint16)
    crc = np.arange(65536, dtype=np.uint16)
    for _ in range(2):
        crc = np.left_shift(crc, np.uint16(8)) ^ single[crc >> 8]
    return array("H", crc.tobytes())


_WORDS = _word_table()
_DISTANCE = 256 * np.arange(MAX_PACKET - 1, -1, -1, dtype=np.int64)


@cache
def _contributions() -> NDArray[np.uint16]:
    """Return what a byte adds to the CRC, by 256 times its distance from the end plus its value.

    By the same linearity, the CRC of a message is the exclusive or of those of its single bytes,
    each followed by as many zeros as there are bytes behind it.
    """
    table = np.array(_BYTES, np.uint16)
    rows: list[NDArray[np.uint16]] = [table]
    for _ in range(MAX_PACKET - 1):
        last = rows[-1]
        rows.append(np.left_shift(last, np.uint16(8)) ^ table[last >> 8])
    return np.concatenate(rows)


def crc16(data: bytes | bytearray | memoryview, crc: int = 0) -> int:
    """Return the CRC-16 (polynomial 0x8005, start ``crc``, not reflected) of ``data``."""
    count = len(data)
    if LONG <= count <= MAX_PACKET:
        index = np.frombuffer(data, np.uint8) + _DISTANCE[-count:]
        index[0] ^= crc >> 8
        index[1] ^= crc & 0xFF
        return int(np.bitwise_xor.reduce(_contributions()[index]))
    if count > MAX_PACKET:
        return crc16(data[MAX_PACKET:], crc16(data[:MAX_PACKET], crc))
    if count & 1:
        crc = ((crc << 8) & 0xFFFF) ^ _BYTES[(crc >> 8) ^ data[0]]
    table = _WORDS
    for word in _WORDS_OF[count >> 1](data, count & 1):
        crc = table[crc ^ word]
    return crc


def crc16_rows(rows: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Return the CRC-16 of each row of ``[N, M]`` bytes, M at most :data:`MAX_PACKET`."""
    index = rows + _DISTANCE[-rows.shape[1] :]
    return np.bitwise_xor.reduce(_contributions().take(index), axis=1)


def stuff(body: bytes) -> bytes:
    """Return INST and parameters with an ``FD`` behind every ``FF FF FD``."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Undo :func:`stuff`."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def packet(servo_id: int, body: bytes) -> bytes:
    """Return the packet of a body (INST and parameters, not stuffed) as it goes on the wire.

    Raises:
        ValueError: The id is not one, or the packet would be longer than 1024 bytes.
    """
    if not (0 <= servo_id <= MAX_ID or servo_id == BROADCAST):
        raise ValueError(f"{servo_id} is not a servo id")
    body = stuff(body)
    length = len(body) + 2
    if length > MAX_LENGTH:
        raise ValueError(f"a packet of {length + 7} bytes is longer than {MAX_PACKET}")
    head = HEADER + bytes((servo_id, length & 0xFF, length >> 8)) + body
    return head + crc16(head).to_bytes(2, "little")


def instruction(servo_id: int, code: int, params: bytes = b"") -> bytes:
    """Return an instruction packet."""
    return packet(servo_id, bytes((code,)) + params)


def status(servo_id: int, error: int = 0, params: bytes = b"") -> bytes:
    """Return a status packet."""
    return packet(servo_id, bytes((STATUS, error)) + params)


def fast_status(entries: list[tuple[int, int, bytes]]) -> list[bytes]:
    """Return the pieces of a Fast Sync/Bulk Read status: the head, then one piece per servo.

    The pieces form one packet that is never stuffed. The CRC in each piece is cumulative: it covers
    all bytes before it, earlier CRCs included.

    Args:
        entries: ``(error, id, data)`` of each servo, in the order of the request.
    """
    length = 1 + sum(len(data) + 4 for _, _, data in entries)
    head = HEADER + bytes((BROADCAST, length & 0xFF, length >> 8, STATUS))
    pieces, crc, table = [head], crc16(head), _WORDS
    for error, servo_id, data in entries:
        piece = bytes((error, servo_id)) + data
        crc = crc16(piece, crc)
        pieces.append(piece + crc.to_bytes(2, "little"))
        crc = table[crc ^ (crc >> 8 | crc << 8 & 0xFF00)]
    return pieces


def fast_head(length: int, count: int) -> bytes:
    """Return the head of the answer of ``count`` servos to a fast read of ``length`` bytes each."""
    size = 1 + count * (length + FAST_OVERHEAD)
    return HEADER + bytes((BROADCAST, size & 0xFF, size >> 8, STATUS))


def fast_answers(answer: bytes, length: int, count: int) -> list[tuple[int, int, bytes]]:
    """Return ``(error, id, data)`` of the servos whose part of a fast read's answer is intact.

    The first missing or damaged part ends the list: each CRC covers all that came before it.

    Args:
        answer: The bytes from :func:`fast_head` on, possibly cut off.
        length: Bytes asked of each servo.
        count: How many servos were asked.
    """
    size = length + FAST_OVERHEAD
    head = len(HEADER) + 4
    parts = min(count, (len(answer) - head) // size)
    if parts == count:
        whole = answer[: head + count * size]
        if crc16(whole[:-2]) != whole[-2] | whole[-1] << 8:
            parts = _intact(whole, size, head)
    else:
        parts = _intact(answer[: head + max(0, parts) * size], size, head)
    return [
        (answer[at], answer[at + 1], answer[at + 2 : at + 2 + length])
        for at in range(head, head + parts * size, size)
    ]


def _intact(answer: bytes, size: int, head: int) -> int:
    """Return how many parts at the beginning of a fast read's answer have a right CRC."""
    crc, count = crc16(answer[:head]), 0
    for at in range(head, len(answer), size):
        part = answer[at : at + size]
        crc = crc16(part[:-2], crc)
        if crc != part[-2] | part[-1] << 8:
            break
        crc = crc16(part[-2:], crc)
        count += 1
    return count


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet whose CRC was right."""

    servo_id: int
    """Whom it is for, or whom it is from."""
    code: int
    """Instruction, or :data:`STATUS`."""
    params: bytes
    """What follows the instruction, unstuffed. In a status packet the first byte is the error."""
    size: int
    """Bytes it took on the wire."""


class StreamBuffer:
    """Bytes of a stream that no packet has been made of yet."""

    def __init__(self) -> None:
        """Start with nothing seen."""
        self._buffer = bytearray()
        self.dropped = 0
        """Bytes thrown away so far because they belonged to no intact packet."""

    @property
    def pending(self) -> int:
        """Bytes kept because they may be the start of a packet."""
        return len(self._buffer)

    def reset(self) -> None:
        """Forget the bytes kept, as after silence on the line."""
        self.dropped += len(self._buffer)
        self._buffer.clear()


class Parser(StreamBuffer):
    """Finds packets in a stream of bytes.

    Never raises on any bytes; see the module's text for what it keeps and drops.
    """

    def feed(self, data: bytes | bytearray | memoryview) -> list[Packet]:
        """Take more bytes and return the packets that are now complete."""
        buffer = self._buffer
        buffer += data
        packets: list[Packet] = []
        start = 0
        while True:
            start = self._seek(start)
            if len(buffer) - start < 7:
                break
            length = buffer[start + 5] | buffer[start + 6] << 8
            if buffer[start + 4] in (0xFD, 0xFF) or not 3 <= length <= MAX_LENGTH:
                start += 1
                self.dropped += 1
                continue
            end = start + 7 + length
            if len(buffer) < end:
                break
            whole = bytes(buffer[start:end])
            if crc16(whole[:-2]) != whole[-2] | whole[-1] << 8:
                start += 1
                self.dropped += 1
                continue
            packets.append(_decode(whole))
            start = end
        del buffer[:start]
        return packets

    def _seek(self, start: int) -> int:
        """Return where the next header, or what may become one, begins."""
        buffer = self._buffer
        found = buffer.find(HEADER, start)
        if found < 0:
            found = len(buffer)
            for keep in (3, 2, 1):
                if len(buffer) - start >= keep and buffer.endswith(HEADER[:keep]):
                    found = len(buffer) - keep
                    break
        self.dropped += found - start
        return found


def _decode(whole: bytes) -> Packet:
    body = whole[7:-2]
    # A status from the broadcast id is a fast read's: the one packet that is never stuffed.
    if not (whole[4] == BROADCAST and body[0] == STATUS):
        body = unstuff(body)
    return Packet(whole[4], body[0], body[1:], len(whole))
