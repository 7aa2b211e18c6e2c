"""An adapter that is pulled out of the computer and plugged in again, as a terminal."""

from __future__ import annotations

import os
import time

import pytest
import serial

from bridge.servo import packets
from bridge.servo.packets import instruction
from bridge.servo.registers import control_table
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import Fault, FaultPlan, PtyServer, VirtualBus, VirtualServo
from robots.errors import BusError, PortLost

XM430 = control_table("XM430-W350")
pytestmark = pytest.mark.realtime
PATIENCE = 20.0
"""s; a busy machine needs longer than the faults do."""


def server(link, *faults: Fault) -> PtyServer:
    return PtyServer(VirtualBus([VirtualServo(XM430, 1)], faults=FaultPlan(faults)), link=link)


def wait_for(condition) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def talk_for_ever(client: serial.Serial) -> None:
    while True:
        client.read(100)
        client.write(b"x")


def ping(port: str) -> int:
    transport = SdkTransport(port, 57600, patience=PATIENCE)
    transport.open()
    try:
        return transport.ping(1)
    finally:
        transport.close()


def test_an_unplugged_adapter_hangs_up_and_comes_back_under_its_link(tmp_path):
    link = tmp_path / "adapter"
    with server(link) as served:
        assert ping(str(link)) == XM430.number
        client = serial.Serial(served.path, 57600, timeout=PATIENCE)
        now = time.monotonic() - served.bus.faults.origin
        served.bus.faults.faults.append(Fault("unplug", now, now + 0.3))
        client.write(instruction(1, packets.PING))  # wakes the server
        with pytest.raises((serial.SerialException, OSError)):
            talk_for_ever(client)
        wait_for(link.is_symlink)
        assert ping(str(link)) == XM430.number
        client.close()


@pytest.mark.parametrize("start", [0.0, 0.2])
def test_nothing_has_to_be_sent_for_the_adapter_to_go_and_come(tmp_path, start):
    link = tmp_path / "adapter"
    with server(link, Fault("unplug", start)) as served:
        wait_for(lambda: not os.path.lexists(link))
        with pytest.raises(PortLost, match="adapter"):
            ping(str(link))
        plan = served.bus.faults
        plan.faults[0] = Fault("unplug", start, time.monotonic() - plan.origin)
        wait_for(link.is_symlink)
        assert ping(str(link)) == XM430.number


def test_an_adapter_that_stays_away_leaves_nothing_behind(tmp_path):
    link = tmp_path / "adapter"
    with server(link, Fault("unplug", 0.1)):
        wait_for(lambda: not os.path.lexists(link))
    assert not os.path.lexists(link)


def test_faults_count_from_the_moment_the_server_is_made(tmp_path):
    before = time.monotonic()
    with server(tmp_path / "adapter", Fault("silence", 0.0, 3600.0)) as served:
        assert before <= served.bus.faults.origin <= time.monotonic()
        transport = SdkTransport(served.port, 57600)
        transport.open()
        with pytest.raises(BusError):
            transport.ping(1)
        transport.close()
