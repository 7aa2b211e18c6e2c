"""One phase for both robots: where on their common path they are at a given time.

**The problem.** Two robots that count their own ticks drift apart, and a robot that stops "now"
jerks. Both here ask the same object for the phase, as a function of absolute time: it runs at a
constant rate, and :meth:`Phase.change` leads it evenly to another one: to 0 for a stop, a pause or
a freeze, to less for servos that get warm, and back. So both robots slow down, wait and go on
together, along their paths.

Worked example: rate 1, stop at 2.0 s within 0.5 s; the phase is 2.0 at 2.0 s, 2.1875 at 2.25 s
(half the speed), and 2.25 from 2.5 s on.
"""

from __future__ import annotations


class Phase:
    """Phase in s of the path, by time in s of a clock."""

    def __init__(self, start: float, rate: float = 1.0) -> None:
        """Let the phase be 0 at time ``start`` and grow with ``rate``."""
        self._since, self._phase = start, 0.0
        self._before = rate
        self.rate = rate
        """What the rate is, or is on the way to."""
        self._within = 0.0
        self.stopping = False
        """Whether a stop has been asked for."""

    def change(self, now: float, rate: float, within: float) -> None:
        """Lead to another rate from ``now`` on, within s; after a stop this changes nothing."""
        if self.stopping:
            return
        self._phase, self._before = self.at(now), self._rate_at(now)
        self._since, self._within, self.rate = now, within, rate

    def stop(self, now: float, within: float) -> None:
        """Slow down to standstill for good from ``now`` on; later calls change nothing."""
        self.change(now, 0.0, within)
        self.stopping = True

    def stopped(self, now: float) -> bool:
        """Whether a stop has come to its end."""
        return self.stopping and now >= self._since + self._within

    def at(self, now: float) -> float:
        """Return the phase at a time, s; never decreasing."""
        passed = now - self._since
        if passed <= 0:
            return self._phase + passed * self._before
        changing = min(passed, self._within)
        phase = self._phase + self.rate * (passed - changing) + self._before * changing
        if self._within > 0:
            phase += (self.rate - self._before) * changing**2 / (2 * self._within)
        return phase

    def _rate_at(self, now: float) -> float:
        share = min(max(now - self._since, 0.0) / self._within, 1.0) if self._within > 0 else 1.0
        return self._before + (self.rate - self._before) * share
