"""Batches made ready on a thread of their own, with the vectors of their sentences.

**The problem.** A sentence that is met for the first time takes as long to encode as a hundredth of
a step, and a batch has dozens: on two cores, a quarter of the time one of them waits for the other.
The encoder and the network both leave Python alone while they work, so a thread is enough.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterator, Sequence

from generator.data import Batch

DEPTH = 4
"""Batches that are kept ready."""


def ahead(
    batches: Iterator[Batch], encode: Callable[[Sequence[str]], object], depth: int = DEPTH
) -> Generator[Batch, None, None]:
    """Yield batches in their order, each after its sentences were encoded; errors as they come.

    Args:
        batches: Drawn on a thread.
        encode: Called there with the sentences of each batch; remembers what it found.
        depth: Batches that are kept ready.
    """
    ready: queue.Queue[Batch | BaseException | None] = queue.Queue(depth)
    ended = threading.Event()

    def offer(item: Batch | BaseException | None) -> None:
        while not ended.is_set():
            try:
                return ready.put(item, timeout=0.1)
            except queue.Full:
                continue

    def work() -> None:
        try:
            for batch in batches:
                if ended.is_set():
                    return
                encode(batch.texts)
                offer(batch)
            offer(None)
        except BaseException as error:  # handed over, and raised where it can be caught
            offer(error)

    thread = threading.Thread(target=work, name="batches", daemon=True)
    thread.start()
    try:
        while (item := ready.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        ended.set()
        thread.join()
