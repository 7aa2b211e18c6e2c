"""Stopping and pausing from outside: by a signal handler, a key, another thread."""

from __future__ import annotations

import atexit
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

GENTLE, RELAX, CUT = 1, 2, 3
"""How urgent a stop is: slow down, hold and relax; relax now; torque off at once."""
EXIT_WAIT = 5.0
"""Longest time that the end of the program waits for robots to be relaxed, s."""


class StopRequest(threading.Event):
    """An event that counts: each time it is set it asks more urgently, up to :data:`CUT`.

    Setting it, and turning :attr:`paused`, is all that a signal handler may do.
    """

    def __init__(self) -> None:
        """Start unset."""
        super().__init__()
        self._level = 0
        self.paused = False
        """Whether both robots shall wait where they are."""

    @property
    def level(self) -> int:
        """How often it was set."""
        return self._level

    def set(self) -> None:
        """Ask for a stop, or more urgently for it."""
        self._level += 1
        super().set()

    def pause(self) -> None:
        """Ask for a pause, or for its end."""
        self.paused = not self.paused


def stop_level(event: threading.Event) -> int:
    """Return how urgent a stop is: 0 for go on, else as :data:`GENTLE`, ..., :data:`CUT`."""
    return min(event.level, CUT) if isinstance(event, StopRequest) else int(event.is_set())


def is_paused(event: threading.Event) -> bool:
    """Return whether a pause is asked for."""
    return isinstance(event, StopRequest) and event.paused


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Turn Ctrl-C, Ctrl-Z, SIGTERM and SIGHUP into a stop request while the block runs.

    A program that Ctrl-Z has suspended could stop nothing any more. SIGUSR1 asks for a pause and
    for its end. Outside the main thread signals cannot be caught, and
    the request is only ever set by hand.
    """
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    stopping = ("SIGINT", "SIGTSTP", "SIGTERM", "SIGHUP")
    actions = {**dict.fromkeys(stopping, stop.set), "SIGUSR1": stop.pause}
    before = {}
    for name, action in actions.items():
        number = getattr(signal, name, None)  # not every system has all of them
        if number is not None:
            before[number] = signal.signal(number, lambda *_, act=action: act())
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def relaxed_at_exit(stop: threading.Event) -> Iterator[None]:
    """Hold back the end of the program while the block runs in another thread.

    A thread that plays is cut off when the main thread ends. Here the end asks for an urgent stop
    and waits until the robots are relaxed; it never touches a port itself.
    """
    done = threading.Event()

    def leave() -> None:
        for _ in range(RELAX):
            stop.set()
        done.wait(EXIT_WAIT)

    atexit.register(leave)
    try:
        yield
    finally:
        done.set()
        atexit.unregister(leave)
