"""A clock that can be handed in: the machine's monotonic one, or one that tests move."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Time in s that never runs backwards."""

    def now(self) -> float:
        """Return the time, s."""
        ...

    def sleep_until(self, deadline: float) -> None:
        """Return at ``deadline`` s, or at once if it has passed."""
        ...


class MonotonicClock:
    """The machine's monotonic clock; setting the wall clock does not move it."""

    def now(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def sleep_until(self, deadline: float) -> None:
        """Sleep until ``deadline`` s."""
        while (left := deadline - time.monotonic()) > 0:
            time.sleep(left)


class VirtualClock:
    """Time that passes only when somebody waits: hours of playing in seconds, always the same."""

    def __init__(self, start: float = 0.0) -> None:
        """Start at ``start`` s."""
        self._now = start

    def now(self) -> float:
        """Return the time, s."""
        return self._now

    def sleep_until(self, deadline: float) -> None:
        """Let the time be ``deadline`` s, unless it is later already."""
        self._now = max(self._now, deadline)
