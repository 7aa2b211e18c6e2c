"""Without POSIX terminals and file locks, as on Windows, everything but the pty works."""

from __future__ import annotations

import subprocess
import sys

SESSION = """
import sys

import serial, subprocess, tempfile  # these do without on Windows, not here

for name in ("termios", "tty", "pty", "fcntl"):
    sys.modules[name] = None

import bridge.cli.main, bridge.cli.jog, bridge.cli.scan, bridge.ports, bridge.player
import bridge.setup.line, bridge.virtual.process
from bridge.servo.clock import VirtualClock
from bridge.servo.registers import control_table
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import VirtualBus, VirtualSerial, VirtualServo
from robots.errors import PortLost
from robots.registry import load_robot

clock = VirtualClock(1.0)
bus = VirtualBus([VirtualServo(control_table("XL330-M288"), 4, baud_index=3)])
wire = SdkTransport(
    "COM3", 1_000_000, clock=clock,
    opener=lambda port, baud: VirtualSerial(bus, clock, baudrate=baud, timeout=0.005),
)
wire.open()
assert wire.ping(4) == 1200
wire.close()
try:
    with bridge.virtual.process.virtual_port(load_robot("marionette"), "main"):
        raise SystemExit("a pty without pseudo-terminals")
except PortLost as error:
    assert "no pseudo-terminals" in str(error) and "VirtualSerial" in str(error), error
print("served")
"""


def test_a_session_in_one_process_needs_no_terminals():
    done = subprocess.run(
        [sys.executable, "-c", SESSION], capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == "served", done.stderr[-2000:]
