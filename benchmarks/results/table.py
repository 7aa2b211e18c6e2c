"""Write the figures into docs/results.md.

    python -m benchmarks.results.table [--kept benchmarks/results/kept] [--page docs/results.md]

What stands between the markers of the page is replaced. A cell without a result says so.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results.real import power_of
from benchmarks.results.rows import FILE, Plan, Row, load_plan
from benchmarks.results.run import KEPT, open_results
from benchmarks.results.spectra import BANDS, in_bands, jerk_power
from benchmarks.results.takes import FINISHING, SAMPLING
from benchmarks.results.targets import target_lines
from benchmarks.tracking.results import Record
from benchmarks.tracking.run import note
from benchmarks.tracking.table import markdown, replace_between_markers
from generator.metrics import confidence_interval
from robots.errors import DuetError

OUT = Path("out/results")
PAGE = Path("docs/results.md")
MISSING = "not run yet"


@dataclass(frozen=True, slots=True)
class Column:
    """A figure as a table shows it."""

    head: str
    """Title, with unit."""
    key: str
    """Name in the records."""
    digits: int = 3
    """After the point."""
    factor: float = 1.0
    """To the unit of the title."""


PAPER = (
    *(Column(f"R top {k}", f"r_precision_top{k}") for k in (1, 2, 3)),
    Column("FID", "fid"),
    Column("MM Dist", "mm_dist"),
    Column("Diversity", "diversity"),
    Column("MModality", "multimodality"),
)
ASKED = (
    Column("right interaction, %", "class", 1, 100),
    Column("right leader, %", "role", 1, 100),
    Column("hands meet, %", "met", 1, 100),
)
BODIES = (
    Column("bones, %", "bones", 2, 100),
    Column("skate, own labels, cm/s", "skate_labelled", 2, 100),
    Column("skate, low toes, cm/s", "skate_low", 2, 100),
    Column("jerk, m/s³", "jerk", 1),
    Column("speed, m/s", "speed", 3),
    Column("below floor, mm", "sunk", 1, 1000),
    Column("in each other, mm", "overlap", 1, 1000),
    Column("frames > 2 cm in each other, %", "overlapping", 1, 100),
)
PERFORMED = (
    Column("passes the gate, %", "passed", 0, 100),
    Column("nobody falls, %", "upright", 0, 100),
    Column("off what was drawn, mm", "off", 0),
    Column("in each other, p95, mm", "performed_overlap", 1),
    Column("below floor, p95, mm", "performed_floor", 1),
    Column("soles slide, cm/s", "performed_slide", 1, 100),
)
COST = (Column("drawing", SAMPLING, 2), Column("finishing", FINISHING, 2))
SPLITS = {
    "test": "Other performances of the same kind",
    "sentences": "Wordings that training does not know",
    "combinations": "Interactions in a manner that training does not know of them",
}


def main() -> int:
    """Write all tables and return the exit code."""
    parser = argparse.ArgumentParser(description="Write the tables of docs/results.md")
    parser.add_argument("--kept", type=Path, default=KEPT, help="folder of results")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of spectra of real clips")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--plan", type=Path, default=FILE)
    args = parser.parse_args()
    try:
        records = latest(open_results(args.kept).read().values())
        for name, text in pages(load_plan(args.plan), records, power_of(args.out)).items():
            replace_between_markers(args.page, name, text)
    except DuetError as error:
        note(str(error))
        return error.exit_code
    return 0


def latest(records: Iterable[Record]) -> list[Record]:
    """Return the records that belong to the last one of their row and split.

    Repetitions of another model, another evaluator or other sizes are not mixed.
    """
    kept = list(records)
    last = {(r["row"], r["split"]): r["digest"] for r in kept}
    return [r for r in kept if last[r["row"], r["split"]] == r["digest"]]


def pages(
    plan: Plan, records: Sequence[Record], real: Mapping[str, Any] | None = None
) -> dict[str, str]:
    """Return the text for every marker of the page.

    Args:
        plan: Rows and their order.
        records: As :func:`latest` gives them.
        real: Mean spectra of real clips by what they are for, if there are any.
    """
    rows = {
        name: [r for r in plan.row if name in r.tables]
        for name in ("main", "table3", "table4", "data")
    }
    parts = {
        f"{kind}-{split}": _table(rows["main"], split, columns, records)
        for split in SPLITS
        for kind, columns in (("paper", PAPER), ("asked", ASKED))
    }
    parts["bodies"] = _table(rows["main"], "test", BODIES, records)
    parts["cost"] = _table([r for r in rows["main"] if r.kind != "data"], "test", COST, records)
    for name in ("table3", "table4", "data"):
        parts[name] = _table(rows[name], "test", (*PAPER, *ASKED), records)
    parts["data-bodies"] = _table(rows["data"], "test", BODIES, records)
    simulated = [row for row in plan.row if row.performed]
    parts["performed"] = _table(simulated, "test", PERFORMED, records)
    shown = dict.fromkeys((*rows["main"], *rows["data"]))
    parts["spectra"] = spectra_table([*shown], records, real or {})
    parts["hardest"] = hardest(rows["main"], records)
    known = {row.name for row in plan.row}
    parts["made"] = provenance([r for r in records if r["row"] in known])
    held = [row for row in rows["main"] if row.drawn and row.splits[1:]]
    parts["targets"] = markdown(target_lines(held, records, MISSING))
    return parts


def _table(
    rows: Sequence[Row], split: str, columns: Sequence[Column], records: Sequence[Record]
) -> str:
    lines = [["", *(column.head for column in columns)]]
    for row in rows:
        if split in row.splits:
            found = [r for r in records if (r["row"], r["split"]) == (row.name, split)]
            lines.append([row.name, *(cell(found, column) for column in columns)])
    return markdown(lines)


def cell(records: Sequence[Record], column: Column) -> str:
    """Return mean and half width of the 95 % interval over repetitions, or that there are none."""
    if not records:
        return MISSING
    values = [v for r in records if (v := r["figures"].get(column.key)) is not None]
    if not values:
        return ""
    mean, interval = confidence_interval(np.array(values) * column.factor)
    text = f"{mean:.{column.digits}f}"
    return f"{text} ± {interval:.{column.digits}f}" if len(values) > 1 else text


def spectra_table(rows: Sequence[Row], records: Sequence[Record], real: Mapping[str, Any]) -> str:
    """Return velocity and jerk by frequency: a line per row, first of all real clips."""
    heads = [f"{low:g}–{high:g} Hz" for low, high in BANDS]
    lines = [["", *(f"velocity {h}" for h in heads), *(f"jerk {h}" for h in heads)]]
    named: list[tuple[str, Any]] = [
        (f"real clips, {use}", real.get(use)) for use in ("held out", "learnt from")
    ]
    for row in rows:
        found = [r for r in records if (r["row"], r["split"]) == (row.name, "test")]
        named.append((row.name, _mean_spectrum(found)))
    for name, power in named:
        if power is None:
            lines.append([name, *[MISSING] * 2 * len(BANDS)])
            continue
        velocity, jerk = in_bands(power), in_bands(jerk_power(power))
        lines.append(
            [
                name,
                *("" if np.isnan(v) else f"{v:.3f}" for v in velocity),
                *("" if np.isnan(v) else f"{v:.1f}" for v in jerk),
            ]
        )
    return markdown(lines)


def _mean_spectrum(records: Sequence[Record]) -> Any:
    if not records:
        return None
    return np.array([r["spectrum"] for r in records], float).mean(axis=0)


def hardest(rows: Sequence[Row], records: Sequence[Record], count: int = 8) -> str:
    """Return, for every model, the interactions that it does worst, with their shares."""
    lines = [["", "right interaction", "right leader", "hands meet"]]
    for row in rows:
        found = [r for r in records if (r["row"], r["split"]) == (row.name, "test")]
        if row.drawn:
            cells = [_worst(found, figure, count) for figure in ("class", "role", "met")]
            lines.append([row.name, *cells])
    return markdown(lines)


def _worst(records: Sequence[Record], figure: str, count: int) -> str:
    if not records:
        return MISSING
    values: dict[str, list[float]] = {}
    for record in records:
        for name, parts in record["by_interaction"].items():
            if parts[figure] is not None:
                values.setdefault(name, []).append(parts[figure])
    means = sorted((float(np.mean(v)), name) for name, v in values.items())
    return ", ".join(f"{name} {mean:.0%}" for mean, name in means[:count] if mean < 1) or "none"


def provenance(records: Sequence[Record]) -> str:
    """Return which models were measured, on how many clips, how often."""
    head = "row, split, clips, repetitions, weights, training steps, with a leader"
    lines = [[str(name) for name in head.split(", ")]]
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for record in records:
        groups.setdefault((record["row"], record["split"]), []).append(record)
    for (row, split), found in groups.items():
        one = found[-1]
        steps = one.get("trained_steps")
        lines.append(
            [
                row,
                split,
                str(one["clips"]),
                str(len(found)),
                str(one.get("weights", "")),
                "" if steps is None else str(steps),
                str(one["leaders"]),
            ]
        )
    return markdown(lines) if groups else MISSING


if __name__ == "__main__":
    sys.exit(main())
