"""What goes wrong on a virtual bus, and when: seeded timelines of faults.

:data:`KINDS` lists what there is. Here is the timeline alone; :mod:`bridge.virtual.line_faults`
does to bytes what it says, :mod:`bridge.virtual.servo_faults` to servos.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bridge.servo.registers import BAUD_RATES
from robots.errors import SpecError, nearest

# fmt: off
Kind = Literal[
    "drop", "corrupt", "truncate", "duplicate", "noise", "delay", "stale", "reorder", "deaf",
    "echo", "latency", "unplug", "silence", "clash", "baud", "firmware", "hardware", "brownout",
    "heat", "load", "stuck",
]
# fmt: on
Scope = Literal["packet", "adapter", "servo"]


@dataclass(frozen=True, slots=True)
class KindOfFault:
    """What a kind of fault does, and what its value means."""

    scope: Scope
    """``packet``: strikes single packets by chance; ``adapter``: holds for all bytes while it
    lasts; ``servo``: happens to servos, at its start and (undone) at its end."""
    text: str
    """What happens."""
    value: float = 0.0
    """Default of :attr:`Fault.value`."""
    low: float = 0.0
    """Least value."""
    high: float = 0.0
    """Largest value; 0 if the kind has none."""
    unit: str = ""
    """Of the value."""


KINDS: Mapping[str, KindOfFault] = {
    "drop": KindOfFault("packet", "an answer gets lost"),
    "corrupt": KindOfFault("packet", "one bit of an answer is turned over"),
    "truncate": KindOfFault("packet", "an answer breaks off"),
    "duplicate": KindOfFault("packet", "an answer comes twice"),
    "noise": KindOfFault("packet", "up to 11 random bytes come before an answer"),
    "delay": KindOfFault("packet", "an answer is late by up to", 0.01, 0.0, 10.0, "s"),
    "stale": KindOfFault("packet", "an answer comes in the next exchange, before its answers"),
    "reorder": KindOfFault("packet", "an answer comes after the one behind it"),
    "deaf": KindOfFault("packet", "an instruction does not reach the servos"),
    "echo": KindOfFault("adapter", "what the host sends comes back to it"),
    "latency": KindOfFault(
        "adapter", "bytes wait until there are 62, or for", 0.016, 0.0002, 1.0, "s"
    ),
    "unplug": KindOfFault("servo", "the adapter is away; with a servo, that has no power and line"),
    "silence": KindOfFault("servo", "a servo neither hears nor answers; it keeps its power"),
    "clash": KindOfFault("servo", "another servo of that id, so far away", 0.5, -9.0, 9.0, "rad"),
    "baud": KindOfFault("servo", "it restarts at another rate", 57600, 9600, 4.5e6, "bit/s"),
    "firmware": KindOfFault("servo", "it has another firmware version", 30, 1, 255, ""),
    "hardware": KindOfFault("servo", "a bit of Hardware Error Status is set, once", 5, 0, 7, ""),
    "brownout": KindOfFault("servo", "the supply falls to", 5.0, 0.0, 60.0, "V"),
    "heat": KindOfFault("servo", "the air around it is so warm", 120.0, -50.0, 5000.0, "degC"),
    "load": KindOfFault("servo", "a torque pulls, shares of stall torque", 0.6, -3.0, 3.0, ""),
    "stuck": KindOfFault("servo", "the horn does not turn, whatever pulls"),
}
"""All kinds of faults, by name."""
MAX_TOML_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that goes wrong; what it is, is in :data:`KINDS`.

    Raises:
        SpecError: A field is out of its range.
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
    value: float = math.nan
    """How much, where the kind has such a thing; the kind's own default if not given."""

    def __post_init__(self) -> None:
        """Validate."""
        kind = KINDS.get(self.kind)
        if kind is None:
            raise SpecError(
                f"no fault '{self.kind}'",
                allowed=", ".join(KINDS),
                hint=nearest(str(self.kind), KINDS),
            )
        where = f"fault {self.kind}"
        if math.isnan(self.value):
            object.__setattr__(self, "value", kind.value)
        if not kind.low <= self.value <= kind.high:
            allowed = f"{kind.low:g} to {kind.high:g} {kind.unit}" if kind.high else "no value"
            raise SpecError(f"value {self.value:g}", where=where, allowed=allowed.strip())
        if self.kind == "baud" and self.value not in BAUD_RATES:
            allowed = ", ".join(map(str, BAUD_RATES))
            raise SpecError(f"value {self.value:g}", where=where, allowed=allowed)
        if not 0.0 <= self.start <= self.end:
            raise SpecError(f"from {self.start} to {self.end} s", where=where)
        if not 0.0 <= self.probability <= 1.0:
            raise SpecError(f"probability {self.probability}", where=where, allowed="0 to 1")

    def active(self, now: float, servo_id: int | None = None) -> bool:
        """Whether it concerns this servo (``None``: any) at ``now`` s."""
        mine = self.servo_id is None or servo_id is None or servo_id == self.servo_id
        return mine and self.start <= now < self.end


