"""Write the figures of a run into docs/tracking.md.

    python -m benchmarks.tracking.table [--out out/bench-track] [--page docs/tracking.md]

What stands between the markers of the page is replaced; without results nothing is touched.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.tracking.ablation import CONTROLLER, VARIANTS, ablation_clips
from benchmarks.tracking.clips import SETS
from benchmarks.tracking.figures import CONTACT_RECALL, ROWS
from benchmarks.tracking.results import Record, Results
from benchmarks.tracking.run import note
from robots.errors import DuetError, MotionFileError
from robots.files import whole_file

OUT = Path("out/bench-track")
PAGE = Path("docs/tracking.md")
ORDER = ("ilqr", "mppi", "assist")
ABLATION_ROWS = (
    *("success", "MPJPE, global", "acceleration error", CONTACT_RECALL),
    *("in each other, simulated, p95", "recoveries", "CPU"),
)


def main() -> int:
    """Write both tables and return the exit code."""
    parser = argparse.ArgumentParser(description="Write the tables of docs/tracking.md")
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--page", type=Path, default=PAGE)
    args = parser.parse_args()
    try:
        for name, make in (("results", comparison), ("ablation", ablation)):
            records = latest(Results(args.out / f"{name}.jsonl").read().values())
            if records:
                replace_between_markers(args.page, name, make(records))
            else:
                note(f"{args.out / name}.jsonl: no results, the table stays as it is")
    except DuetError as error:
        note(str(error))
        return error.exit_code
    return 0


def latest(records: Iterable[Record]) -> list[Record]:
    """Return the last record of each clip, controller and variant, whatever the settings then."""
    last = {(r["set"], r["clip"], r["controller"], r["variant"]): r for r in records}
    return list(last.values())


def comparison(records: Sequence[Record]) -> str:
    """Return a table per set and tier with a column per controller, and who failed and why."""
    parts = []
    for name in SETS:
        for tier in ("walking", "running"):
            found = [r for r in records if (r["set"], r["tier"]) == (name, tier)]
            if found:
                title = name if tier == "walking" else f"{name}, running (> 2 m/s)"
                parts.append(f"### {title}\n\n{_by_controller(name, found)}")
                if tier == "running":
                    names = sorted({r["clip"] for r in found})
                    parts.append(f"Clips: {', '.join(names)}.")
    parts.append(f"### Failures\n\n{failures(records)}")
    parts.append(_provenance(records))
    return "\n\n".join(parts)


def _by_controller(of: str, records: Sequence[Record]) -> str:
    controllers = sorted(
        {r["controller"] for r in records}, key=lambda c: ORDER.index(c) if c in ORDER else 99
    )
    lines = [["figure", "bar", *controllers]]
    for row in ROWS:
        bar = row.bar(of)
        cells = [row.cell([r for r in records if r["controller"] == c]) for c in controllers]
        if all(cell is None for cell in cells):
            continue
        texts = []
        for cell in cells:
            mark = "" if bar is None or cell is None else _mark(bar.kept_by(cell.value))
            texts.append(f"{cell.text}{mark}" if cell else "")
        unit = f", {row.unit}" if row.unit else ""
        lines.append([f"{row.name}{unit}", str(bar or ""), *texts])
    return markdown(lines)


def _mark(kept: bool) -> str:
    return " ok" if kept else " **short**"


def failures(records: Sequence[Record]) -> str:
    """Return a line per clip that failed, with the reason."""
    lines = [
        f"- {r['controller']}, {r['set']}/{r['clip']}: {_why(r)}"
        for r in sorted(records, key=lambda r: (r["controller"], r["set"], r["clip"]))
        if not r["success"]
    ]
    return "\n".join(lines) or "None."


def _why(record: Record) -> str:
    falls = [
        f"{person} fell at {time:.2f} s of {record['duration_s']:.1f} s"
        for person, time in record.get("fall_time_s", {}).items()
        if time is not None
    ]
    ended = [record["ended_because"]] if record.get("ended_because") else []
    tried = [f"after {record['recoveries']} recoveries"] if record.get("recoveries") else []
    return ", ".join([*falls, *ended, *tried])


def ablation(records: Sequence[Record]) -> str:
    """Return a line per variant of the controller, on the same clips."""
    rows = [row for row in ROWS if row.name in ABLATION_ROWS]
    lines = [["variant", "clips", *(f"{r.name}{', ' + r.unit if r.unit else ''}" for r in rows)]]
    for name in VARIANTS:
        found = [r for r in records if r["variant"] == name]
        if found:
            cells = [row.cell(found) for row in rows]
            lines.append([name, str(len(found)), *(c.text if c else "" for c in cells)])
    clips = ", ".join(f"{c.set}/{c.name}" for c in ablation_clips())
    failed = failures([{**r, "controller": r["variant"]} for r in records])
    return "\n\n".join(
        [
            markdown(lines),
            f"Controller {CONTROLLER} on {clips}.",
            f"Failures:\n\n{failed}",
            _provenance(records),
        ]
    )


def _provenance(records: Sequence[Record]) -> str:
    def all_of(key: str) -> str:
        return ", ".join(sorted({str(r[key]) for r in records if key in r}))

    return (
        f"Revision {all_of('revision')}, MuJoCo {all_of('mujoco_version')},"
        f" {all_of('jobs')} clips at a time."
    )


def markdown(lines: Iterable[Sequence[str]]) -> str:
    """Return a table; the first line is its head."""
    head, *body = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([head, "|" + "---|" * (head.count("|") - 1), *body])


def replace_between_markers(page: Path, name: str, text: str) -> None:
    """Put a text between ``<!-- name -->`` and ``<!-- /name -->`` of a page.

    Raises:
        MotionFileError: The page or its markers are missing.
    """
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    try:
        old = page.read_text(encoding="utf-8")
    except OSError as error:
        raise MotionFileError("cannot be read", where=str(page)) from error
    before, found, rest = old.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise MotionFileError(f"has no {begin} ... {end}", where=str(page))
    with whole_file(page) as file:
        file.write(f"{before}{begin}\n\n{text}\n\n{end}{after}".encode())


if __name__ == "__main__":
    sys.exit(main())
