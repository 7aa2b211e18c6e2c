"""The default :class:`~bridge.servo.transport.Transport`: dynamixel-sdk over pyserial.

**The problem.** The maker's SDK is the reference client, but used as it stands it is not fit to
move a robot (findings for 4.1.0): its reads spin a whole core; an unplugged adapter raises a bare
``termios.error`` and leaves the port "in use" for ever; one absent servo in a sync read makes the
answers of all the others unreachable; packets that need byte stuffing go out without; the alert bit
is dropped; timeouts follow the wall clock; after a failed read, late bytes are taken for the next
answer. All of it can be mended from outside, by an own port object and two overridden methods: the
SDK itself stays as installed.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from typing import Literal

import dynamixel_sdk as sdk
import numpy as np
from numpy.typing import NDArray

from bridge.servo.clock import Clock, MonotonicClock
from bridge.servo.packets import ALERT, ERROR_NAMES, Parser, stuff, unstuff
from bridge.servo.serial_port import PORT_ERRORS, OpenSerial, open_serial
from bridge.servo.stream import SyncReadPacket, SyncWritePacket
from bridge.servo.transport import SyncAnswer
from robots.errors import BusCorrupt, BusError, BusTimeout, PortLost, ServoFault

log = logging.getLogger(__name__)

PATIENCE = 0.012
"""How long an answer may take beyond its time on the wire, s: an adapter's own delay and the
operating system's, with a millisecond latency timer."""
ALONE_PATIENCE = 0.04
"""The same for a servo that is asked by itself, which is never urgent: longer than the 16 ms that
adapters wait unless told otherwise, and than a busy machine keeps a process waiting."""
QUIET, STREAM_QUIET, DRAIN_LIMIT = 0.012, 0.002, 0.060
"""After an error: the silence that counts as idle (shorter while streaming, where a late answer is
merely an old position) and how long to wait for it, s."""


class _Port(sdk.PortHandler):
    """The SDK's port object, with blocking reads and a clock that cannot be set."""

    def __init__(self, name: str, baud: int, opener: OpenSerial, clock: Clock, patience: float):
        super().__init__(name)
        self.baudrate = baud
        self._opener = opener
        self._clock = clock
        self.patience = patience
        self._received = bytearray()

    def setupPort(self, cflag_baud: int) -> Literal[True]:  # noqa: N802 - the SDK's name
        self.ser = self._opener(self.port_name, self.baudrate)
        self.is_open = True
        self.is_using = False
        self.tx_time_per_byte = 10_000.0 / self.baudrate
        self.clearPort()
        return True

    def getCFlagBaud(self, baudrate: int) -> int:  # noqa: N802 - the SDK's name
        return baudrate

    def getCurrentTime(self) -> float:  # noqa: N802 - the SDK's name
        return self._clock.now() * 1e3

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802 - the SDK's name
        self.packet_start_time = self.getCurrentTime()
        self.packet_timeout = self.tx_time_per_byte * packet_length + self.patience * 1e3

    def isPacketTimeout(self) -> bool:  # noqa: N802 - the SDK's name
        """Say so only if nothing has arrived meanwhile: a stalled host is not a silent servo."""
        waited = self.getCurrentTime() - self.packet_start_time
        if waited <= self.packet_timeout:
            return False
        if waited <= 3 * self.packet_timeout + 20 and self.waiting:
            return False
        self.packet_timeout = 0.0
        return True

    def readPort(self, length: int) -> bytes:  # noqa: N802 - the SDK's name
        """Return up to ``length`` bytes, taking all that is there with one call to the system."""
        missing = length - len(self._received)
        if missing > 0:
            self._received += self.ser.read(max(missing, self.ser.in_waiting))
        data = bytes(self._received[:length])
        del self._received[:length]
        return data

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        """Forget what has arrived."""
        self._received.clear()
        self.ser.reset_input_buffer()

    @property
    def waiting(self) -> int:
        """Bytes that have arrived and were not asked for yet."""
        return len(self._received) + self.ser.in_waiting


class _Packets(sdk.Protocol2PacketHandler):
    """The SDK's packet handler with byte stuffing that reaches the wire and can be undone."""

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802 - the SDK's name
        length = packet[5] | packet[6] << 8
        body = stuff(bytes(packet[7 : 7 + length - 2]))
        packet[7:] = [*body, 0, 0]
        packet[5], packet[6] = (len(body) + 2) & 0xFF, (len(body) + 2) >> 8
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802 - the SDK's name
        length = packet[5] | packet[6] << 8
        body = unstuff(bytes(packet[7 : 7 + length - 2]))
        packet[7 : 7 + length - 2] = list(body)
        packet[5], packet[6] = (len(body) + 2) & 0xFF, (len(body) + 2) >> 8
        return packet


