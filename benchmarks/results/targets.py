"""What the model that ships is held to, beside what it reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.results.rows import Row
from benchmarks.tracking.results import Record

REAL = "ground truth"
"""Row that shares are taken of."""


@dataclass(frozen=True, slots=True)
class Target:
    """A bound on a figure."""

    name: str
    """As the table says it."""
    split: str
    """On what it is measured."""
    key: str
    """Of the figure."""
    low: float = -np.inf
    """Smallest value that keeps it."""
    high: float = np.inf
    """Largest."""
    share: bool = False
    """Whether the figure is divided by that of :data:`REAL` on the same split."""
    unit: str = ""
    """After the numbers."""
    factor: float = 1.0
    """To that unit."""

    @property
    def bound(self) -> str:
        """The bound in words."""
        low, high = f"{self.low:.3g}", f"{self.high:.3g}"
        if np.isinf(self.high):
            return f"at least {low}{self.unit}"
        return f"at most {high}{self.unit}" if np.isinf(self.low) else f"{low} to {high}{self.unit}"


TARGETS = (
    Target("right interaction, of ground truth's", "sentences", "class", low=0.85, share=True),
    Target("R top 3, of ground truth's", "sentences", "r_precision_top3", low=0.85, share=True),
    Target("hands meet", "test", "met", low=80, unit=" %", factor=100),
    Target("bones", "test", "bones", high=0.5, unit=" %", factor=100),
    Target("skate, own labels", "test", "skate_labelled", high=2, unit=" cm/s", factor=100),
    Target("jerk, of ground truth's", "test", "jerk", low=1 / 1.5, high=1.5, share=True),
    Target("MModality, of ground truth's", "test", "multimodality", low=0.7, high=1.3, share=True),
    Target("CPU seconds to draw a clip", "test", "sampling_s", high=1.5, unit=" s"),
)


def target_lines(rows: Sequence[Row], records: Sequence[Record], missing: str) -> list[list[str]]:
    """Return a line per target with a cell per row, and the names of the rows above them.

    Args:
        rows: Models that are held to the targets.
        records: Results.
        missing: What to say where there is none.
    """
    lines = [["", "target", *(row.name for row in rows)]]
    for target in TARGETS:
        real = _mean(records, REAL, target)
        cells = [_cell(target, _mean(records, row.name, target), real, missing) for row in rows]
        lines.append([f"{target.name} ({target.split})", target.bound, *cells])
    return lines


def _mean(records: Sequence[Record], row: str, target: Target) -> float | None:
    values = [
        value
        for r in records
        if (r["row"], r["split"]) == (row, target.split)
        and (value := r["figures"].get(target.key)) is not None
    ]
    return float(np.mean(values)) if values else None


def _cell(target: Target, value: float | None, real: float | None, missing: str) -> str:
    if value is None or (target.share and not real):
        return missing
    value = value / real if target.share and real else value * target.factor
    kept = target.low <= value <= target.high
    return f"{value:.2f}{target.unit} {'ok' if kept else '**short**'}"
