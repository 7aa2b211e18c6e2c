"""Serial ports: the part of a pyserial port that is used, and how a real one is opened."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, Protocol

import serial

log = logging.getLogger(__name__)

READ_WAIT = 0.005
"""How long one read of the port blocks, s: the loop that reads wakes this often, no more."""


class SerialPort(Protocol):
    """The part of a pyserial port that is used."""

    @property
    def in_waiting(self) -> int:
        """Bytes that have arrived."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Return up to ``size`` bytes, waiting at most the port's timeout."""
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


def open_serial(port: str, baud: int) -> SerialPort:
    """Open a real port: blocking reads, exclusive, the latency timer short where there is one."""
    device = serial.Serial(
        port, baud, timeout=READ_WAIT, write_timeout=0.5, exclusive=True, bytesize=serial.EIGHTBITS
    )
    try:
        device.set_low_latency_mode(True)
    except (AttributeError, OSError, ValueError, NotImplementedError, serial.SerialException):
        log.debug("%s: no low-latency mode", port)
    return device
