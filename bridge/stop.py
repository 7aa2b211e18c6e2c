"""Stopping from outside: by a signal handler, a key, another thread."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class StopRequest(threading.Event):
    """An event that counts: set once to stop gently, twice to relax at once.

    Setting it is all that a signal handler may do.
    """

    def __init__(self) -> None:
        """Start unset."""
        super().__init__()
        self._level = 0

    @property
    def level(self) -> int:
        """How often it was set."""
        return self._level

    def set(self) -> None:
        """Ask for a stop, or more urgently for it."""
        self._level += 1
        super().set()


def stop_level(event: threading.Event) -> int:
    """Return how urgent a stop is: 0 go on, 1 slow down and hold, 2 relax at once."""
    return event.level if isinstance(event, StopRequest) else int(event.is_set())


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turn Ctrl-C and SIGTERM into a stop request while the block runs.

    Outside the main thread signals cannot be caught, and the request is only ever set by hand.
    """
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    names = (signal.SIGINT, signal.SIGTERM)
    before = {name: signal.signal(name, lambda *_: stop.set()) for name in names}
    try:
        yield stop
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
