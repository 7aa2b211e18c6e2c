"""Another :class:`~bridge.servo.transport.Transport`: rustypot, a client written in Rust.

**The problem.** On a small computer the packets of two robots may take a whole core of Python;
rustypot handles them in compiled code. It differs from what a servo bus expects in three ways: it
asks and waits in one call, so two buses are read one after the other (to begin a read here only
notes it); a sync read is all or nothing, so that a silent servo hides the others (then each is
asked alone); and its errors are sentences. It clears what has come late before it asks; after an
error it is given the time to come.

It is optional: ``pip install 'pasdedeux[rustypot]'``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

import numpy as np
from numpy.typing import NDArray

from bridge.servo.clock import Clock, MonotonicClock
from bridge.servo.packets import ALERT, ERROR_NAMES, MAX_PACKET
from bridge.servo.transport import SyncAnswer
from robots.errors import BusCorrupt, BusError, BusTimeout, PortLost, ServoFault, SpecError

if TYPE_CHECKING:
    import rustypot

_STATUS = 11
"""Bytes of a status packet beside its data."""
PATIENCE = 0.012
"""How long an answer may take beyond its time on the wire, s."""
ALONE_LIMIT = 0.100
"""How long servos are asked one by one after a sync read that failed, s."""
_DAMAGE = ("checksum", "parsing", "incorrect id", "invalid")
"""Words in the messages about answers that came and made no sense."""


class RustypotTransport:
    """A :class:`Transport` over the installed rustypot (see the module's text)."""

    def __init__(
        self, port: str, baud: int, *, clock: Clock | None = None, patience: float = PATIENCE
    ) -> None:
        """Keep the settings; :meth:`open` opens.

        Args:
            port: Device file.
            baud: bit/s.
            clock: Bounds how long servos are asked one by one; the client's own timeouts follow the
                machine.
            patience: s that an answer may be late.

        Raises:
            SpecError: rustypot is not installed.
        """
        try:
            import rustypot
        except ImportError as error:
            raise SpecError(
                "transport 'rustypot' needs the package 'rustypot'",
                hint="pip install 'pasdedeux[rustypot]', or take the transport 'sdk'",
            ) from error
        self.port = port
        self._baud = baud
        self._timeout = patience + 10 * MAX_PACKET / baud
        self._clock = clock or MonotonicClock()
        # Raw registers alone are used: they are the same with every Protocol 2.0 controller.
        self._controller = rustypot.Xl430PyController
        self._device: rustypot.Xl430PyController | None = None
        self._fast = False
        self._asked: tuple[int, int, list[int], bool] = (0, 0, [], False)

    def open(self) -> None:
        """Open the port.

        Raises:
            PortLost: It is not there, not allowed or taken.
        """
        try:
            self._device = self._controller(self.port, self._baud, self._timeout)
            self._device.set_fast_sync_read(False)
        except (OSError, RuntimeError) as error:
            raise PortLost(
                f"cannot be opened: {error}",
                where=self.port,
                hint="is the adapter plugged in, and may you use it (group 'dialout')?",
            ) from error
        self._fast = False

    def close(self) -> None:
        """Close the port; a port that is gone already is no error."""
        device, self._device = self._device, None
        if device is not None:
            with contextlib.suppress(OSError, RuntimeError):
                device.close()

    def ping(self, servo_id: int) -> int:
        """Return the model number of a servo.

        rustypot's own ping does not tell it, so the register is read.
        """
        return int.from_bytes(self.read(servo_id, 0, 2)[1], "little")

    def read(self, servo_id: int, address: int, length: int) -> tuple[int, bytes]:
        """Return (alert bit, data) of a read."""
        who = f"servo {servo_id}"
        try:
            values, error = self._opened.read_raw_data_with_error(servo_id, address, length)
        except (OSError, RuntimeError) as reason:
            self._raise(reason, who)
        self._check(error, who)
        if len(values) != length:
            raise BusCorrupt(f"{who} sent {len(values)} of {length} bytes", where=self.port)
        return error & ALERT, bytes(values)

    def write(self, servo_id: int, address: int, data: bytes) -> int:
        """Write and return the alert bit of the answer."""
        who = f"servo {servo_id}"
        try:
            error = self._opened.write_raw_data_with_error(servo_id, address, list(data))
        except (OSError, RuntimeError) as reason:
            self._raise(reason, who)
        self._check(error, who)
        return error & ALERT

    def sync_write(self, address: int, ids: Sequence[int], data: NDArray[np.uint8]) -> None:
        """Write a row of ``data`` ``[N, length]`` to each servo with one packet."""
        try:
            self._opened.sync_write_raw_data(list(ids), address, data.tolist())
        except (OSError, RuntimeError) as reason:
            self._raise(reason, "the bus")

    def sync_read_begin(
        self, address: int, length: int, ids: Sequence[int], *, fast: bool = False
    ) -> None:
        """Note what :meth:`sync_read_end` will ask for."""
        self._asked = (address, length, list(ids), fast)

    def sync_read_end(self) -> SyncAnswer:
        """Ask, and return what every servo answered; those that did not are marked."""
        address, length, ids, fast = self._asked
        device = self._opened
        if fast != self._fast:
            device.set_fast_sync_read(fast)
            self._fast = fast
        try:
            parts = device.sync_read_raw_data_with_error(ids, address, length)
        except (OSError, RuntimeError) as reason:
            self._require_port(reason)
            # What the others still send would be taken for answers to what is asked next.
            answers = len(ids) * (_STATUS + length)
            self._clock.sleep_until(self._clock.now() + PATIENCE + 10 * answers / self._baud)
            # A fast read that failed is followed by a plain one anyway.
            parts = [] if fast else self._ask_alone(address, length, ids)
        data = np.zeros((len(ids), length), np.uint8)
        seen, alert = np.zeros(len(ids), bool), np.zeros(len(ids), bool)
        for row, (values, error) in enumerate(parts):
            if len(values) == length and not error & ~ALERT:
                data[row] = np.frombuffer(bytes(values), np.uint8)
                seen[row], alert[row] = True, bool(error & ALERT)
        return SyncAnswer(data, seen, alert)

    def _ask_alone(
        self, address: int, length: int, ids: Sequence[int]
    ) -> list[tuple[Sequence[int], int]]:
        deadline = self._clock.now() + ALONE_LIMIT
        parts: list[tuple[Sequence[int], int]] = []
        for servo_id in ids:
            part: tuple[Sequence[int], int] = ((), 0)
            if self._clock.now() < deadline:
                with contextlib.suppress(BusTimeout, BusCorrupt, ServoFault):
                    alert, values = self.read(servo_id, address, length)
                    part = (values, alert)
            parts.append(part)
        return parts

    @property
    def _opened(self) -> rustypot.Xl430PyController:
        if self._device is None:
            raise PortLost("is not open", where=self.port)
        return self._device

    def _check(self, error: int, who: str) -> None:
        code = error & ~ALERT
        if code:
            reason = ERROR_NAMES.get(code, f"error {code}")
            raise ServoFault(f"{who} refused: {reason}", where=self.port)

    def _raise(self, reason: Exception, who: str) -> NoReturn:
        self._clock.sleep_until(self._clock.now() + PATIENCE)
        raise self._meaning(reason, who) from reason

    def _require_port(self, reason: Exception) -> None:
        error = self._meaning(reason, "the bus")
        if isinstance(error, PortLost):
            raise error from reason

    def _meaning(self, reason: Exception, who: str) -> BusError:
        """Return our error for a sentence of rustypot's."""
        text = str(reason)
        if "timed out" in text.lower() or "timeout" in text.lower():
            return BusTimeout(
                f"no answer from {who}", where=self.port, hint="check power, cable, id and baud"
            )
        if any(word in text.lower() for word in _DAMAGE):
            return BusCorrupt(f"a damaged answer from {who}", where=self.port)
        return PortLost(
            f"has gone away: {text}",
            where=self.port,
            hint="check the cable and the adapter, then start again",
        )
