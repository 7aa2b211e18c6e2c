"""Packets of a stream: made once, filled in and taken apart as arrays.

**The problem.** A player sends the same Sync Write hundreds of times a second, with other goals in
it, and reads the same registers of the same servos each time. Built and taken apart servo by servo,
that takes a third of a millisecond of Python per cycle of twenty servos. But only the data change:
their places in the packet, the request and the shape of the answer are known beforehand.

A Sync Write of 4 bytes to two servos; only the bytes in brackets change from one to the next::

    FF FF FD 00 FE 11 00 83  74 00 04 00  01 [g g g g]  02 [g g g g]  [crc]

If the data happen to contain ``FF FF FD``, the packet grows by a stuffed byte; then it is built
from the start. An answer that is not whole, or not in the order asked, is taken apart packet by
packet (:class:`~bridge.servo.packets.Parser`), and what is intact in it is kept.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bridge.servo.packets import (
    ALERT,
    BROADCAST,
    FAST_OVERHEAD,
    FAST_SYNC_READ,
    HEADER,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    Packet,
    crc16,
    crc16_rows,
    fast_answers,
    fast_head,
    instruction,
    status,
)
from bridge.servo.transport import SyncAnswer

STATUS_OVERHEAD = 11
"""Bytes of a status packet beside its data."""
_MUST_STUFF = HEADER[:3]
_BODY = 7
"""Where INST stands in a packet."""


def _span(address: int, length: int) -> bytes:
    return address.to_bytes(2, "little") + length.to_bytes(2, "little")


class SyncWritePacket:
    """A Sync Write to the same registers of the same servos."""

    def __init__(self, address: int, length: int, ids: Sequence[int]) -> None:
        """Build all of it but the data.

        Args:
            address: First register byte.
            length: Bytes for each servo.
            ids: The servos, in the order of the data.

        Raises:
            ValueError: An id is not one, or the packet would be longer than 1024 bytes.
        """
        self._span = _span(address, length)
        rows = np.zeros((len(ids), 1 + length), np.uint8)
        rows[:, 0] = ids
        self._packet = bytearray(self._built(rows))
        self._rows = np.frombuffer(self._packet, np.uint8)[_BODY + 5 : -2].reshape(rows.shape)
        self._data = self._rows[:, 1:]
        self._summed = memoryview(self._packet)[:-2]

    def filled(self, data: NDArray[np.uint8]) -> bytes:
        """Return the packet with the data ``[N, length]``."""
        self._data[:] = data
        packet = self._packet
        if packet.find(_MUST_STUFF, _BODY, -2) >= 0:
            return self._built(self._rows)
        packet[-2:] = crc16(self._summed).to_bytes(2, "little")
        return bytes(packet)

    def _built(self, rows: NDArray[np.uint8]) -> bytes:
        return instruction(BROADCAST, SYNC_WRITE, self._span + rows.tobytes())


class SyncReadPacket:
    """A Sync Read or Fast Sync Read of the same registers of the same servos, and its answer."""

    def __init__(self, address: int, length: int, ids: Sequence[int], *, fast: bool) -> None:
        """Build the request.

        Args:
            address: First register byte.
            length: Bytes of each servo.
            ids: The servos, in the order of the answers.
            fast: Whether the answer is one chained packet.

        Raises:
            ValueError: An id is not one, or the packet would be longer than 1024 bytes.
        """
        self.ids = tuple(ids)
        """The servos, in the order asked."""
        self.length = length
        """Bytes of each servo."""
        self.fast = fast
        """Whether the answer is one chained packet."""
        code = FAST_SYNC_READ if fast else SYNC_READ
        self.request = instruction(BROADCAST, code, _span(address, length) + bytes(ids))
        """The bytes to send."""
        self.head = fast_head(length, len(ids)) if fast else b""
        """How a chained answer begins."""
        part = length + (FAST_OVERHEAD if fast else STATUS_OVERHEAD)
        self.size = len(self.head) + len(ids) * part
        """Bytes of the whole answer."""
        self._row_of = {servo_id: row for row, servo_id in enumerate(ids)}
        self._id_column = np.array(ids, np.uint8)
        blank = [status(servo_id, 0, bytes(length))[: _BODY + 1] for servo_id in ids]
        self._heads = np.frombuffer(b"".join(blank), np.uint8).reshape(len(ids), -1)

    def whole(self, received: bytes | bytearray) -> SyncAnswer | None:
        """Return an answer that is exactly what is expected, or ``None`` if it is not."""
        if len(received) != self.size:
            return None
        return self._whole_chain(received) if self.fast else self._whole_packets(received)

    def _whole_chain(self, received: bytes | bytearray) -> SyncAnswer | None:
        if not received.startswith(self.head):
            return None
        answer = np.frombuffer(received, np.uint8)
        if crc16(memoryview(received)[:-2]) != received[-2] | received[-1] << 8:
            return None
        rows = answer[len(self.head) :].reshape(len(self.ids), -1)
        if (rows[:, 1] != self._id_column).any():
            return None
        return self._answer(rows[:, 0], rows[:, 2:-2])

    def _whole_packets(self, received: bytes | bytearray) -> SyncAnswer | None:
        rows = np.frombuffer(received, np.uint8).reshape(len(self.ids), -1)
        if (rows[:, : _BODY + 1] != self._heads).any():
            return None
        if (crc16_rows(rows[:, :-2]) != rows[:, -2] + 256 * rows[:, -1].astype(np.uint16)).any():
            return None
        if _MUST_STUFF in rows[:, _BODY + 1 : -2].tobytes():
            return None  # a stuffed answer of one servo hides a short one of another
        return self._answer(rows[:, _BODY + 1], rows[:, _BODY + 2 : -2])

    def _answer(self, error: NDArray[np.uint8], data: NDArray[np.uint8]) -> SyncAnswer:
        """Return the answer of servos that all sent a part; a refusal is no data."""
        seen = (error & ~np.uint8(ALERT)) == 0
        return SyncAnswer(data, seen, seen & (error != 0))

    def parts_of_chain(self, received: bytes | bytearray) -> SyncAnswer:
        """Return what is intact in a chained answer, from its head on, that may be cut off."""
        parts = fast_answers(bytes(received), self.length, len(self.ids))
        return self.collected({servo_id: (error, data) for error, servo_id, data in parts})

    def intact(self, packet: Packet) -> bool:
        """Return whether a packet is an answer to this request."""
        params = packet.params
        return (
            packet.code == STATUS
            and packet.servo_id in self._row_of
            and len(params) == self.length + 1
            and not params[0] & ~ALERT
        )

    def collected(self, parts: dict[int, tuple[int, bytes]]) -> SyncAnswer:
        """Return (error, data) by id as one answer; refusals and strangers are left out."""
        count = len(self.ids)
        data = np.zeros((count, self.length), np.uint8)
        seen, alert = np.zeros(count, bool), np.zeros(count, bool)
        for servo_id, (error, part) in parts.items():
            row = self._row_of.get(servo_id)
            if row is None or error & ~ALERT:
                continue
            data[row] = np.frombuffer(part, np.uint8)
            seen[row], alert[row] = True, bool(error & ALERT)
        return SyncAnswer(data, seen, alert)
