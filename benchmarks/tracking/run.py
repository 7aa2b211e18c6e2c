"""Measure what has not been measured yet, on all cores, a line on disk after every clip."""

from __future__ import annotations

import logging
import multiprocessing
import os
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from benchmarks.tracking.results import Record, Results
from benchmarks.tracking.tasks import Task, perform
from robots.errors import DuetError

log = logging.getLogger(__name__)

Workers = Callable[[Sequence[Task]], Iterable[Record]]
"""Perform tasks and yield their records in the order in which they are done."""


def run(tasks: Sequence[Task], results: Results, workers: Workers) -> int:
    """Perform the tasks that have no result, append each as it comes; return how many those were.

    Raises:
        DuetError: The workers died; what they had finished is on disk.
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
    """Return workers in ``jobs`` processes with one BLAS thread each."""

    def workers(tasks: Sequence[Task]) -> Iterator[Record]:
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
            os.environ[name] = "1"  # read when the new process imports numpy
        pool = ProcessPoolExecutor(
            jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_start
        )
        crashed = 0
        try:
            for future in as_completed([pool.submit(perform, task) for task in tasks]):
                try:
                    yield future.result()
                except BrokenProcessPool as error:
                    raise DuetError(
                        "a process died", hint="run again; what is done is not done anew"
                    ) from error
                except Exception:  # a bug that one clip found; the others have hours before them
                    crashed += 1
                    traceback.print_exc()
        finally:
            pool.shutdown(cancel_futures=True)
        if crashed:
            raise DuetError(f"{crashed} clips crashed", hint="see above, then run again")

    return workers


def _start() -> None:
    """Be quiet, and end with the parent even if it is killed: a pool's process would wait on."""
    logging.disable(logging.WARNING)
    parent = multiprocessing.parent_process()
    if parent is not None:
        sentinel = parent

        def follow() -> None:
            sentinel.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


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
