"""AX, MX (1.0) and XL-320: their registers, and Protocol 1.0 spoken by the maker's own client."""

from __future__ import annotations

import math

import dynamixel_sdk as sdk
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.servo import packets
from bridge.servo import protocol1 as p1
from bridge.servo.clock import VirtualClock
from bridge.servo.registers import control_table
from bridge.virtual import VirtualBus, VirtualSerial, VirtualServo

AX, MX, X = (control_table(name) for name in ("AX-12A", "MX-28(1.0)", "XM430-W350"))
XL320 = control_table("XL320")


class ClockedPort(sdk.PortHandler):
    """The SDK's port over a virtual bus in virtual time; everything above it is the SDK's own."""

    def __init__(self, bus: VirtualBus, baud: int = 1_000_000) -> None:
        super().__init__("virtual")
        self.clock = VirtualClock(1.0)
        bus.baud = baud
        self.ser = VirtualSerial(bus, self.clock, baudrate=baud, timeout=0.002)
        self.baudrate, self.is_open = baud, True
        self.tx_time_per_byte = 10_000 / baud

    def getCurrentTime(self) -> float:
        return self.clock.now() * 1e3


def ax(servo_id: int, table=AX) -> VirtualServo:
    return VirtualServo(table, servo_id, baud_index=1)


def write(servo: VirtualServo, name: str, value: int) -> int:
    register = servo.memory.register(name)
    return servo.write(register.address, register.encode(value))


def asked(
    bus: VirtualBus, servo_id: int, code: int, params: bytes = b"", now: float = 1.0
) -> list[p1.Packet]:
    answers = bus.feed(now, p1.packet(servo_id, code, params))
    return p1.Parser().feed(b"".join(data for _, data in answers))


# -- the maker's client ---------------------------------------------------------------------------


def test_the_sdk_pings_reads_and_writes():
    bus = VirtualBus([ax(1), ax(7, MX), ax(253)])
    port, client = ClockedPort(bus), sdk.PacketHandler(1.0)
    assert client.ping(port, 7)[:2] == (29, sdk.COMM_SUCCESS)
    assert client.ping(port, 253) == (12, sdk.COMM_SUCCESS, 0)
    assert client.ping(port, 2)[1] == sdk.COMM_RX_TIMEOUT
    assert client.read1ByteTxRx(port, 1, 43) == (25, sdk.COMM_SUCCESS, 0)
    assert client.write1ByteTxRx(port, 1, 24, 1) == (sdk.COMM_SUCCESS, 0)
    assert client.write2ByteTxRx(port, 1, 30, 700) == (sdk.COMM_SUCCESS, 0)
    port.clock.sleep_until(port.clock.now() + 2.0)
    position, result, error = client.read2ByteTxRx(port, 1, 36)
    assert (result, error) == (sdk.COMM_SUCCESS, 0)
    assert abs(position - 700) <= 1


def test_the_sdk_writes_and_reads_several_at_once():
    bus = VirtualBus([ax(1, MX), ax(2, MX)])
    port, client = ClockedPort(bus), sdk.PacketHandler(1.0)
    assert isinstance(client, sdk.Protocol1PacketHandler)
    writing = sdk.GroupSyncWrite(port, client, 30, 4)
    assert writing.addParam(1, [0, 2, 100, 0])
    assert writing.addParam(2, [0, 3, 50, 0])
    assert writing.txPacket() == sdk.COMM_SUCCESS
    assert [bus.servo(k).get("goal_position") for k in (1, 2)] == [512, 768]
    assert [bus.servo(k).get("moving_speed") for k in (1, 2)] == [100, 50]
    # GroupBulkRead of SDK 4.1 hands Protocol 1.0 an argument too many: what it would call, then.
    asked_for = [2, 1, 30, 3, 2, 0]
    assert client.bulkReadTx(port, asked_for, len(asked_for)) == sdk.COMM_SUCCESS
    assert client.readRx(port, 1, 2) == ([0, 2], sdk.COMM_SUCCESS, 0)
    assert client.readRx(port, 2, 3) == ([29, 0, 40], sdk.COMM_SUCCESS, 0)


