"""Serves a virtual bus on a pseudo-terminal: any serial client can open it by name."""

from __future__ import annotations

import array
import contextlib
import errno
import fcntl
import heapq
import logging
import math
import os
import select
import sys
import termios
import threading
import time
import tty
from pathlib import Path
from types import TracebackType

from bridge.virtual.bus import VirtualBus
from robots.errors import PortLost

log = logging.getLogger(__name__)

_SPEEDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit() and name != "B0"
}
"""bit/s by the constant that a terminal's settings carry."""

_OTHER_SPEED, _TCGETS2 = 0o010000, 0x802C542A
"""Linux: the constant of a rate that has none of its own, and the call that tells which it is."""

CHUNK = 4096
BATCH = 0.0005
"""Answers that follow each other within this time, s, are handed over together, when the last is
due: as a USB adapter does with its frames."""
WAKE = 0.00006
"""The operating system wakes a sleeper up to this late, s: the last moment before an answer is due
is waited out awake."""
IDLE = 0.004
"""Longest silence, s, after which a body that hangs on the bus moves on: what it has to catch up
with delays the answer to the next packet. 20 ms of a walking robot take 6 ms to compute."""


class PtyServer:
    """A virtual bus on a pseudo-terminal.

    As a context manager it serves from a thread; :meth:`serve` does so in the calling one. The
    client's rate is read from the terminal: servos set to another one hear nothing. Faults' times
    count from the moment at which the server is made. When the adapter is unplugged clients are
    hung up on and the link is gone; plugged in again it is another terminal under the same link.
    """

    def __init__(
        self, bus: VirtualBus, *, link: str | Path | None = None, timing: bool = False
    ) -> None:
        """Open the pseudo-terminal.

        Args:
            bus: What is served. Only the serving thread may touch it from now on.
            link: Symbolic link to make under a stable name; removed at the end. An existing link is
                replaced, any other file is refused.
            timing: Whether answers take the time of the client's bit rate.

        Raises:
            PortLost: There are no pseudo-terminals here, or the link cannot be made.
        """
        self.bus = bus
        self._timing = timing
        self._due: list[tuple[float, int, bytes]] = []
        self._count = 0
        self._baud: int | None = None
        self._stop_read, self._stop_write = os.pipe()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._master = self._slave = -1
        self.path = ""
        """Device file of the terminal."""
        self.link = Path(link) if link is not None else None
        bus.faults.origin = self._opened = time.monotonic()
        self._plug_in()

    @property
    def port(self) -> str:
        """Name for clients: the link if there is one, else the device file."""
        return str(self.link) if self.link is not None else self.path

    def __enter__(self) -> PtyServer:
        """Serve from a thread."""
        self._thread = threading.Thread(target=self.serve, name="virtual-bus", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop and close."""
        self.close()

    def serve(self) -> None:
        """Serve until :meth:`stop` is called from another thread or a signal handler."""
        while True:
            # select, not poll: its timeout is not rounded up to milliseconds.
            ports = (self._stop_read,) if self._master < 0 else (self._master, self._stop_read)
            ready, _, _ = select.select(ports, (), (), self._wait())
            if self._stop_read in ready:
                return
            now = time.monotonic()
            if self.bus.faults.faults and self._is_away(now):
                continue
            if self._master in ready:
                self._receive(now)
            elif self._due and now < self._handed_over():
                continue
            elif not self._due:
                self.bus.advance(now)
            self._send(time.monotonic())

    def _wait(self) -> float | None:
        """Return how long to sleep at most if nothing arrives, s."""
        if self._master < 0:
            return IDLE
        if self._due:
            return max(0.0, self._handed_over() - WAKE - time.monotonic())
        if self.bus.plant is not None and self.bus.instructions:
            return IDLE
        away = self.bus.faults.next_unplug(self._opened)
        return max(0.0, away - time.monotonic()) if math.isfinite(away) else None

    def _is_away(self, now: float) -> bool:
        """Hang up or come back as the faults say; return whether the adapter is unplugged."""
        faults = self.bus.faults
        if self._master >= 0 and faults.unplugged(self._opened, now):
            log.warning("%s: the virtual adapter is unplugged", self.port)
            self._hang_up()
        if self._master < 0 and not faults.unplugged(now, now):
            self._plug_in()
            log.warning("%s: the virtual adapter is plugged in again", self.port)
        return self._master < 0

    def stop(self) -> None:
        """Make :meth:`serve` return."""
        with contextlib.suppress(OSError):
            os.write(self._stop_write, b"x")

    def close(self) -> None:
        """Stop serving, remove the link and close the terminal."""
        if self._closed:
            return
        self._closed = True
        self.stop()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=5)
        self._hang_up()
        for fd in (self._stop_read, self._stop_write):
            os.close(fd)

    def _plug_in(self) -> None:
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise PortLost(f"no pseudo-terminal: {error.strerror}", where="virtual bus") from error
        # The slave stays open here, so that clients may come and go without a hang-up.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._opened = time.monotonic()
        if self.link is not None:
            self._make_link(self.link)

    def _hang_up(self) -> None:
        link = self.link
        if link is not None and link.is_symlink() and os.readlink(link) == self.path:
            link.unlink()
        self._due.clear()
        for name in ("_master", "_slave"):
            fd = getattr(self, name)
            if fd >= 0:
                os.close(fd)
                setattr(self, name, -1)

    def _make_link(self, link: Path) -> None:
        try:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(self.path)
        except OSError as error:
            self._hang_up()
            raise PortLost(
                f"cannot make the link: {error.strerror}",
                where=str(link),
                hint="choose another --link",
            ) from error

    def _receive(self, now: float) -> None:
        try:
            data = os.read(self._master, CHUNK)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EIO):
                return
            raise
        # Clients may change the rate at any time; a lookup costs a microsecond.
        self._baud = _line_speed(self._master)
        self.bus.baud = self._baud if self._timing else None
        for due, answer in self.bus.feed(now, data, baud=self._baud):
            self._count += 1
            heapq.heappush(self._due, (due, self._count, answer))

    def _handed_over(self) -> float:
        """Return when the next answers are handed over: at the end of those close together."""
        times = sorted(due for due, _, _ in self._due)
        last = times[0]
        for due in times:
            if due - last > BATCH:
                break
            last = due
        return last

    def _send(self, now: float) -> None:
        ready = bytearray()
        while self._due and self._due[0][0] <= now:
            ready += heapq.heappop(self._due)[2]
        while ready:
            try:
                del ready[: os.write(self._master, ready)]
            except BlockingIOError:
                # The client does not read: a real line would lose these bytes too.
                log.warning("%s: %d bytes lost, nobody reads", self.port, len(ready))
                return


def _line_speed(fd: int) -> int | None:
    """Return the bit/s that a terminal is set to; ``None`` if the system does not tell."""
    speed = termios.tcgetattr(fd)[5]
    if speed != getattr(termios, "BOTHER", _OTHER_SPEED):
        return _SPEEDS.get(speed)
    if not sys.platform.startswith("linux"):
        return None
    settings = array.array("I", bytes(4 * 64))
    fcntl.ioctl(fd, _TCGETS2, settings, True)
    return settings[10]