class FaultPlan:
    """A timeline of faults with its own random numbers: same seed and traffic, same bytes."""

    def __init__(self, faults: Sequence[Fault] = (), *, seed: int = 0) -> None:
        """Take the timeline."""
        self.faults = list(faults)
        """What goes wrong; may be added to."""
        self.origin = 0.0
        """Time of the bus's clock from which the faults' times count, s."""
        self.rng = np.random.default_rng(seed)
        """What chance decides by."""

    @classmethod
    def load(cls, path: str | Path) -> FaultPlan:
        """Read a timeline from TOML: ``seed``, and ``[[fault]]`` tables with :class:`Fault`'s keys.

        Raises:
            SpecError: The file cannot be read, or something in it is unknown or out of range.
        """
        data = _parse(Path(path))
        _require_keys(data, ("seed", "fault"), str(path))
        seed, tables = data.get("seed", 0), data.get("fault", [])
        if not isinstance(seed, int) or seed < 0 or not isinstance(tables, list):
            raise SpecError("seed must be a whole number, fault a list", where=str(path))
        return cls(
            [_fault(table, f"{path}: fault {n}") for n, table in enumerate(tables)], seed=seed
        )

    def of(self, kind: Kind, now: float, servo_id: int | None = None) -> Iterator[Fault]:
        """Yield the faults of a kind that are active for a servo (``None``: any), in order."""
        now -= self.origin
        for fault in self.faults:
            if fault.kind == kind and fault.active(now, servo_id):
                yield fault

    def strikes(self, kind: Kind, now: float, servo_id: int | None = None) -> bool:
        """Whether a fault of this kind strikes the packet that is on its way now."""
        return any(self.chance(fault) for fault in self.of(kind, now, servo_id))

    def chance(self, fault: Fault) -> bool:
        """Whether chance lets a fault strike this time."""
        return fault.probability >= 1 or self.rng.random() < fault.probability

    def unplugged(self, since: float, now: float) -> bool:
        """Whether the adapter was away at any moment from ``since`` to ``now`` s."""
        since, now = since - self.origin, now - self.origin
        return any(
            fault.kind == "unplug"
            and fault.servo_id is None
            and fault.start <= now
            and fault.end > since
            for fault in self.faults
        )

    def next_unplug(self, since: float) -> float:
        """Return when the adapter is away first from ``since`` s on; infinity if it stays."""
        starts = [
            max(since, fault.start + self.origin)
            for fault in self.faults
            if fault.kind == "unplug" and fault.servo_id is None and fault.end + self.origin > since
        ]
        return min(starts, default=math.inf)


def _parse(path: Path) -> dict[str, Any]:
    try:
        data = path.read_bytes()
        if len(data) > MAX_TOML_BYTES:
            raise SpecError(f"{len(data)} bytes", where=str(path), allowed="at most 1 MiB")
        return tomllib.loads(data.decode())
    except OSError as error:
        reason = error.strerror or str(error)
        raise SpecError(f"cannot be read: {reason}", where=str(path)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise SpecError(f"is not valid TOML: {error}", where=str(path)) from error


def _require_keys(table: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in table:
        if key not in known:
            raise SpecError(
                f"unknown key '{key}'",
                where=where,
                allowed=", ".join(known),
                hint=nearest(key, known),
            )


def _fault(table: object, where: str) -> Fault:
    if not isinstance(table, dict) or not isinstance(table.get("kind"), str):
        raise SpecError("a fault is a table with a 'kind'", where=where)
    _require_keys(table, [field.name for field in dataclasses.fields(Fault)], where)
    for key, value in table.items():
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if key != "kind" and not number:
            raise SpecError(f"{key} is {value!r}, not a number", where=where)
    try:
        return Fault(**table)
    except SpecError as error:
        raise SpecError(
            error.what, where=f"{where}: {error.where}".rstrip(": "), allowed=error.allowed
        ) from error
