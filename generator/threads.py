"""How many threads a network may take."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch


def default_threads() -> int:
    """Return the cores that this process may use, less one, but at least one.

    **The problem.** The threads of one product of matrices wait for each other. If any of them has
    to share its core with another program, all of them run at half speed; on two cores, two threads
    then take longer than one alone. A core left free keeps the time the same.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, (cores or 1) - 1)


@contextmanager
def thread_limit(count: int | None = None) -> Iterator[int]:
    """Let torch use ``count`` threads in the block, :func:`default_threads` if not given."""
    before = torch.get_num_threads()
    count = default_threads() if count is None else max(1, count)
    torch.set_num_threads(count)
    try:
        yield count
    finally:
        torch.set_num_threads(before)
