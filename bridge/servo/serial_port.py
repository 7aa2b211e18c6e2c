"""Serial ports: the part of a pyserial port that is used, and how a real one is opened."""

from __future__ import annotations

import contextlib
import logging
import os
import select
from collections.abc import Callable
from typing import Any, Protocol

import serial

try:
    from termios import error as _terminal_error
except ImportError:  # not a POSIX system
    _terminal_error = OSError

log = logging.getLogger(__name__)

PORT_ERRORS: tuple[type[Exception], ...] = (OSError, serial.SerialException, _terminal_error)
"""What a port that is gone raises: pyserial lets the terminal's own errors through."""

READ_WAIT = 0.005
"""How long one read of the port blocks, s: the loop that reads wakes this often, no more."""

WRITE_WAIT = 0.5
"""How long the system may refuse to take bytes, s."""


class SerialPort(Protocol):
    """The part of a pyserial port that is used."""

    @property
    def in_waiting(self) -> int:
        """Bytes that have arrived."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Return up to ``size`` bytes, waiting at most the port's timeout.

        It may return as soon as there are some.
        """
        ...

    def write(self, data: Any, /) -> int | None:
        """Send."""
        ...

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        ...

    def close(self) -> None:
        """Close."""
        ...


OpenSerial = Callable[[str, int], SerialPort]
"""Opens a port by name at a bit rate."""


class TerminalSerial(serial.Serial):
    """A pyserial port on a POSIX system with one wait and one call to the system for a transfer.

    pyserial's own methods take several of each and about 50 us more for a cycle of twenty servos.
    """

    def read(self, size: int = 1, /) -> bytes:
        """Return what has arrived, at most ``size`` bytes, waiting at most the timeout for it."""
        if not select.select((self,), (), (), self.timeout)[0]:
            return b""
        data = os.read(self.fileno(), size)
        if not data:
            raise serial.SerialException("hung up")
        return data

    def write(self, data: Any, /) -> int:
        """Send all of it.

        Raises:
            serial.SerialTimeoutException: The system takes no bytes for :data:`WRITE_WAIT`.
        """
        left = memoryview(bytes(data))
        count = len(left)
        while True:
            with contextlib.suppress(BlockingIOError):
                left = left[os.write(self.fileno(), left) :]
            if not left:
                return count
            if not select.select((), (self,), (), WRITE_WAIT)[1]:
                raise serial.SerialTimeoutException("takes no bytes")


def open_serial(port: str, baud: int) -> SerialPort:
    """Open a real port: blocking reads, exclusive, the latency timer short where there is one."""
    kind = TerminalSerial if os.name == "posix" else serial.Serial
    device = kind(port, baud, timeout=READ_WAIT, write_timeout=WRITE_WAIT, exclusive=True)
    try:
        device.set_low_latency_mode(True)
    except (AttributeError, OSError, ValueError, NotImplementedError, serial.SerialException):
        log.debug("%s: no low-latency mode", port)
    return device
