"""What happens to answers on their way from the servos to the host.

**The problem.** Half of what goes wrong on a bus goes wrong in the wire and the adapter: bytes are
lost, bent, late, out of order, or the host hears itself. All of it must look to a client as it does
on metal, so it is done to bytes with the times at which they arrive, in the order in which metal
does it: each status packet on the wire (:meth:`LineFaults.answer`), then the exchange as a whole in
the adapter (:meth:`LineFaults.deliver`).

The worst of them is ``latency``: an FTDI adapter hands bytes over when 62 are there or when
a timer, 16 ms unless it is set otherwise, runs out, which restarts with every transfer. Worked
example: an answer of 15 bytes that is complete 1 ms after the last transfer arrives at 16 ms; one
of 70 bytes arrives as 62 bytes when these are there, and 8 bytes 16 ms later. Source: FTDI,
AN232B-04.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from bridge.servo.packets import BROADCAST
from bridge.virtual.faults import Fault, FaultPlan

USB_BYTES = 62
"""Payload of a 64-byte USB packet of an FTDI adapter: two bytes are its own state."""
MAX_NOISE = 11

Timed = list[tuple[float, bytes]]
"""Bytes with the time at which they have arrived."""


class LineFaults:
    """Wire and adapter between the servos of a bus and the host."""

    def __init__(self, plan: FaultPlan) -> None:
        """Do what a plan says."""
        self.plan = plan
        self._kept: list[bytes] = []
        self._last = -math.inf
        self._transferred = 0.0

    # -- on the wire ------------------------------------------------------------------------------

    def answer(self, now: float, servo_id: int, data: bytes) -> bytes:
        """Return what gets through of a servo's status packet."""
        for fault in self.plan.faults:
            if data and fault.active(now - self.plan.origin, servo_id):
                data = self._spoilt(fault, data)
        return data

    def chain(self, now: float, parts: Sequence[tuple[int, bytes]]) -> bytes:
        """Return what gets through of a chained answer: (id, bytes) of each servo's part.

        It is one packet, so faults of the whole bus strike it once; those of a servo strike its
        part.
        """
        since = now - self.plan.origin
        data = b""
        for servo_id, part in parts:
            for fault in self.plan.faults:
                if part and fault.servo_id == servo_id and fault.active(since):
                    part = self._spoilt(fault, part)
            data += part
        return self.answer(now, BROADCAST, data)

    def lateness(self, now: float, *ids: int) -> float:
        """Return by how much an answer is late, s, that comes from one servo or several."""
        plan, late = self.plan, 0.0
        for fault in plan.of("delay", now):
            if fault.servo_id in (None, *ids) and plan.chance(fault):
                late += fault.value * plan.rng.random()
        return late

    def _spoilt(self, fault: Fault, data: bytes) -> bytes:
        rng = self.plan.rng
        if fault.kind not in ("drop", "corrupt", "truncate", "duplicate", "noise"):
            return data
        if not self.plan.chance(fault):
            return data
        if fault.kind == "drop":
            return b""
        if fault.kind == "duplicate":
            return data + data
        if fault.kind == "truncate":
            return data[: int(rng.integers(0, len(data)))]
        if fault.kind == "noise":
            return rng.bytes(int(rng.integers(1, MAX_NOISE + 1))) + data
        bent = bytearray(data)
        bent[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        return bytes(bent)

    # -- in the adapter ---------------------------------------------------------------------------

    def deliver(self, now: float, sent: bytes, heard: float, answers: Timed, byte: float) -> Timed:
        """Return what reaches the host of one exchange, in the order in which it does.

        Args:
            now: When the exchange began, s.
            sent: What the host sent.
            heard: When the servos had heard it, s.
            answers: What they sent, in order.
            byte: Time of a byte on the wire, s.
        """
        plan = self.plan
        since = now - plan.origin
        quiet = not any(f.kind in _DELIVERED and f.active(since) for f in plan.faults)
        if quiet and not self._kept and (not answers or answers[0][0] >= self._last):
            return answers
        kept, self._kept = self._kept, []
        arriving = [(heard, data) for data in kept]
        for due, data in answers:
            if data and plan.strikes("stale", now, _sender(data)):
                self._kept.append(data)
            elif data:
                arriving.append((due, data))
        at = 0
        while at < len(arriving) - 1:
            (due, data), (later, other) = arriving[at : at + 2]
            if plan.strikes("reorder", now, _sender(data)):
                arriving[at : at + 2] = [(due, other), (later, data)]
                at += 1  # once is enough: it must not be led to the end
            at += 1
        if any(plan.of("echo", now)):
            arriving.insert(0, (heard, sent))
        for index, (due, data) in enumerate(arriving):
            self._last = max(self._last, due)
            arriving[index] = self._last, data
        for fault in plan.of("latency", now):
            arriving = self._transfers(arriving, fault.value, byte)
        return arriving

    def _transfers(self, arriving: Timed, timer: float, byte: float) -> Timed:
        """Return the bytes as the USB transfers they are handed over in."""
        transfers: Timed = []
        waiting, deadline = bytearray(), 0.0
        for due, data in arriving:
            for index in range(len(data)):
                at = due - (len(data) - 1 - index) * byte
                if waiting and at > deadline:
                    transfers.append((deadline, bytes(waiting)))
                    self._transferred = deadline
                    waiting.clear()
                if not waiting:
                    periods = max(0, math.ceil((at - self._transferred) / timer))
                    deadline = self._transferred + periods * timer
                waiting.append(data[index])
                if len(waiting) == USB_BYTES:
                    transfers.append((max(at, self._transferred), bytes(waiting)))
                    self._transferred = max(at, self._transferred)
                    waiting.clear()
        if waiting:
            transfers.append((deadline, bytes(waiting)))
            self._transferred = deadline
        if transfers:
            self._last = max(self._last, transfers[-1][0])
        return transfers


def collide(pieces: Timed, byte: float) -> Timed:
    """Return what is heard of servos that answer at once: where they overlap, a driven 0 wins.

    Worked example: ``FF 10`` and, one byte later, ``FF 30`` are heard as ``FF 10 30``; of ``A4``
    and ``A4`` at one time nobody hears that they are two.

    Args:
        pieces: When each servo begins to answer, s, and what it sends.
        byte: Time of a byte on the wire, s.
    """
    if not pieces:
        return []
    first = min(begin for begin, _ in pieces)
    offsets = [round((begin - first) / byte) if byte else 0 for begin, _ in pieces]
    heard = bytearray(
        b"\xff" * max(at + len(data) for at, (_, data) in zip(offsets, pieces, strict=True))
    )
    for at, (_, data) in zip(offsets, pieces, strict=True):
        for index, value in enumerate(data):
            heard[at + index] &= value
    return [(first + len(heard) * byte, bytes(heard))]


_DELIVERED = {"stale", "reorder", "echo", "latency"}
"""Faults that happen in the adapter."""


def _sender(data: bytes) -> int | None:
    """Return whose packet it is; ``None`` if it is everybody's, or nobody's any more."""
    return data[4] if len(data) > 4 and data[4] != BROADCAST else None