def test_the_sdk_registers_acts_and_resets():
    bus = VirtualBus([ax(5)])
    port, client = ClockedPort(bus), sdk.PacketHandler(1.0)
    assert isinstance(client, sdk.Protocol1PacketHandler)
    assert client.action(port, sdk.BROADCAST_ID) == sdk.COMM_SUCCESS
    assert client.regWriteTxRx(port, 5, 30, 2, [44, 1]) == (sdk.COMM_SUCCESS, 0)
    assert bus.servo(5).get("registered_instruction") == 1
    assert bus.servo(5).get("goal_position") == 512
    assert client.action(port, sdk.BROADCAST_ID) == sdk.COMM_SUCCESS
    assert bus.servo(5).get("goal_position") == 300
    assert client.factoryReset(port, 5) == (sdk.COMM_SUCCESS, 0)
    assert bus.servos[0].id == 1


def test_both_protocols_share_a_wire_and_each_servo_hears_its_own():
    bus = VirtualBus([ax(1), VirtualServo(X, 1, baud_index=3), VirtualServo(X, 2, baud_index=3)])
    port = ClockedPort(bus)
    assert sdk.PacketHandler(1.0).ping(port, 1)[:2] == (12, sdk.COMM_SUCCESS)
    assert sdk.PacketHandler(2.0).ping(port, 1)[:2] == (1020, sdk.COMM_SUCCESS)
    assert sdk.PacketHandler(1.0).ping(port, 2)[1] == sdk.COMM_RX_TIMEOUT
    assert sdk.PacketHandler(1.0).read2ByteTxRx(port, 1, 0)[0] == 12


def test_an_x_servo_set_to_protocol_1_speaks_it_and_can_be_set_back():
    bus = VirtualBus([VirtualServo(X, 4, baud_index=3)])
    port = ClockedPort(bus)
    assert sdk.PacketHandler(2.0).write1ByteTxRx(port, 4, 13, 1) == (sdk.COMM_SUCCESS, 0)
    assert sdk.PacketHandler(2.0).ping(port, 4)[1] == sdk.COMM_RX_TIMEOUT
    old = sdk.PacketHandler(1.0)
    assert old.ping(port, 4)[:2] == (1020, sdk.COMM_SUCCESS)
    assert old.read4ByteTxRx(port, 4, 132) == (2048, sdk.COMM_SUCCESS, 0)
    assert old.write1ByteTxRx(port, 4, 13, 2) == (sdk.COMM_SUCCESS, 0)
    assert sdk.PacketHandler(2.0).ping(port, 4)[1] == sdk.COMM_SUCCESS


# -- byte by byte ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "params", "error"),
    [
        (p1.WRITE, bytes((30, 0xFF, 0x07)), p1.ERROR_ANGLE),  # goal beyond the angle limits
        (p1.WRITE, bytes((25, 2)), p1.ERROR_RANGE),
        (p1.WRITE, bytes((36, 0, 0)), p1.ERROR_RANGE),  # read only
        (p1.ACTION, b"", p1.ERROR_INSTRUCTION),  # nothing registered
        (0x08, b"", p1.ERROR_INSTRUCTION),  # no such instruction
        (p1.READ, b"\x00", p1.ERROR_RANGE),
    ],
)
def test_a_refusal_says_why_in_the_error_byte(code, params, error):
    (answer,) = asked(VirtualBus([ax(1)]), 1, code, params)
    assert (answer.servo_id, answer.code, answer.params) == (1, error, b"")


def test_a_wrong_checksum_is_answered_as_such_and_nothing_is_done():
    bus = VirtualBus([ax(1)])
    damaged = bytearray(p1.packet(1, p1.WRITE, bytes((25, 1))))
    damaged[-1] ^= 1
    ((_, answer),) = bus.feed(1.0, bytes(damaged))
    assert p1.Parser().feed(answer)[0].code == p1.ERROR_CHECKSUM
    assert bus.servo(1).get("led") == 0


