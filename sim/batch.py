"""Runs a function over many items in worker processes, and survives the death of any of them.

**The problem.** A pool of ``concurrent.futures`` is broken for good when one of its processes dies,
by a crash in native code or for want of memory, and all that was waiting fails with it. Here each
worker has a pipe of its own: when it dies, its item alone is lost and the next worker takes over.
When this process dies, workers find their pipes closed and end after the item in hand.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import traceback
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

log = logging.getLogger(__name__)

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Lost:
    """Stands for the result of an item that has none."""

    why: str
    """What happened to it."""


def cores() -> int:
    """Return how many processor cores this process may use."""
    return len(os.sched_getaffinity(0))


def in_processes(
    function: Callable[[T], R], items: Sequence[T], processes: int
) -> Generator[tuple[T, R | Lost]]:
    """Yield each item with its result, in the order in which they are done.

    Processes are spawned, not forked, with one BLAS thread each. If the iterator is closed early,
    they are ended.

    Args:
        function: What to do; a function of a module or a partial of one, so that it can be sent.
        items: What to do it to; they and the results must be picklable.
        processes: How many to use at most.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read by the workers as they start
        os.environ.setdefault(name, "1")
    waiting, idle = deque(items), list[_Worker]()
    busy: dict[Any, tuple[_Worker, T]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < max(1, processes):
                worker = idle.pop() if idle else _Worker(function)
                item = waiting.popleft()
                with suppress(OSError):  # it died in between; its closed pipe says so below
                    worker.connection.send(item)
                busy[worker.connection] = worker, item
            for ready in wait(list(busy)):
                worker, item = busy.pop(ready)
                try:
                    result: R | Lost = worker.connection.recv()
                    idle.append(worker)
                except (EOFError, OSError):
                    result = Lost(f"its process died ({worker.end(dying=True)})")
                yield item, result
    finally:
        for worker in [*idle, *(worker for worker, _ in busy.values())]:
            worker.end()


class _Worker:
    """A process that takes items from a pipe and puts results into it."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, function), daemon=True)
        self._process.start()
        theirs.close()

    def end(self, *, dying: bool = False) -> str:
        """End the process if it does not end by itself; return how it ended."""
        self.connection.close()
        self._process.join(1.0 if dying else 0.0)
        self._process.terminate()
        self._process.join()
        code = self._process.exitcode or 0
        return signal.Signals(-code).name if code < 0 else f"status {code}"


def _serve(connection: Connection, function: Callable[[Any], Any]) -> None:
    """Work until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to all; the first decides
    logging.disable(logging.WARNING)  # what matters is in the results
    try:
        while True:
            item = connection.recv()
            try:
                result = function(item)
            except Exception as error:
                log.error("%s", traceback.format_exc())
                result = Lost(f"{type(error).__name__}: {error}")
            connection.send(result)
    except (EOFError, OSError):
        return
