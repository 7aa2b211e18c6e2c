"""Faults that a virtual bus plays, by the clock and by seeded chance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Kind = Literal[
    "drop", "corrupt", "truncate", "duplicate", "noise", "deaf", "silence", "hardware", "unplug"
]


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that goes wrong.

    ``drop``, ``corrupt`` (one bit), ``truncate`` and ``duplicate`` act on status packets, ``noise``
    puts random bytes before them, ``deaf`` loses instruction packets on their way to the servos;
    each with :attr:`probability`. ``silence`` is a servo that neither hears nor answers;
    ``hardware`` sets :attr:`bit` of its Hardware Error Status once; ``unplug`` takes the adapter
    away.
    """

    kind: Kind
    """What happens."""
    start: float = 0.0
    """First moment, s of the bus's clock."""
    end: float = math.inf
    """Moment at which it is over, s."""
    probability: float = 1.0
    """Chance per packet."""
    servo_id: int | None = None
    """Which servo; ``None`` for every one."""
    bit: int = 5
    """Bit of Hardware Error Status (``hardware`` only); 5 is overload."""

    def active(self, now: float, servo_id: int | None = None) -> bool:
        """Whether it concerns this servo now."""
        mine = self.servo_id is None or servo_id is None or servo_id == self.servo_id
        return mine and self.start <= now < self.end


class FaultPlan:
    """A timeline of faults with its own random numbers: same seed and traffic, same faults."""

    def __init__(self, faults: Sequence[Fault] = (), *, seed: int = 0) -> None:
        """Take the timeline."""
        self.faults = list(faults)
        self._rng = np.random.default_rng(seed)
        self._done: set[int] = set()

    def unplugged(self, now: float) -> bool:
        """Whether the adapter is away."""
        return any(fault.kind == "unplug" and fault.active(now) for fault in self.faults)

    def silent(self, now: float, servo_id: int) -> bool:
        """Whether this servo neither hears nor answers."""
        return any(f.kind == "silence" and f.active(now, servo_id) for f in self.faults)

    def deaf(self, now: float) -> bool:
        """Whether the instruction packet that arrives now is lost."""
        return any(f.kind == "deaf" and f.active(now) and self._strikes(f) for f in self.faults)

    def hardware(self, now: float) -> list[tuple[int | None, int]]:
        """Return the (servo id, bit) of hardware errors that have come due; each comes once."""
        due = []
        for index, fault in enumerate(self.faults):
            if fault.kind == "hardware" and index not in self._done and fault.active(now):
                self._done.add(index)
                due.append((fault.servo_id, fault.bit))
        return due

    def spoil(self, now: float, servo_id: int, data: bytes) -> bytes:
        """Return what arrives of a status packet; empty if nothing does."""
        for fault in self.faults:
            if not fault.active(now, servo_id) or not data or not self._strikes(fault):
                continue
            if fault.kind == "drop":
                data = b""
            elif fault.kind == "duplicate":
                data += data
            elif fault.kind == "truncate":
                data = data[: int(self._rng.integers(0, len(data)))]
            elif fault.kind == "noise":
                data = self._rng.bytes(int(self._rng.integers(1, 12))) + data
            elif fault.kind == "corrupt":
                spoilt = bytearray(data)
                spoilt[int(self._rng.integers(len(data)))] ^= 1 << int(self._rng.integers(8))
                data = bytes(spoilt)
        return data

    def _strikes(self, fault: Fault) -> bool:
        return fault.probability >= 1 or self._rng.random() < fault.probability
