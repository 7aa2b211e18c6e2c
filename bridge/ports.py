"""From a port's name to something that servos answer on: a real port, or the virtual bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack

from bridge.servo.clock import Clock
from bridge.servo.lock import PortLock
from bridge.servo.rustypot_transport import RustypotTransport
from bridge.servo.sdk_transport import SdkTransport
from bridge.servo.transport import Transport
from bridge.virtual.plant import SERVO
from bridge.virtual.process import virtual_port
from robots.errors import SpecError, nearest
from robots.spec import RobotSpec

VIRTUAL = "virtual"
"""Port name that stands for a virtual bus made for the occasion."""

TRANSPORTS = ("sdk", "rustypot")
"""Clients of the servo wire: the maker's (the default), or an optional one in compiled code."""

Ports = str | Mapping[str, str]
"""Port of a robot: one name, or one per bus."""

Connect = Callable[[RobotSpec, str, str, Clock, ExitStack], Transport]
"""Returns the transport for (robot, bus, port); what must be closed goes on the stack."""


def ports_of(robot: RobotSpec, ports: Ports) -> dict[str, str]:
    """Return the port of each bus of a robot.

    Raises:
        SpecError: A bus has no port, a port no bus, or one real port is given for several buses.
    """
    if isinstance(ports, str):
        if ports != VIRTUAL and len(robot.buses) > 1:
            raise SpecError(
                f"{robot.name} has {len(robot.buses)} buses", allowed="one port for each bus"
            )
        return dict.fromkeys(robot.buses, ports)
    for name in ports:
        if name not in robot.buses:
            raise SpecError(
                f"{robot.name} has no bus '{name}'",
                allowed=", ".join(robot.buses),
                hint=nearest(name, robot.buses),
            )
    missing = [name for name in robot.buses if name not in ports]
    if missing:
        raise SpecError(f"no port for bus {', '.join(missing)}", where=robot.name)
    return dict(ports)


def connect(
    robot: RobotSpec,
    bus: str,
    port: str,
    clock: Clock,
    stack: ExitStack,
    *,
    plant: str = SERVO,
    transport: str = TRANSPORTS[0],
) -> Transport:
    """Return the transport for a port, locked for us; ``virtual`` starts a bus on a pty.

    Args:
        robot: The robot.
        bus: Name of its bus.
        port: Device file, or ``virtual``.
        clock: Gives the time and waits.
        stack: What must be closed goes on it.
        plant: What moves behind a virtual port, one of :data:`~bridge.virtual.plant.PLANTS`.
        transport: Client that speaks to the servos, one of :data:`TRANSPORTS`.

    Raises:
        PortLost: The port is taken, or there are no pseudo-terminals.
        SpecError: The bus does not speak Protocol 2.0, the plant is none for the robot, or the
            transport is unknown or not installed.
    """
    spec = robot.buses[bus]
    if transport not in TRANSPORTS:
        raise SpecError(f"transport '{transport}'", allowed=", ".join(TRANSPORTS))
    if port == VIRTUAL:
        port = stack.enter_context(virtual_port(robot, bus, plant))
    else:
        stack.enter_context(PortLock(port))
    if spec.protocol != 2.0:
        raise SpecError(
            f"protocol {spec.protocol}", where=f"{robot.name}: bus.{bus}", allowed="2.0"
        )
    if transport == "rustypot":
        return RustypotTransport(port, spec.baud, clock=clock)
    return SdkTransport(port, spec.baud, clock=clock)
