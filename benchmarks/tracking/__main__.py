"""Track sets of duets with several controllers; see docs/tracking.md.

    python -m benchmarks.tracking [--sets choreo,dirty] [--controllers assist] [--limit 3]
    python -m benchmarks.tracking --ablation

Results go to out/bench-track/, one line of JSON per clip. What is there already is not done again,
so a run may be stopped in any way and started again.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from benchmarks.tracking.ablation import ablation_tasks
from benchmarks.tracking.clips import SETS, clips_of
from benchmarks.tracking.results import Results
from benchmarks.tracking.run import in_processes, note, run
from benchmarks.tracking.tasks import Task
from robots.errors import DuetError
from sim.track import CONTROLLERS

OUT = Path("out/bench-track")
AT_EQUAL_CPU: Mapping[str, Mapping[str, Any]] = MappingProxyType({"mppi": {"samples": 14}})
"""Settings with which a controller takes about as much of the processor as ``ilqr`` does."""
ORDER = ("ilqr", "mppi", "assist")
"""The most interesting first."""


def main() -> int:
    """Parse, run, and return the exit code."""
    known = [name for name in ORDER if name in CONTROLLERS]
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tracking", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--controllers", type=_words, default=known, help=",".join(known))
    parser.add_argument("--sets", type=_words, help=f"of {','.join(SETS)}; default: all there are")
    parser.add_argument("--folder", type=Path, help="own motion files, as the set 'folder'")
    parser.add_argument("--limit", type=int, help="only the first clips of each set")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("--save-rollouts", action="store_true", help="keep what physics did")
    parser.add_argument("--ablation", action="store_true", help="leave out parts of ilqr instead")
    parser.add_argument("--out", type=Path, default=OUT, help=f"folder (default: {OUT})")
    args = parser.parse_args()
    rollouts = args.out / "rollouts" if args.save_rollouts else None
    try:
        if args.ablation:
            tasks = ablation_tasks(jobs=args.jobs, rollouts=rollouts, limit=args.limit)
        else:
            tasks = _tasks(args, rollouts)
        name = "ablation.jsonl" if args.ablation else "results.jsonl"
        run(tasks, Results(args.out / name), in_processes(args.jobs))
    except DuetError as error:
        note(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        note("stopped; run again to go on")
        return 130
    return 0


def _tasks(args: argparse.Namespace, rollouts: Path | None) -> list[Task]:
    """Return the tasks, one controller after the other."""
    names = args.sets or [*SETS[:3], *(["folder"] if args.folder else [])]
    clips = {name: clips_of(name, args.folder)[: args.limit] for name in names}
    for name, found in clips.items():
        if not found:
            note(f"set {name}: no clips here, left out")
    return [
        Task(
            clip=clip,
            controller=controller,
            options=AT_EQUAL_CPU.get(controller, {}),
            jobs=args.jobs,
            rollouts=rollouts,
        )
        for controller in args.controllers
        for found in clips.values()
        for clip in found
    ]


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


if __name__ == "__main__":
    sys.exit(main())
