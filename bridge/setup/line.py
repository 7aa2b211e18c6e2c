"""A serial line before anybody knows what hangs on it: any bit rate, any servo."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

from bridge.ports import VIRTUAL
from bridge.servo import protocol1
from bridge.servo.access import RegisterAccess
from bridge.servo.clock import Clock, MonotonicClock
from bridge.servo.lock import PortLock
from bridge.servo.packets import STATUS, Packet, Parser
from bridge.servo.sdk_transport import SdkTransport
from bridge.servo.serial_port import PORT_ERRORS, OpenSerial, SerialPort, open_serial
from bridge.virtual.process import virtual_port
from robots.errors import PortLost, SpecError, nearest
from robots.spec import JointSpec, RobotSpec, ServoSpec


@dataclass(frozen=True, slots=True)
class Heard:
    """What came back after one instruction."""

    answers: tuple[Packet, ...]
    """Intact status packets; of Protocol 1.0 as they would be in 2.0, the error in front."""
    garbled: bool
    """Whether bytes came that belong to no packet."""
    echo: bool
    """Whether our own instruction came back: an adapter that hears itself."""


@dataclass(frozen=True, slots=True)
class Line:
    """One port that can be opened at any bit rate."""

    port: str
    """Device file."""
    opener: OpenSerial = open_serial
    """Opens it."""
    clock: Clock = field(default_factory=MonotonicClock)
    """For time limits."""

    @contextmanager
    def raw(self, baud: int) -> Iterator[SerialPort]:
        """Yield the port, open at ``baud`` bit/s, for :meth:`exchange`.

        Raises:
            PortLost: It cannot be opened, or went away meanwhile.
        """
        try:
            device = self.opener(self.port, baud)
        except (*PORT_ERRORS, ValueError) as error:
            raise PortLost(
                f"cannot be opened at {baud} bit/s: {error}",
                where=self.port,
                hint="is the adapter plugged in, and may you use it? ask pasdedeux doctor",
            ) from error
        try:
            yield device
        except PORT_ERRORS as error:
            raise PortLost(
                f"has gone away: {error}", where=self.port, hint="check cable and adapter"
            ) from error
        finally:
            with suppress(*PORT_ERRORS):
                device.close()

    def exchange(
        self, device: SerialPort, packet: bytes, wait: float, *, protocol: int = 2
    ) -> Heard:
        """Send an instruction and listen until the line is silent for ``wait`` s."""
        device.reset_input_buffer()
        device.write(packet)
        received = bytearray()
        end = self.clock.now() + wait
        while self.clock.now() < end:
            data = device.read(max(1, device.in_waiting))
            if data:
                received += data
                end = self.clock.now() + wait
        return _heard_1(received, packet) if protocol == 1 else _heard_2(received)

    def transport(self, baud: int) -> SdkTransport:
        """Return a transport, still closed, at ``baud`` bit/s."""
        return SdkTransport(self.port, baud, opener=self.opener, clock=self.clock)

    @contextmanager
    def servo(self, servo_id: int, model: str, baud: int) -> Iterator[RegisterAccess]:
        """Yield the registers of a single servo, whatever it may move one day.

        Raises:
            SpecError: There is no control table for the model.
            PortLost: The port cannot be opened.
        """
        servo = ServoSpec(id=servo_id, model=model, bus="main")
        joint = JointSpec("servo", -1.0, 1.0, 0.0, 1.0, 1.0, servo)
        transport = self.transport(baud)
        transport.open()
        try:
            yield RegisterAccess([joint], transport)
        finally:
            transport.close()


def _heard_2(received: bytearray) -> Heard:
    parser = Parser()
    found = parser.feed(received)
    parser.reset()
    answers = tuple(packet for packet in found if packet.code == STATUS)
    return Heard(answers, parser.dropped > 0, len(answers) < len(found))


def _heard_1(received: bytearray, sent: bytes) -> Heard:
    """Return what was heard in Protocol 1.0, whose answers carry no mark: an echo comes first."""
    echo = received.startswith(sent)
    parser = protocol1.Parser()
    found = parser.feed(received[len(sent) if echo else 0 :])
    parser.reset()
    answers = tuple(
        Packet(each.servo_id, STATUS, bytes((each.code,)) + each.params, each.size)
        for each in found
        if each.intact
    )
    return Heard(answers, parser.dropped > 0, echo)


@contextmanager
def line_of(port: str, robot: RobotSpec, bus: str | None = None) -> Iterator[Line]:
    """Yield the line of a port, locked for us; ``virtual`` starts the robot's bus on a pty.

    Raises:
        PortLost: The port is taken, or there are no pseudo-terminals.
        SpecError: The robot has several buses and none, or an unknown one, was named.
    """
    if port != VIRTUAL:
        with PortLock(port):
            yield Line(port)
        return
    with virtual_port(robot, bus_name(robot, bus)) as path:
        yield Line(path)


def bus_name(robot: RobotSpec, bus: str | None) -> str:
    """Return the name of the one bus, or of the bus that was meant.

    Raises:
        SpecError: There are several and none was named, or it is not there.
    """
    if bus is None and len(robot.buses) == 1:
        return next(iter(robot.buses))
    if bus is None or bus not in robot.buses:
        raise SpecError(
            f"{robot.name} has no bus '{bus}'" if bus else f"{robot.name} has several buses",
            allowed="--bus " + ", ".join(robot.buses),
            hint=nearest(bus or "", robot.buses),
        )
    return bus
