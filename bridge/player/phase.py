"""One phase for both robots: where on their common path they are at a given time.

**The problem.** Two robots that count their own ticks drift apart, and a robot that stops "now"
jerks. Both here ask the same object for the phase, as a function of absolute time: it runs at a
constant rate, and after :meth:`Phase.stop` it slows down evenly and then stays, so that a stop
follows the path with falling speed.

Worked example: rate 1, stop at 2.0 s within 0.5 s; the phase is 2.0 at 2.0 s, 2.1875 at 2.25 s
(half the speed), and 2.25 from 2.5 s on.
"""

from __future__ import annotations


class Phase:
    """Phase in s of the path, by time in s of a clock."""

    def __init__(self, start: float, rate: float = 1.0) -> None:
        """Let the phase be 0 at time ``start`` and grow with ``rate``."""
        self._start = start
        self._rate = rate
        self._stop: tuple[float, float] | None = None

    @property
    def stopping(self) -> bool:
        """Whether a stop has been asked for."""
        return self._stop is not None

    def stop(self, now: float, within: float) -> None:
        """Slow down to standstill from ``now`` on, ``within`` s; later calls change nothing."""
        if self._stop is None:
            self._stop = (now, max(within, 1e-9))

    def stopped(self, now: float) -> bool:
        """Whether it stands still."""
        return self._stop is not None and now >= self._stop[0] + self._stop[1]

    def at(self, now: float) -> float:
        """Return the phase at a time, s; never decreasing."""
        if self._stop is None or now <= self._stop[0]:
            return (now - self._start) * self._rate
        begin, within = self._stop
        passed = min(now - begin, within)
        return (begin - self._start + passed - passed**2 / (2 * within)) * self._rate
