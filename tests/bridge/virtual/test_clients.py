"""Clients that others wrote, unmodified, on the virtual bus over a pseudo-terminal."""

from __future__ import annotations

import subprocess
import sys
import time

import dynamixel_sdk as sdk
import pytest

from bridge.virtual import PtyServer, virtual_bus_for
from robots.registry import load_robot
from tests.bridge.virtual.patience import PatientPort

ROBOT = load_robot("marionette")
BAUD = ROBOT.buses["main"].baud
IDS = [joint.servo.id for joint in ROBOT.joints]
MODEL = 1200
TORQUE_ENABLE, PROFILE_VELOCITY, GOAL_POSITION, PRESENT_POSITION = 64, 112, 116, 132


@pytest.fixture
def wire():
    """A virtual bus on a pseudo-terminal, and its port."""
    bus = virtual_bus_for(ROBOT)
    with PtyServer(bus) as server:
        yield bus, server.port


@pytest.fixture
def port(wire):
    """A port of the SDK."""
    handler = PatientPort(wire[1], BAUD, patience=2000)
    assert handler.openPort()
    yield handler
    handler.closePort()


def test_the_sdks_bulk_classes_read_and_write_different_registers(port):
    packet = sdk.PacketHandler(2.0)
    write, read = sdk.GroupBulkWrite(port, packet), sdk.GroupBulkRead(port, packet)
    assert write.addParam(IDS[0], PROFILE_VELOCITY, 4, [7, 0, 0, 0])
    assert write.addParam(IDS[1], TORQUE_ENABLE, 1, [1])
    assert write.txPacket() == sdk.COMM_SUCCESS
    assert read.addParam(IDS[0], PROFILE_VELOCITY, 4)
    assert read.addParam(IDS[1], TORQUE_ENABLE, 1)
    for transfer in (read.txRxPacket, read.fastBulkRead):
        assert transfer() == sdk.COMM_SUCCESS
        assert read.getData(IDS[0], PROFILE_VELOCITY, 4) == 7
        assert read.getData(IDS[1], TORQUE_ENABLE, 1) == 1


def test_the_sdks_registered_writes_wait_for_the_action(port):
    packet = sdk.PacketHandler(2.0)
    for servo_id in IDS[:2]:
        written = packet.regWriteTxRx(port, servo_id, PROFILE_VELOCITY, 4, [9, 0, 0, 0])
        assert written == (sdk.COMM_SUCCESS, 0)
    before = [packet.read4ByteTxRx(port, servo, PROFILE_VELOCITY)[0] for servo in IDS[:2]]
    assert 9 not in before
    assert packet.action(port, sdk.BROADCAST_ID) == sdk.COMM_SUCCESS
    after = [packet.read4ByteTxRx(port, servo, PROFILE_VELOCITY)[0] for servo in IDS[:2]]
    assert after == [9, 9]


def test_the_sdks_sync_classes_stream_plain_and_fast(port):
    packet = sdk.PacketHandler(2.0)
    write = sdk.GroupSyncWrite(port, packet, PROFILE_VELOCITY, 4)
    read = sdk.GroupSyncRead(port, packet, PROFILE_VELOCITY, 4)
    for servo_id in IDS:
        assert read.addParam(servo_id)
    for value, transfer in ((11, read.txRxPacket), (12, read.fastSyncRead)):
        write.clearParam()
        for servo_id in IDS:
            assert write.addParam(servo_id, [value, 0, 0, 0])
        assert write.txPacket() == sdk.COMM_SUCCESS
        assert transfer() == sdk.COMM_SUCCESS
        assert {read.getData(servo, PROFILE_VELOCITY, 4) for servo in IDS} == {value}