def test_status_return_level_and_broadcast_keep_servos_quiet():
    bus = VirtualBus([ax(1)])
    assert not asked(bus, p1.BROADCAST, p1.WRITE, bytes((25, 1)))
    assert bus.servo(1).get("led") == 1
    assert len(asked(bus, 1, p1.WRITE, bytes((16, 1)))) == 1
    assert not asked(bus, 1, p1.WRITE, bytes((25, 0)))
    assert len(asked(bus, 1, p1.READ, bytes((25, 1)))) == 1
    asked(bus, 1, p1.WRITE, bytes((16, 0)))
    assert not asked(bus, 1, p1.READ, bytes((25, 1)))
    assert len(asked(bus, 1, p1.PING)) == 1


def test_bulk_read_takes_the_first_request_of_an_id_and_the_ax_is_not_asked():
    bus = VirtualBus([ax(1, MX), ax(2)])
    found = asked(bus, p1.BROADCAST, p1.BULK_READ, bytes((0, 2, 2, 0, 2, 1, 0, 1, 1, 3)))
    assert [(packet.servo_id, packet.params) for packet in found] == [(1, b"\x1d\x00")]


def test_answers_take_return_delay_and_wire_time():
    bus = VirtualBus([ax(1)], baud=1_000_000)
    ((due, answer),) = bus.feed(1.0, p1.packet(1, p1.PING), baud=1_000_000)
    assert len(answer) == 6
    assert due == pytest.approx(1.0 + 60e-6 + 500e-6 + 60e-6)


@given(data=st.lists(st.binary(max_size=60), max_size=6))
def test_no_bytes_upset_a_mixed_bus(data):
    bus = VirtualBus([ax(1), ax(2, MX), VirtualServo(X, 1)])
    for k, piece in enumerate(data):
        bus.feed(1.0 + k, piece)
    assert [p.servo_id for p in p1.Parser().feed(bus.feed(20.0, p1.packet(2, p1.PING))[0][1])] == [
        2
    ]


codes = st.sampled_from((p1.PING, p1.READ, p1.WRITE, p1.REG_WRITE, p1.ACTION, p1.SYNC_WRITE, 0x92))


@given(code=codes, servo_id=st.sampled_from((1, 2, 254)), params=st.binary(max_size=12))
def test_any_instruction_is_answered_at_most_once_by_each_servo(code, servo_id, params):
    bus = VirtualBus([ax(1), ax(2, MX)])
    found = asked(bus, servo_id, code, params)
    assert all(packet.intact for packet in found)
    assert len({packet.servo_id for packet in found}) == len(found)
    assert all(-math.pi <= servo.angle <= math.pi for servo in bus.servos)


# -- registers ------------------------------------------------------------------------------------


def test_angle_limits_make_the_mode():
    servo = ax(1)
    assert write(servo, "torque_enable", 1) == 0
    assert write(servo, "goal_position", 1023) == 0
    servo.advance(2.0)
    assert servo.get("present_position") == pytest.approx(1023, abs=1)
    assert servo.angle == pytest.approx(math.radians(150), abs=0.01)  # 0 lies at tick 512
    for name in ("cw_angle_limit", "ccw_angle_limit"):
        assert write(servo, name, 0) == 0
    write(servo, "moving_speed", 0x400 | 512)  # clockwise, half the torque
    servo.advance(3.0)
    assert servo.get("present_speed") & 0x400
    assert servo.motor.velocity == pytest.approx(-AX.no_load_speed / 2, rel=0.05)
    servo.place(math.radians(-170))  # beyond 300 degrees the sensor sees nothing
    assert servo.get("present_position") == 0
    servo.place(math.radians(360 * 5 + 30))
    assert servo.get("present_position") == 512 + round(30 * 1023 / 300)
    write(servo, "moving_speed", 0)
    write(servo, "ccw_angle_limit", 1023)
    write(servo, "goal_position", 512)
    servo.advance(4.0)
    assert servo.angle == pytest.approx(0, abs=0.01)  # and not five turns away


