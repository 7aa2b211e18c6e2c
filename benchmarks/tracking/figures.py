"""What is read off the results of a set, and what it should be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from benchmarks.tracking.results import Record

RECALL = 0.8
"""Contact recall that a clip should reach."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """What a figure should reach."""

    value: float
    sense: Literal["most", "least"] = "most"

    def kept_by(self, value: float) -> bool:
        """Whether a value is good enough."""
        return value <= self.value if self.sense == "most" else value >= self.value

    def __str__(self) -> str:
        """Return it for a table."""
        return f"{'≤' if self.sense == 'most' else '≥'} {self.value:g}"


@dataclass(frozen=True, slots=True)
class Cell:
    """A figure as text, and the number that the bar judges."""

    text: str
    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One figure of a set of clips."""

    name: str
    unit: str = ""
    cell: Callable[[Sequence[Record]], Cell | None]
    """From all records of one set and controller; ``None`` if none of them has the figure."""
    bars: Mapping[str, Bar] = field(default_factory=dict)
    """By set; ``""`` is for every set that is not named."""

    def bar(self, of: str) -> Bar | None:
        """Return the bar for a set."""
        return self.bars.get(of, self.bars.get(""))


def people(key: str) -> Callable[[Record], float | None]:
    """Return a reader of the mean over both people."""
    return lambda r: float(np.mean(list(r[key].values()))) if key in r else None


def worse(key: str) -> Callable[[Record], float | None]:
    """Return a reader of the worse of two people."""
    return lambda r: max(r[key].values()) if key in r else None


def part(key: str, name: str) -> Callable[[Record], float | None]:
    """Return a reader of one entry of an object."""
    return lambda r: r[key][name] if key in r else None


def plain_value(key: str) -> Callable[[Record], float | None]:
    """Return a reader of a number."""
    return lambda r: r.get(key)


def wall(record: Record) -> float | None:
    """Return wall-seconds per duet-second of the whole batch: clips are done side by side."""
    value = record.get("wall_seconds_per_second")
    return None if value is None else value / record["jobs"]


def spread(
    read: Callable[[Record], float | None], digits: int = 0
) -> Callable[[Sequence[Record]], Cell | None]:
    """Return a cell of median and, in brackets, the 90th percentile over clips."""

    def cell(records: Sequence[Record]) -> Cell | None:
        values = _values(read, records)
        if not len(values):
            return None
        median, high = np.percentile(values, [50, 90])
        return Cell(f"{median:.{digits}f} ({high:.{digits}f})", float(median))

    return cell


def most(
    read: Callable[[Record], float | None], digits: int = 0
) -> Callable[[Sequence[Record]], Cell | None]:
    """Return a cell of the largest value over clips."""

    def cell(records: Sequence[Record]) -> Cell | None:
        values = _values(read, records)
        return Cell(f"{values.max():.{digits}f}", float(values.max())) if len(values) else None

    return cell


def total(read: Callable[[Record], float | None]) -> Callable[[Sequence[Record]], Cell | None]:
    """Return a cell of the sum over clips."""

    def cell(records: Sequence[Record]) -> Cell | None:
        values = _values(read, records)
        return Cell(f"{values.sum():.0f}", float(values.sum())) if len(values) else None

    return cell


def _values(
    read: Callable[[Record], float | None], records: Sequence[Record]
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([v for v in map(read, records) if v is not None], dtype=float)


def _clips(records: Sequence[Record]) -> Cell:
    return Cell(str(len(records)), len(records))


def _success(records: Sequence[Record]) -> Cell:
    share = 100 * float(np.mean([r["success"] for r in records]))
    return Cell(f"{share:.1f}", share)


def _falls(records: Sequence[Record]) -> Cell:
    count = sum(any(r["fell"].values()) for r in records if "fell" in r)
    return Cell(str(count), count)


def _recall(records: Sequence[Record]) -> Cell | None:
    values = _values(plain_value("contact_recall"), records)
    if not len(values):
        return None
    share = 100 * float(np.mean(values >= RECALL))
    return Cell(f"{values.mean():.2f}; {share:.0f} %", float(values.mean()))


ACCELERATION = "accel_error_mm_per_frame2"
ACCELERATION_CLEAN = "accel_error_unspoilt_mm_per_frame2"

CONTACT_RECALL = f"contact recall; clips ≥ {RECALL}"

ROWS = (
    Row(name="clips", cell=_clips),
    Row(
        name="success",
        unit="%",
        cell=_success,
        bars={"": Bar(value=98, sense="least"), "dirty": Bar(value=92, sense="least")},
    ),
    Row(name="falls", cell=_falls),
    Row(
        name="MPJPE, global",
        unit="mm",
        cell=spread(people("mpjpe_global_mm")),
        bars={"": Bar(value=30), "dirty": Bar(value=50)},
    ),
    Row(
        name="MPJPE, root-relative",
        unit="mm",
        cell=spread(people("mpjpe_root_mm")),
        bars={"": Bar(value=20)},
    ),
    Row(
        name="acceleration error",
        unit="mm/frame²",
        cell=spread(people(ACCELERATION), 1),
        bars={"": Bar(value=4)},
    ),
    Row(
        name="the same, from the unspoilt motion",
        unit="mm/frame²",
        cell=spread(people(ACCELERATION_CLEAN), 1),
        bars={"": Bar(value=4)},
    ),
    Row(
        name=CONTACT_RECALL,
        cell=_recall,
        bars={"": Bar(value=RECALL, sense="least")},
    ),
    Row(
        name="in each other, asked for, p95",
        unit="mm",
        cell=spread(part("penetration_p95_mm", "reference")),
    ),
    Row(
        name="in each other, simulated, p95",
        unit="mm",
        cell=spread(part("penetration_p95_mm", "simulated")),
        bars={"": Bar(value=10)},
    ),
    Row(
        name="in the floor, p95",
        unit="mm",
        cell=spread(worse("floor_penetration_p95_mm")),
        bars={"": Bar(value=10)},
    ),
    Row(name="recoveries", cell=total(plain_value("recoveries"))),
    Row(
        name="helping hand, most",
        unit="body weights",
        cell=most(plain_value("assist_max_bodyweight"), 2),
        bars={"": Bar(value=0)},
    ),
    Row(
        name="CPU",
        unit="s per s",
        cell=spread(plain_value("cpu_seconds_per_second"), 2),
    ),
    Row(
        name="wall",
        unit="s per s",
        cell=spread(wall, 2),
        bars={"": Bar(value=3), "dirty": Bar(value=8)},
    ),
)
"""The figures of docs/tracking.md, in order."""