class SdkTransport:
    """A :class:`Transport` over the installed dynamixel-sdk (see the module's text)."""

    def __init__(
        self,
        port: str,
        baud: int,
        *,
        opener: OpenSerial = open_serial,
        clock: Clock | None = None,
        patience: float = PATIENCE,
    ) -> None:
        """Keep the settings; :meth:`open` opens.

        Args:
            port: Device file.
            baud: bit/s.
            opener: Gives the serial port.
            clock: For timeouts.
            patience: s that an answer may be late.
        """
        self.port = port
        self._baud = baud
        self._clock = clock or MonotonicClock()
        self._opener = opener
        self._patience = patience
        self._device: _Port | None = None
        self._packets = _Packets()
        self._writes: dict[tuple[int, int, tuple[int, ...]], SyncWritePacket] = {}
        self._reads: dict[tuple[int, int, tuple[int, ...], bool], SyncReadPacket] = {}
        self._asked: SyncReadPacket | None = None

    def open(self) -> None:
        """Open the port.

        Raises:
            PortLost: It is not there, not allowed or taken.
        """
        device = _Port(self.port, self._baud, self._opener, self._clock, self._patience)
        try:
            device.openPort()
        except (*PORT_ERRORS, ValueError) as error:
            if device.ser is not None:
                device.ser.close()
            raise PortLost(
                f"cannot be opened: {_reason(error)}",
                where=self.port,
                hint="is the adapter plugged in, and may you use it (group 'dialout')?",
            ) from error
        self._device = device

    def close(self) -> None:
        """Close the port; a port that is gone already is no error."""
        device, self._device = self._device, None
        if device is None:
            return
        try:
            device.closePort()
        except PORT_ERRORS as error:
            log.warning("%s: closing failed: %s", self.port, _reason(error))

    def ping(self, servo_id: int) -> int:
        """Return the model number of a servo."""
        with self._guard(servo_id) as device:
            number, result, error = self._packets.ping(device, servo_id)
            self._check(servo_id, result, error)
            return number

    def read(self, servo_id: int, address: int, length: int) -> tuple[int, bytes]:
        """Return (alert bit, data) of a read."""
        with self._guard(servo_id) as device:
            # Not the SDK's own read: it takes checksum bytes for data if an answer is too short.
            request = [0, 0, 0, 0, servo_id, 7, 0, sdk.INST_READ]
            request += [*address.to_bytes(2, "little"), *length.to_bytes(2, "little"), 0, 0]
            answer, result, error = self._packets.txRxPacket(device, request)
            self._check(servo_id, result, error)
            data = bytes(answer[9 : 7 + (answer[5] | answer[6] << 8) - 2]) if answer else b""
            if len(data) != length:
                raise BusCorrupt(
                    f"servo {servo_id} sent {len(data)} of {length} bytes", where=self.port
                )
            return error & ALERT, data

    def write(self, servo_id: int, address: int, data: bytes) -> int:
        """Write and return the alert bit of the answer."""
        with self._guard(servo_id) as device:
            result, error = self._packets.writeTxRx(
                device, servo_id, address, len(data), list(data)
            )
            self._check(servo_id, result, error)
            return error & ALERT

    def sync_write(self, address: int, ids: Sequence[int], data: NDArray[np.uint8]) -> None:
        """Write a row of ``data`` ``[N, length]`` to each servo with one packet."""
        key = (address, data.shape[1], tuple(ids))
        packet = self._writes.get(key)
        if packet is None:
            packet = self._writes[key] = SyncWritePacket(*key)
        filled = packet.filled(data)
        with self._guard() as device:
            device.writePort(filled)

    def sync_read_begin(
        self, address: int, length: int, ids: Sequence[int], *, fast: bool = False
    ) -> None:
        """Ask several servos with one packet; :meth:`sync_read_end` takes their answers.

        With ``fast`` they answer with one chained packet, which takes less of the wire; but it
        breaks off at the first servo that is not there or too old for it.
        """
        key = (address, length, tuple(ids), fast)
        asked = self._reads.get(key)
        if asked is None:
            asked = self._reads[key] = SyncReadPacket(address, length, ids, fast=fast)
        self._asked = asked
        with self._guard() as device:
            device.clearPort()
            device.writePort(asked.request)
            device.setPacketTimeout(len(asked.request) + asked.size)

    def sync_read_end(self) -> SyncAnswer:
        """Return what every servo answered; those that did not are marked.

        Answers are matched by id, whatever their order; those of the wrong length, twice the same
        or with a wrong checksum are dropped.
        """
        asked, received = self._asked, bytearray()
        if asked is None:
            raise ValueError("sync_read_end without sync_read_begin")
        with self._guard() as device:
            while len(received) < asked.size:
                data = device.ser.read(asked.size - len(received))
                received += data
                if not data and device.isPacketTimeout():
                    break
            answer = asked.whole(received)
            if answer is None:
                salvage = self._end_chain if asked.fast else self._end_packets
                answer = salvage(device, asked, received)
        return answer

    def _end_packets(self, device: _Port, asked: SyncReadPacket, received: bytearray) -> SyncAnswer:
        """Read on until every servo has answered or time is up; return what is intact."""
        parts: dict[int, tuple[int, bytes]] = {}
        parser, data = Parser(), bytes(received)
        while True:
            for packet in parser.feed(data):
                if asked.intact(packet) and packet.servo_id not in parts:
                    parts[packet.servo_id] = (packet.params[0], packet.params[1:])
            missing = len(asked.ids) - len(parts)
            if not missing:
                break
            if not data and device.isPacketTimeout():
                self._drain(STREAM_QUIET)
                break
            # No more than what must come: waiting for bytes that do not costs the port's timeout.
            lacking = missing * asked.size // len(asked.ids) - parser.pending
            data = device.readPort(max(1, lacking))
        return asked.collected(parts)

    def _end_chain(self, device: _Port, asked: SyncReadPacket, received: bytearray) -> SyncAnswer:
        """Read on until the chained answer is complete or time is up; return what is intact."""
        head, size = asked.head, asked.size
        while True:
            start = received.find(head)
            if start >= 0 and len(received) >= start + size:
                break
            wanted = start + size if start >= 0 else max(size, len(received) + len(head))
            data = device.readPort(wanted - len(received))
            received += data
            if not data and device.isPacketTimeout():
                self._drain(STREAM_QUIET)
                break
            if len(received) >= 2 * size:  # noise alone: an answer cannot come that late
                self._drain(STREAM_QUIET)
                break
        return asked.parts_of_chain(received[start:]) if start >= 0 else asked.collected({})

    def _guard(self, servo_id: int | None = None) -> _Guard:
        """Turn every way in which the SDK or the port can fail into one of our errors."""
        if self._device is None:
            raise PortLost("is not open", where=self.port)
        alone = servo_id is not None
        self._device.patience = max(self._patience, ALONE_PATIENCE) if alone else self._patience
        return _Guard(self, self._device, servo_id)

    def failed(self, error: BaseException, servo_id: int | None) -> BusError | None:
        """Leave the line silent behind an error; return what to raise instead of it."""
        if isinstance(error, (BusTimeout, BusCorrupt)):
            self._drain()
            return None
        if isinstance(error, IndexError):
            self._drain()
            who = f" from servo {servo_id}" if servo_id is not None else ""
            return BusCorrupt(f"an answer{who} was not a packet", where=self.port)
        return self._lost(error) if isinstance(error, PORT_ERRORS) else None

    def _lost(self, error: BaseException) -> PortLost:
        return PortLost(
            f"has gone away: {_reason(error)}",
            where=self.port,
            hint="check the cable and the adapter, then start again",
        )

    def _check(self, servo_id: int | None, result: int, error: int) -> None:
        """Raise for a result or an error byte of the SDK; the alert bit alone is no error."""
        who = f"servo {servo_id}" if servo_id is not None else "the bus"
        if result == sdk.COMM_RX_TIMEOUT:
            raise BusTimeout(
                f"no answer from {who}", where=self.port, hint="check power, cable, id and baud"
            )
        if result == sdk.COMM_RX_CORRUPT:
            raise BusCorrupt(f"a damaged answer from {who}", where=self.port)
        if result != sdk.COMM_SUCCESS:
            raise BusError(f"could not send to {who} (code {result})", where=self.port)
        code = error & ~ALERT
        if code:
            reason = ERROR_NAMES.get(code, f"error {code}")
            raise ServoFault(f"{who} refused: {reason}", where=self.port)

    def _drain(self, quiet: float = QUIET) -> None:
        """Wait until the line is silent: a late answer must not pass for the next one."""
        device = self._device
        if device is None:
            return
        try:
            device.clearPort()
            deadline = self._clock.now() + DRAIN_LIMIT
            while self._clock.now() < deadline:
                self._clock.sleep_until(self._clock.now() + quiet)
                if not device.waiting:
                    break
                device.clearPort()
        except PORT_ERRORS as error:
            raise self._lost(error) from error


class _Guard:
    """What surrounds each use of the port; no generator, because it is entered in every tick."""

    __slots__ = ("_device", "_servo_id", "_transport")

    def __init__(self, transport: SdkTransport, device: _Port, servo_id: int | None) -> None:
        self._transport = transport
        self._device = device
        self._servo_id = servo_id

    def __enter__(self) -> _Port:
        self._device.is_using = False
        return self._device

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> None:
        self._device.is_using = False
        if error is not None:
            ours = self._transport.failed(error, self._servo_id)
            if ours is not None:
                raise ours from error


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError) and error.errno:  # pyserial wraps the system's words in its own
        return os.strerror(error.errno)
    return str(error) or repr(error)
