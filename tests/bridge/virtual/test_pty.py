"""The unmodified SDK, and the player, over a real pseudo-terminal in real time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import dynamixel_sdk as sdk
import numpy as np
import pytest

from bridge.player import PlayerSettings, Verdict, play
from bridge.player.telemetry import read_telemetry
from bridge.servo.lock import PortLock
from bridge.trajectory import JointTrajectory
from bridge.virtual import PtyServer, virtual_bus_for
from bridge.virtual.process import virtual_port
from robots.errors import PortLost
from robots.registry import load_robot
from tests.bridge.virtual.patience import PatientPort

pytestmark = pytest.mark.realtime

ROBOT = load_robot("marionette")
BAUD = ROBOT.buses["main"].baud
IDS = [joint.servo.id for joint in ROBOT.joints]


@pytest.fixture
def link(tmp_path):
    """The link to a virtual bus on a pseudo-terminal."""
    link = tmp_path / "puppet"
    with PtyServer(virtual_bus_for(ROBOT), link=link) as server:
        yield link
        server.close()
    assert not link.is_symlink()


@pytest.fixture
def port(link):
    """A port of the SDK, opened on the virtual bus by its link."""
    handler = PatientPort(str(link), BAUD)
    assert handler.openPort()
    yield handler
    handler.closePort()


def eventually(true, seconds=10.0):
    """Return whether something comes true within a time that no busy computer exceeds."""
    limit = time.monotonic() + seconds
    while not (held := true()) and time.monotonic() < limit:
        time.sleep(0.01)
    return held


def test_the_sdks_own_patience_is_enough(link):
    """34 ms of the wall clock: on a busy computer its user asks again, and so does this test."""
    handler = sdk.PortHandler(str(link))
    handler.baudrate = BAUD
    assert handler.openPort()
    ping = sdk.PacketHandler(2.0).ping
    assert any(ping(handler, IDS[0]) == (1200, 0, 0) for _ in range(20))
    handler.closePort()


def test_the_unmodified_sdk_pings_reads_and_writes(port):
    packet = sdk.PacketHandler(2.0)
    assert packet.ping(port, IDS[0]) == (1200, 0, 0)
    assert packet.ping(port, 99)[1] == sdk.COMM_RX_TIMEOUT
    assert packet.write1ByteTxRx(port, IDS[0], 64, 1) == (0, 0)
    assert packet.read1ByteTxRx(port, IDS[0], 64) == (1, 0, 0)
    assert packet.write1ByteTxRx(port, IDS[0], 11, 4) == (0, 7)  # EEPROM under torque
    assert packet.write4ByteTxRx(port, IDS[0], 116, 5000) == (0, 6)  # beyond the limit
    found, result = packet.broadcastPing(port)
    assert result == 0
    assert sorted(found or ()) == sorted(IDS)


def test_the_unmodified_sdk_streams_to_all_servos(port):
    packet = sdk.PacketHandler(2.0)
    write = sdk.GroupSyncWrite(port, packet, 116, 4)
    read = sdk.GroupSyncRead(port, packet, 132, 4)
    goals = {}
    for servo_id in IDS:
        packet.write1ByteTxRx(port, servo_id, 64, 1)
        goals[servo_id] = packet.read4ByteTxRx(port, servo_id, 132)[0] + 20
        write.addParam(servo_id, list(goals[servo_id].to_bytes(4, "little")))
        read.addParam(servo_id)
    assert write.txPacket() == 0
    time.sleep(0.6)
    for transfer in (read.txRxPacket, read.fastSyncRead):
        assert transfer() == 0
        for servo_id in IDS:
            assert abs(read.getData(servo_id, 132, 4) - goals[servo_id]) <= 2


def test_a_client_at_the_wrong_rate_hears_nothing(port):
    packet = sdk.PacketHandler(2.0)
    port.setBaudRate(57600)
    assert packet.ping(port, IDS[0])[1] == sdk.COMM_RX_TIMEOUT
    port.setBaudRate(BAUD)
    assert packet.ping(port, IDS[0])[1] == 0


def test_a_link_does_not_replace_a_file(tmp_path):
    path = tmp_path / "precious"
    path.write_text("data")
    with pytest.raises(PortLost, match="precious"):
        PtyServer(virtual_bus_for(ROBOT), link=path)
    assert path.read_text() == "data"


def test_a_bus_in_its_own_process_ends_with_its_user():
    with virtual_port(ROBOT, "main") as port:
        handler = PatientPort(port, BAUD)
        assert handler.openPort()
        assert sdk.PacketHandler(2.0).ping(handler, IDS[0])[:2] == (1200, 0)
        handler.closePort()
    assert eventually(lambda: not os.path.exists(port))


def test_a_duet_on_two_pseudo_terminals_keeps_real_time():
    times = np.arange(0, 1.5 + 1e-9, 0.02)
    room = np.minimum(ROBOT.upper - ROBOT.rest, ROBOT.rest - ROBOT.lower)
    wave = np.sin(3 * times)[:, None] * np.minimum(0.3, 0.8 * room)
    trajectory = JointTrajectory(times, ROBOT.rest + wave, ROBOT.joint_names, ROBOT.name)
    settings = PlayerSettings(
        rate=50,
        ramp_time=0.3,
        settle_time=0.1,
        max_stall=5,
        watchdog=0,
        lost_reads=500,
        soft_time=0.1,
        relax_time=0.1,
    )
    performance = play(
        (trajectory, trajectory), (ROBOT, ROBOT), gate=Verdict(passed=True), settings=settings
    )
    assert performance.completed
    assert performance.duration == pytest.approx(1.5, abs=0.5)
    for person in "ab":
        tracking = performance.tracking[person]
        assert 0.05 < tracking.rms_deg < 5
        assert tracking.missed_reads < 0.2 * performance.ticks * len(IDS)


PLAYER = """
import signal, sys
import numpy as np
from bridge.player import Verdict, PlayerSettings, StopRequest, play
from bridge.trajectory import JointTrajectory
from robots.registry import load_robot