def test_mx_turns_many_times_when_both_limits_are_4095():
    servo = ax(1, MX)
    assert write(servo, "goal_position", -100) == packets.ERROR_LIMIT
    write(servo, "cw_angle_limit", 4095)
    write(servo, "torque_enable", 1)
    assert write(servo, "goal_position", 28673) == packets.ERROR_RANGE
    assert write(servo, "goal_position", 3 * 4096) == 0
    servo.advance(6.0)
    assert servo.get("present_position") == pytest.approx(3 * 4096, abs=3)
    assert servo.angle > 4 * math.pi


def test_moving_speed_limits_joint_mode():
    servo = ax(1, MX)
    write(servo, "moving_speed", 100)  # 11.4 rpm
    write(servo, "torque_enable", 1)
    write(servo, "goal_position", 4095)
    servo.advance(1.0)
    assert servo.motor.velocity == pytest.approx(11.4 * math.pi / 30, rel=0.02)
    assert servo.get("present_speed") == pytest.approx(100, abs=3)


def test_an_overload_takes_the_torque_limit_and_a_new_limit_gives_it_back():
    servo = VirtualServo(AX, 1, load=lambda angle: 1.5)
    bus = VirtualBus([servo])
    write(servo, "torque_enable", 1)
    write(servo, "goal_position", 900)
    for k in range(1, 60):
        servo.advance(k * 0.05)
    assert servo.get("torque_limit") == 0
    (answer,) = asked(bus, 1, p1.PING)
    assert answer.code == 1 << 5
    servo.load = None
    write(servo, "torque_limit", 1023)
    assert asked(bus, 1, p1.PING)[0].code == 0
    servo.advance(6.0)
    assert servo.get("present_position") == pytest.approx(900, abs=2)


def test_a_supply_error_is_shown_while_it_lasts():
    servo = ax(1)
    servo.supply = 5.0
    servo.advance(0.1)
    assert servo.errors == 1
    servo.supply = 12.0
    servo.advance(0.2)
    assert servo.errors == 0


def test_torque_does_not_lock_the_eeprom_of_an_ax_but_its_lock_does_until_power_goes():
    servo = ax(1)
    write(servo, "torque_enable", 1)
    assert write(servo, "return_delay_time", 0) == 0
    assert write(servo, "lock", 1) == 0
    assert write(servo, "return_delay_time", 5) == packets.ERROR_ACCESS
    assert write(servo, "lock", 0) != 0
    servo.reboot(1.0)
    assert write(servo, "return_delay_time", 5) == 0


def test_an_ax_knows_the_bit_rates_of_its_table_only():
    servo = VirtualServo(AX, 1)
    assert servo.baud == 1_000_000
    assert write(servo, "baud_rate", 34) == 0
    assert servo.baud == 57600
    assert write(servo, "baud_rate", 2) == packets.ERROR_RANGE


def test_xl320_speaks_protocol_2_with_the_old_map():
    servo = VirtualServo(XL320, 9)
    bus = VirtualBus([servo])
    port, client = ClockedPort(bus), sdk.PacketHandler(2.0)
    assert client.ping(port, 9) == (350, sdk.COMM_SUCCESS, 0)
    assert client.write1ByteTxRx(port, 9, 24, 1) == (sdk.COMM_SUCCESS, 0)
    assert client.write2ByteTxRx(port, 9, 30, 700) == (sdk.COMM_SUCCESS, 0)
    assert client.write1ByteTxRx(port, 9, 5, 0) == (sdk.COMM_SUCCESS, packets.ERROR_ACCESS)
    port.clock.sleep_until(4.0)
    assert client.read2ByteTxRx(port, 9, 37)[0] == pytest.approx(700, abs=3)
    servo.trip(1)  # overheating, which the factory's shutdown of 3 contains
    assert servo.get("torque_limit") == 0
    assert client.read1ByteTxRx(port, 9, 50) == (2, sdk.COMM_SUCCESS, packets.ALERT)
