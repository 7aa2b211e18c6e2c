"""A Dynamixel bus without hardware: servos, wire, faults, and front ends that serve them."""

from bridge.virtual.build import virtual_bus_for as virtual_bus_for
from bridge.virtual.bus import VirtualBus as VirtualBus
from bridge.virtual.faults import Fault as Fault
from bridge.virtual.faults import FaultPlan as FaultPlan
from bridge.virtual.pty import PtyServer as PtyServer
from bridge.virtual.serial import VirtualSerial as VirtualSerial
from bridge.virtual.servo import VirtualServo as VirtualServo
