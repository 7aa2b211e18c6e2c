"""Measure what docs/results.md compares.

    python -m benchmarks.results [--only "ground truth" ...] [--limit 50] [--minutes 30]
    python -m benchmarks.results --train-ablations [--minutes 600]
    python -m benchmarks.results.table

Clips, motions and models are in out/results. What the page is made of, one line of JSON per row,
split and repetition, and the judges, is in benchmarks/results/kept; what --limit or --plan measures
goes to out/results. What is there already is not done again, so a run may be stopped in any way and
started again. A model that is trained further is measured anew.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.results.ablations import load_ablations, train_all
from benchmarks.results.judges import judges
from benchmarks.results.models import Models
from benchmarks.results.real import keep_real
from benchmarks.results.rows import FILE, load_plan
from benchmarks.results.run import KEPT, Bench, Clock, OutOfTime
from benchmarks.results.takes import Makers
from benchmarks.tracking.run import note
from generator.threads import thread_limit
from robots.errors import DuetError

OUT = Path("out/results")


def main() -> int:
    """Parse, run, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.results", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--only", action="append", metavar="ROW", help="this row, or this ablation (repeatable)"
    )
    parser.add_argument("--limit", type=int, help="most clips of a split, to try things out")
    parser.add_argument("--minutes", type=float, help="stop after so much time; run again to go on")
    parser.add_argument(
        "--train-ablations", action="store_true", help="train the small models instead"
    )
    parser.add_argument(
        "--clips", type=Path, metavar="DIR", help="take spectra and examples of these duets instead"
    )
    parser.add_argument("--plan", type=Path, default=FILE, help="other rows and sizes")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder (default: {OUT})")
    parser.add_argument("--kept", type=Path, metavar="DIR", help="folder of the lines and judges")
    parser.add_argument("--threads", type=int, default=1, help="threads (default: 1)")
    args = parser.parse_args()
    if args.limit is not None and args.limit < 2:
        parser.error("--limit takes 2 or more")
    try:
        with thread_limit(args.threads):
            if args.clips is not None:
                learnt, held = keep_real(args.clips, args.out)
                note(f"{learnt} clips to learn from, {held} held out")
            elif args.train_ablations:
                _train(args)
            else:
                _measure(args)
    except OutOfTime as error:
        note(str(error))
    except DuetError as error:
        note(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        note("stopped; run again to go on")
        return 130
    return 0


def _train(args: argparse.Namespace) -> None:
    clock = Clock(args.minutes)
    done = train_all(load_ablations(), only=args.only, say=note, stop=lambda: clock.over)
    note("all that there are clips for are trained" if done else "stopped; run again to go on")


def _measure(args: argparse.Namespace) -> None:
    plan = load_plan(args.plan)
    rows = plan.chosen(args.only)
    clock = Clock(args.minutes)
    whole = args.limit is None and args.plan == FILE
    kept = args.kept or (KEPT if whole else args.out)
    known = (args.kept or KEPT) / "judges"
    who = judges(args.out / "judges", plan.evaluator, note, clock.check, known)
    makers = Makers(args.out / "takes", plan.protocol, Models(plan.protocol.fps))
    Bench(plan, args.out, who, makers, clock, args.limit, kept).run(rows)


if __name__ == "__main__":
    sys.exit(main())
