"""The optional transport in compiled code, over a pseudo-terminal in real time."""

from __future__ import annotations

import sys
from contextlib import ExitStack

import numpy as np
import pytest

from bridge import stages
from bridge.ports import TRANSPORTS, connect
from bridge.servo.bus import ServoBus
from bridge.servo.clock import MonotonicClock
from bridge.servo.rustypot_transport import RustypotTransport
from bridge.virtual import Fault, FaultPlan, PtyServer, virtual_bus_for
from robots.errors import BusTimeout, PortLost, ServoFault, SpecError
from robots.registry import load_robot

ROBOT = load_robot("marionette")
BAUD = ROBOT.buses["main"].baud
IDS = [joint.servo.id for joint in ROBOT.joints]
COUNT = len(IDS)
GOAL_POSITION = 116


def test_it_is_refused_where_it_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "rustypot", None)
    with pytest.raises(SpecError, match=r"pasdedeux\[rustypot\]"):
        RustypotTransport("/dev/ttyUSB0", BAUD)


def test_an_unknown_transport_is_refused_before_anything_is_opened():
    with ExitStack() as stack, pytest.raises(SpecError, match="sdk, rustypot"):
        connect(ROBOT, "main", "virtual", MonotonicClock(), stack, transport="carrier pigeon")


def test_the_stages_offer_the_transports_there_are():
    assert stages.TRANSPORTS == TRANSPORTS


class TestInstalled:
    @pytest.fixture(autouse=True)
    def package(self):
        pytest.importorskip("rustypot")

    def transport(self, port: str, patience: float = 2.0) -> RustypotTransport:
        """Patient, because the server shares this process and its computer."""
        return RustypotTransport(port, BAUD, patience=patience)

    def test_a_robot_is_armed_moved_and_read_through_it(self):
        wire = virtual_bus_for(ROBOT)
        with PtyServer(wire) as server:
            bus = ServoBus(ROBOT.joints, self.transport(server.port))
            bus.open()
            bus.identify()
            bus.configure()
            goal = bus.hold_present(0.1)
            bus.torque_on()
            bus.write_goals(goal)
            for _ in range(2):
                bus.begin_read()
                state = bus.end_read(1.0)
                assert state.seen.all()
                np.testing.assert_allclose(state.position, goal, atol=0.01)
            assert bus.torque_off() == []
            bus.close()
            bus.close()

    def test_goals_that_need_byte_stuffing_arrive(self):
        wire = virtual_bus_for(ROBOT)
        wire.servos[0].memory.set("operating_mode", 4)
        with PtyServer(wire) as server:
            transport = self.transport(server.port)
            transport.open()
            goal = np.array([[255, 255, 253, 255]], np.uint8)
            transport.sync_write(GOAL_POSITION, IDS[:1], goal)
            assert transport.read(IDS[0], GOAL_POSITION, 4) == (0, goal.tobytes())
            transport.close()

    def test_what_goes_wrong_is_one_of_our_errors(self):
        with PtyServer(virtual_bus_for(ROBOT)) as server:
            transport = self.transport(server.port)
            with pytest.raises(PortLost, match="not open"):
                transport.ping(IDS[0])
            transport.open()
            assert transport.ping(IDS[0]) == 1200
            with pytest.raises(ServoFault, match="limit"):
                transport.write(IDS[0], GOAL_POSITION, (5000).to_bytes(4, "little"))
            impatient = self.transport(server.port, patience=0.02)
            transport.close()
            impatient.open()
            with pytest.raises(BusTimeout, match="servo 99"):
                impatient.read(99, 0, 2)
            server.close()
            with pytest.raises(PortLost, match="gone away"):
                impatient.read(IDS[0], 0, 2)
            with pytest.raises(PortLost, match="gone away"):
                impatient.sync_write(GOAL_POSITION, IDS[:1], np.zeros((1, 4), np.uint8))
            impatient.close()
        with pytest.raises(PortLost, match="cannot be opened"):
            self.transport("/dev/does-not-exist").open()

    @pytest.mark.realtime
    @pytest.mark.parametrize("fast", [False, True])
    def test_a_silent_servo_hides_the_others_in_a_fast_read_alone(self, fast, monkeypatch):
        monkeypatch.setattr("bridge.servo.rustypot_transport.ALONE_LIMIT", 60.0)
        faults = FaultPlan([Fault("silence", servo_id=IDS[2])], seed=0)
        with PtyServer(virtual_bus_for(ROBOT, faults=faults)) as server:
            transport = self.transport(server.port, patience=0.5)
            transport.open()
            transport.sync_read_begin(0, 2, IDS, fast=fast)
            answer = transport.sync_read_end()
            transport.close()
        if fast:
            assert not answer.seen.any()
        else:
            assert answer.seen.tolist() == [True] * 2 + [False] + [True] * (COUNT - 3)
            assert (answer.data[answer.seen] == [1200 & 255, 1200 >> 8]).all()
