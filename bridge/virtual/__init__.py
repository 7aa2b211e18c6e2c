"""A Dynamixel bus without hardware: servos, wire, faults, and front ends that serve them.

All but the pseudo-terminal runs on any system: :class:`PtyServer` is loaded when it is asked for.
"""

from typing import TYPE_CHECKING, Any

from bridge.virtual.build import virtual_bus_for as virtual_bus_for
from bridge.virtual.bus import VirtualBus as VirtualBus
from bridge.virtual.faults import Fault as Fault
from bridge.virtual.faults import FaultPlan as FaultPlan
from bridge.virtual.serial import VirtualSerial as VirtualSerial
from bridge.virtual.servo import VirtualServo as VirtualServo
from robots.errors import PortLost

if TYPE_CHECKING:
    from bridge.virtual.pty import PtyServer as PtyServer


def __getattr__(name: str) -> Any:
    """Load the pseudo-terminal front end.

    Raises:
        PortLost: This system has no pseudo-terminals.
    """
    if name != "PtyServer":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        from bridge.virtual.pty import PtyServer
    except ImportError as error:
        raise PortLost(
            "this system has no pseudo-terminals",
            where="virtual bus",
            hint="VirtualSerial serves a bus within one process, on any system",
        ) from error
    return PtyServer
