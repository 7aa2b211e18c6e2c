"""Measure what has not been measured yet, on all cores, a line on disk after every clip."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence

from benchmarks.tracking.results import Record, Results
from benchmarks.tracking.tasks import Task, perform
from robots.errors import DuetError
from sim import batch
from sim.batch import Lost

Workers = Callable[[Sequence[Task]], Iterable[Record]]
"""Perform tasks and yield their records in the order in which they are done."""


def run(tasks: Sequence[Task], results: Results, workers: Workers) -> int:
    """Perform the tasks that have no result, append each as it comes; return how many those were.

    Raises:
        DuetError: Some tasks have no result; all others are on disk.
    """
    done = results.read()
    pending = [task for task in tasks if task.key not in done]
    print(f"{results.path}: {len(tasks) - len(pending)} done, {len(pending)} to do", flush=True)
    count = 0
    for record in workers(pending):
        results.append(record)
        count += 1
        print(f"[{count}/{len(pending)}] {_line(record)}", flush=True)
    return count


def in_processes(jobs: int) -> Workers:
    """Return workers in ``jobs`` processes; they outlive the death of any of them."""

    def workers(tasks: Sequence[Task]) -> Iterator[Record]:
        lost = 0
        for task, record in batch.in_processes(perform, tasks, jobs):
            if isinstance(record, Lost):  # others may have hours before them, so go on
                lost += 1
                note(f"{task.clip.set}/{task.clip.name} {task.controller}: {record.why}")
            else:
                yield record
        if lost:
            raise DuetError(f"{lost} clips have no result", hint="see above, then run again")

    return workers


def _line(record: Record) -> str:
    """Return one result for the terminal."""
    what = f"{record['set']}/{record['clip']} {record['variant'] or record['controller']}"
    if "mpjpe_global_mm" not in record:
        return f"{what}: {record['ended_because']}"
    error = sum(record["mpjpe_global_mm"].values()) / 2
    verdict = "ok" if record["success"] else "FAILED"
    return f"{what}: {verdict}, {error:.0f} mm, {record['cpu_seconds_per_second']:.2f} CPU-s per s"


def note(text: str) -> None:
    """Tell the person at the terminal something that is no result."""
    print(text, file=sys.stderr, flush=True)
