"""Write what was measured of a model as JSON, for the card of the model that ships.

python -m benchmarks.results.card "model, 10 steps, finished" -o out/results/card.json
pasdedeux pack RUN -o DIR --figures out/results/card.json
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.results.run import KEPT, open_results
from benchmarks.results.table import ASKED, BODIES, COST, PAPER, SPLITS, cell, latest
from benchmarks.tracking.results import Record
from benchmarks.tracking.run import note
from robots.errors import DuetError, SpecError
from robots.files import write_json

TRUTH = "ground truth"
"""Row beside which a model stands."""


def main() -> int:
    """Write the file and return the exit code."""
    parser = argparse.ArgumentParser(description="Figures of a model, for its card")
    parser.add_argument("row", help="of docs/results.md")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/results/card.json"))
    parser.add_argument("--kept", type=Path, default=KEPT, help="folder of results")
    args = parser.parse_args()
    try:
        write_json(args.out, card(args.row, latest(open_results(args.kept).read().values())))
    except DuetError as error:
        note(str(error))
        return error.exit_code
    return 0


def card(row: str, records: Sequence[Record]) -> dict[str, Any]:
    """Return the figures of a row beside those of real motions, as a model card takes them.

    Args:
        row: Name of the row.
        records: As :func:`benchmarks.results.table.latest` gives them.

    Raises:
        SpecError: Nothing was measured of that row.
    """
    measured = [r for r in records if r["row"] == row]
    if not measured:
        names = dict.fromkeys(r["row"] for r in records)
        raise SpecError(f"no results of '{row}'", where="results", allowed=", ".join(names))
    columns = {}
    for split, title in SPLITS.items():
        for name in (TRUTH, row):
            found = [r for r in records if (r["row"], r["split"]) == (name, split)]
            if found:
                cells = {c.head: cell(found, c) for c in (*PAPER, *ASKED, *BODIES, *COST)}
                columns[f"{title.lower()}: {name}"] = {k: v for k, v in cells.items() if v}
    last = measured[-1]
    sizes = [r["clips"] for r in measured]
    clips = " to ".join(map(str, sorted({min(sizes), max(sizes)})))
    about = (
        f"Row *{row}* of docs/results.md: mean, and half width of the 95 % interval where there are"
        f" several repetitions, of {clips} clips each; hash {last.get('weights', 'unknown')}. The"
        " judges are the project's own; only columns of this table can be compared."
    )
    return {"about": about, "columns": columns}


if __name__ == "__main__":
    sys.exit(main())
