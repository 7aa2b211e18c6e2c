"""A virtual bus behind the methods of a pyserial port, in process and on any clock."""

from __future__ import annotations

import errno
from collections import deque

from bridge.servo.clock import Clock
from bridge.virtual.bus import VirtualBus


class VirtualSerial:
    """What ``serial.Serial`` offers to a client, answered by a :class:`VirtualBus`.

    On a virtual clock a blocking read moves the clock to the moment at which the bytes are due, so
    that a whole performance runs without waiting.
    """

    def __init__(self, bus: VirtualBus, clock: Clock, *, baudrate: int, timeout: float) -> None:
        """Open.

        Args:
            bus: The other end.
            clock: Gives the time and waits.
            baudrate: bit/s of this end; servos set to another rate do not hear it.
            timeout: s for which a read waits.
        """
        self.bus = bus
        self.clock = clock
        self.baudrate = baudrate
        self.timeout = timeout
        self.is_open = True
        self._opened = clock.now()
        self._due: deque[tuple[float, bytes]] = deque()
        self._received = bytearray()

    @property
    def in_waiting(self) -> int:
        """Bytes that have arrived."""
        self._collect()
        return len(self._received)

    def read(self, size: int = 1) -> bytes:
        """Return ``size`` bytes, or those that came before the timeout."""
        deadline = self.clock.now() + self.timeout
        self._collect()
        while len(self._received) < size and self.clock.now() < deadline:
            wait = min(deadline, self._due[0][0]) if self._due else deadline
            self.clock.sleep_until(wait)
            self._collect()
        data = bytes(self._received[:size])
        del self._received[:size]
        return data

    def write(self, data: bytes | bytearray | list[int]) -> int:
        """Send bytes."""
        self._require_plugged()
        self._due.extend(self.bus.feed(self.clock.now(), bytes(data), baud=self.baudrate))
        return len(data)

    def flush(self) -> None:
        """Do nothing: bytes leave at once."""

    def reset_input_buffer(self) -> None:
        """Forget bytes that have arrived."""
        self._collect()
        self._received.clear()

    def close(self) -> None:
        """Close."""
        self.is_open = False

    def _collect(self) -> None:
        self._require_plugged()
        now = self.clock.now()
        while self._due and self._due[0][0] <= now:
            self._received += self._due.popleft()[1]

    def _require_plugged(self) -> None:
        # A port that was unplugged stays dead; the one that is opened afterwards is another.
        if not self.is_open or self.bus.faults.unplugged(self._opened, self.clock.now()):
            raise OSError(errno.EIO, "Input/output error")