robot = load_robot("marionette")
times = np.arange(0, 30, 0.02)
wave = 0.1 * np.sin(times)[:, None] * np.minimum(robot.upper - robot.rest, robot.rest - robot.lower)
dance = JointTrajectory(times, robot.rest + wave, robot.joint_names, robot.name)
stop = StopRequest()
signal.signal(signal.SIGINT, lambda *_: stop.set())
settings = PlayerSettings(
    rate=50, ramp_time=0.2, hold_time=0.1, max_stall=5, watchdog=0, lost_reads=500,
    soft_time=0.1, relax_time=0.1,
)
def progress(state, share):
    if state == "PLAY" and share > 0.005:
        print("dancing", flush=True)
outcome = play((dance, dance), (robot, robot), gate=Verdict(True), settings=settings, stop=stop,
               on_progress=progress, telemetry=sys.argv[1]).outcome
print("outcome", outcome, flush=True)
"""


def test_ctrl_c_in_a_terminal_stops_the_player_not_its_bus(tmp_path):
    """The terminal sends it to the whole process group; the virtual buses must outlive it."""
    path = tmp_path / "t.jsonl"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    player = subprocess.Popen(
        [sys.executable, "-c", PLAYER, str(path)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert player.stdout is not None
    assert player.stdout.readline() == "dancing\n"
    os.killpg(player.pid, signal.SIGINT)
    rest, _ = player.communicate(timeout=30)
    assert rest.splitlines()[-1] == "outcome stopped"
    states = [line["state"] for line in read_telemetry(path) if line.get("event") == "state"]
    assert states[-3:] == ["PLAY", "HOLD", "RELAX"]


def test_a_second_owner_of_a_port_is_refused(tmp_path):
    """In another process, as two players would be; links to one device are one port."""
    device, link = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.write_text("")
    link.symlink_to(device)
    code = (
        "import sys; from bridge.servo.lock import PortLock; from robots.errors import PortLost\n"
        "try:\n"
        "    with PortLock(sys.argv[1], folder=sys.argv[2]): print('got it')\n"
        "except PortLost as error: print(error)"
    )
    command = [sys.executable, "-c", code, str(link), str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}

    def other() -> str:
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=True
        ).stdout

    with PortLock(str(device), folder=tmp_path):
        assert f"in use by process {os.getpid()}" in other()
    assert "got it" in other()