def test_rustypot_finds_configures_reads_writes_and_streams(wire):
    rustypot = pytest.importorskip("rustypot")
    client = rustypot.Xl330PyController(wire[1], BAUD, 2.0)
    try:
        assert client.ping(IDS[0])
        found: dict[int, int] = {}
        for _ in range(50):  # a scan waits a few milliseconds for each, whatever the timeout
            if len(found) == len(IDS):
                break
            found |= client.scan([servo_id for servo_id in IDS if servo_id not in found])
        assert found == dict.fromkeys(IDS, MODEL)
        client.write_raw_data(IDS[0], TORQUE_ENABLE, [1])
        assert list(client.read_raw_data(IDS[0], TORQUE_ENABLE, 1)) == [1]
        _, error = client.read_raw_data_with_error(IDS[0], TORQUE_ENABLE, 1)
        assert error == 0
        assert client.write_raw_data_with_error(IDS[0], 11, [4]) == 7  # EEPROM under torque
        goals = [[k, 8, 0, 0] for k in range(len(IDS))]
        for fast in (False, True):
            client.set_fast_sync_read(fast)
            client.sync_write_raw_data(IDS, GOAL_POSITION, goals)
            read = client.sync_read_raw_data(IDS, GOAL_POSITION, 4)
            assert [list(row) for row in read] == goals
            assert len(client.sync_read_raw_data(IDS, PRESENT_POSITION, 4)) == len(IDS)
    finally:
        client.close()


LEROBOT = (
    "lerobot==0.4.4",
    "dynamixel-sdk==3.8.4",
    "pyserial",
    "deepdiff<9",
    "orderly-set",
    "tqdm",
)
LEROBOT_CLIENT = """
import sys, types

# lerobot's helpers import these at the top; its motor bus uses none of them.
for name, attributes in (
    ("torch", ("device", "dtype")), ("accelerate", ("Accelerator",)), ("datasets", ()),
    ("datasets.utils", ()),
    ("datasets.utils.logging", ("disable_progress_bar", "enable_progress_bar")),
):
    sys.modules[name] = types.ModuleType(name)
    for attribute in attributes:
        setattr(sys.modules[name], attribute, type(attribute, (), {}))

from lerobot.motors import Motor, MotorNormMode
from lerobot.motors.dynamixel import DynamixelMotorsBus, OperatingMode

port, baud, ids = sys.argv[1], int(sys.argv[2]), [int(text) for text in sys.argv[3].split(",")]
motors = {f"joint_{i}": Motor(i, "xl330-m288", MotorNormMode.DEGREES) for i in ids}
bus = DynamixelMotorsBus(port, motors)
bus.connect(handshake=False)
bus.set_baudrate(baud)
# Longer than 34 ms: this computer may be busy with other tests.
patient = bus.port_handler.setPacketTimeoutMillis
bus.port_handler.setPacketTimeout = lambda packet_length: patient(3000)
assert bus.broadcast_ping(num_retry=5) == dict.fromkeys(ids, 1200)
bus._handshake()
bus.disable_torque()
bus.configure_motors()
for motor in motors:
    bus.write("Operating_Mode", motor, OperatingMode.POSITION.value)
here = bus.sync_read("Present_Position", normalize=False)
bus.sync_write("Goal_Position", here, normalize=False)
bus.enable_torque()
for _ in range(10):
    bus.sync_write("Goal_Position", here, normalize=False)
    there = bus.sync_read("Present_Position", normalize=False)
    assert all(abs(there[motor] - here[motor]) < 5 for motor in motors), (here, there)
assert bus.read("Torque_Enable", next(iter(motors)), normalize=False) == 1
bus.disconnect()
print("danced")
"""


@pytest.mark.slow
def test_lerobot_finds_configures_reads_writes_and_streams(wire, tmp_path):
    python = tmp_path / "venv" / "bin" / "python"
    folder = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    install += ["--no-deps", "--no-compile", "numpy", *LEROBOT]
    installed = subprocess.run(install, capture_output=True, text=True, check=False)
    if installed.returncode:
        pytest.skip(f"pip cannot install lerobot: {installed.stderr.strip()[-200:]}")
    ids = ",".join(str(servo_id) for servo_id in IDS)
    client = subprocess.run(
        [str(python), "-c", LEROBOT_CLIENT, wire[1], str(BAUD), ids],
        capture_output=True,
        text=True,
        check=False,
    )
    assert client.stdout.strip().endswith("danced"), client.stderr[-2000:]
    time.sleep(0.1)
    assert [servo.get("torque_enable") for servo in wire[0].servos] == [0] * len(IDS)
