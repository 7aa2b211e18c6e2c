"""Faults of servos and wires, one by one, as ``docs/servos.md`` lists what the player does then."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from contextlib import ExitStack, suppress
from dataclasses import replace

import numpy as np
import pytest

from bridge.player.telemetry import read_telemetry
from bridge.ports import connect
from bridge.servo.bus import ServoBus
from bridge.servo.clock import MonotonicClock, VirtualClock
from bridge.servo.lock import PortLock
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import Fault, VirtualSerial, virtual_bus_for
from robots.errors import BusCorrupt, BusError, BusTimeout, PortLost, ServoFault, SpecError
from tests.bridge.player.stage import BRISK, SMALL, Stage, dance, fault_time, states, ticks


def during(kind: str, start: float = 0.3, seconds: float = 9.0, **more) -> Fault:
    """Return a fault in the dance of the few."""
    begin = fault_time(start, SMALL)
    return Fault(kind, start=begin, end=begin + seconds, **more)  # type: ignore[arg-type]


FIRST = SMALL[0].joints[0]
LONG = tuple(dance(robot, duration=3.0) for robot in SMALL)

# -- answers of others, late, twice, in another order ---------------------------------------------


@pytest.mark.parametrize("kind", ["reorder", "duplicate", "stale", "delay", "echo"])
def test_answers_are_matched_by_id_whatever_their_order(kind, tmp_path):
    chance = 1.0 if kind == "echo" else 0.15
    fault = during(kind, 0.0, probability=chance)
    stage, path = Stage(fault, seed=4, robots=SMALL), tmp_path / "t.jsonl"
    performance = stage.play(telemetry=path)
    assert performance.completed
    assert performance.tracking["a"].max_deg < 10
    # Positions are those of their joints: what lags by 40 ms cannot be further off.
    for tick in ticks(path, "a", "PLAY"):
        seen = [p for p in tick["present"] if p is not None]
        goals = [g for g, p in zip(tick["goal"], tick["present"], strict=True) if p is not None]
        np.testing.assert_allclose(seen, goals, atol=0.15)
    assert stage.torques() == [0] * 6


def test_an_adapter_that_echoes_is_lived_with_from_the_first_packet():
    assert Stage(Fault("echo"), robots=SMALL).play().completed


# -- the adapter goes away in the middle of a packet ----------------------------------------------


class Severed(VirtualSerial):
    """A port whose cable is pulled after so many bytes, in either direction."""

    left = 10**9

    def write(self, data: bytes | bytearray | list[int]) -> int:
        whole = bytes(data)
        passed, self.left = whole[: self.left], self.left - len(whole)
        super().write(passed)
        self._require_cable()
        return len(whole)

    def read(self, size: int = 1) -> bytes:
        data = super().read(min(size, max(self.left, 0)))
        self.left -= len(data)
        self._require_cable()
        return data

    def _require_cable(self) -> None:
        if self.left <= 0:
            raise OSError(errno.EIO, "Input/output error")


def test_a_cable_pulled_after_any_byte_of_a_tick_is_a_lost_port_that_can_come_back():
    """Two packets out, one in: whichever byte is the last, nothing else than PortLost comes."""
    robot, clock = SMALL[0], VirtualClock()
    wire = virtual_bus_for(robot, timing=True)
    opened: list[Severed] = []

    def opener(name: str, baud: int) -> Severed:
        opened.append(Severed(wire, clock, baudrate=baud, timeout=0.005))
        return opened[-1]

    bus = ServoBus(
        robot.joints, SdkTransport("/dev/x", robot.buses["main"].baud, opener=opener, clock=clock)
    )
    bus.open()
    bus.identify()
    bus.configure()
    bus.torque_on()

    def tick() -> None:
        bus.write_goals(robot.rest)
        bus.begin_read()
        state = bus.end_read(clock.now())
        assert state.seen.all()
        np.testing.assert_allclose(state.position, robot.rest, atol=0.05)

    tick()
    count = len(robot.joints)
    size = (14 + 5 * count) + (14 + count) + (8 + 14 * count if bus.reads_fast else 21 * count)
    for byte in range(1, size + 1):
        opened[-1].left = byte
        with pytest.raises(PortLost, match="gone away"):
            tick()
        bus.close()
        clock.sleep_until(clock.now() + 0.1)  # a plug is not put back within a packet
        bus.open()
        tick()
    opened[-1].left = size + 1
    tick()


# -- who may play, and with whom ------------------------------------------------------------------


def test_a_second_player_is_refused_while_the_first_one_lives(tmp_path):
    device = tmp_path / "port"
    device.touch()
    code = (
        "import sys; from bridge.servo.lock import PortLock\n"
        "with PortLock(sys.argv[1]): print('mine', flush=True); sys.stdin.read()"
    )
    first = subprocess.Popen(
        [sys.executable, "-c", code, str(device)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert first.stdout is not None
    assert first.stdout.readline() == b"mine\n"

    def second() -> None:
        with ExitStack() as stack:
            connect(SMALL[0], "main", str(device), MonotonicClock(), stack)

    with pytest.raises(PortLost, match=f"in use by process {first.pid}"):
        second()
    first.kill()  # the system takes the lock back
    first.communicate()
    second()
    with suppress(FileNotFoundError):
        PortLock(str(device)).path.unlink()


@pytest.mark.parametrize(
    ("fault", "error", "said"),
    [
        (Fault("clash", servo_id=FIRST.servo.id), BusCorrupt, rf"{FIRST.name}.*share this id"),
        (Fault("baud", servo_id=FIRST.servo.id), BusTimeout, rf"{FIRST.name}.*baud"),
        (Fault("unplug", servo_id=FIRST.servo.id), BusTimeout, rf"{FIRST.name}.*power"),
    ],
    ids=lambda value: value.kind if isinstance(value, Fault) else None,
)
def test_a_bus_that_is_not_the_robots_is_refused_by_name(fault, error, said):
    stage = Stage(fault, robots=SMALL)
    stage.clock.sleep_until(1.0)  # whoever shall be there has started up
    with pytest.raises(error, match=said):
        stage.play()
    assert stage.torques() == [0] * 6
    assert stage.open_ports == 0


def test_old_firmware_plays_without_watchdog_and_says_so(caplog):
    stage = Stage(Fault("firmware", value=30), robots=SMALL)
    assert stage.play().completed
    assert f"no bus watchdog in {SMALL[0].joint_names[0]}" in caplog.text
    assert stage.wires[0].servos[0].get("firmware_version") == 30


# -- what servos suffer ---------------------------------------------------------------------------


def test_a_sagging_supply_ends_the_dance_with_the_joint_and_the_cause(tmp_path):
    path = tmp_path / "t.jsonl"
    stage = Stage(during("brownout", value=8.0), robots=SMALL)
    with pytest.raises(ServoFault, match=r"(input voltage|gets \d\.\d V)"):
        stage.play(telemetry=path)
    assert stage.torques() == [0] * 6
    assert states(path)[-1] == "RELAX"


def test_a_supply_that_breaks_down_leaves_limp_servos_that_are_noticed():
    stage = Stage(during("brownout", seconds=0.05, value=2.0), robots=SMALL)
    with pytest.raises(BusError, match=r"(lost its torque|no answer any more)"):
        stage.play(settings=replace(BRISK, recover_time=1.5))
    assert stage.torques() == [0] * 6


def test_a_blocked_joint_ends_the_dance_before_or_when_it_trips():
    stage = Stage(during("stuck", servo_id=FIRST.servo.id), robots=SMALL)
    settings = replace(BRISK, stray=0.15, stray_time=0.2)
    with pytest.raises(ServoFault, match=FIRST.name):
        stage.play(LONG, settings=settings)
    assert stage.torques() == [0] * 6


def test_a_servo_in_the_heat_is_stopped_before_it_lets_go(tmp_path):
    path = tmp_path / "t.jsonl"
    hot = during("heat", 0.0, servo_id=FIRST.servo.id, value=3000.0)
    stage = Stage(hot, robots=SMALL)
    with pytest.raises(ServoFault, match=rf"{FIRST.name}.*(degC warm|overheating)"):
        stage.play(LONG, telemetry=path, settings=replace(BRISK, health_period=0.05))
    assert stage.torques() == [0] * 6
    warned = [x["what"] for x in read_telemetry(path) if x.get("event") == "unwell"]
    assert any("degC" in what for what in warned)


# -- goals that do not arrive ---------------------------------------------------------------------


def test_a_lost_goal_is_read_back_noted_and_made_up_for(tmp_path):
    path = tmp_path / "t.jsonl"
    stage = Stage(during("deaf", 0.1, 0.8, probability=0.15), seed=3, robots=SMALL)
    performance = stage.play(telemetry=path, settings=replace(BRISK, health_period=0.05))
    assert performance.completed
    lines = read_telemetry(path)
    assert any(x.get("event") == "health" and "goal_position" in x for x in lines)


def test_a_servo_that_takes_no_goals_ends_the_dance_by_name(tmp_path):
    """It hears, answers and holds, but its own position limits refuse what it is sent."""
    stage, path, done = Stage(robots=SMALL), tmp_path / "t.jsonl", []
    servo = stage.wires[0].servos[0]

    def narrow(state: str, share: float) -> None:
        if state == "PLAY" and share > 0.1 and not done:
            done.append(servo.memory.set("max_position_limit", servo.get("goal_position") + 1))
            servo.memory.set("min_position_limit", servo.get("goal_position") - 1)
            servo._reload()

    settings = replace(BRISK, health_period=0.05)
    with pytest.raises(ServoFault, match=rf"{FIRST.name}.*does not take its goals"):
        stage.play(LONG, telemetry=path, on_progress=narrow, settings=settings)
    assert stage.torques() == [0] * 6
    said = [x["what"] for x in read_telemetry(path) if x.get("event") == "unwell"]
    assert said == ["did not get its last goal"]


# -- what the wire allows -------------------------------------------------------------------------


def test_a_rate_beyond_the_wire_is_refused_before_anything_is_opened():
    stage = Stage()
    with pytest.raises(SpecError, match=r"op3.*500 ticks a second to 20 servos.*at most \d+"):
        stage.play(settings=replace(BRISK, rate=500))
    assert [wire.instructions for wire in stage.wires] == [0, 0]


def test_an_adapter_with_a_slow_latency_timer_is_lived_with(tmp_path):
    """16 ms from each question to its answer: ticks are left out, both stay in step."""
    stage, path = Stage(Fault("latency", value=0.016), robots=SMALL), tmp_path / "t.jsonl"
    performance = stage.play(telemetry=path)
    assert performance.completed
    assert performance.dropped_ticks >= 3
    a, b = (ticks(path, person) for person in "ab")
    assert [x["phase"] for x in a] == [x["phase"] for x in b]
