"""What depends on the firmware: backups, settings at power-up, gates; and what is special in P."""

from __future__ import annotations

import dataclasses
import math

import pytest

from bridge.servo import packets
from bridge.servo.bus import ServoBus
from bridge.servo.clock import VirtualClock
from bridge.servo.registers import RPM, control_table
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import VirtualBus, VirtualSerial, VirtualServo
from robots.spec import JointSpec, ServoSpec

XM430, PH54 = control_table("XM430-W350"), control_table("PH54-200-S500")
STORE, RESTORE = b"\x01CTRL", b"\x02CTRL"


def write(servo: VirtualServo, name: str, value: int) -> int:
    register = servo.memory.register(name)
    return servo.write(register.address, register.encode(value))


def told(servo: VirtualServo, code: int, params: bytes, *, now: float = 1.0, to: int = 1) -> int:
    """Return the error in the answer to an instruction, -1 without an answer."""
    answers = VirtualBus([servo]).feed(now, packets.instruction(to, code, params))
    return packets.Parser().feed(answers[0][1])[0].params[0] if answers else -1


def of_firmware(version: int, model: str = "XM430-W350") -> VirtualServo:
    return VirtualServo(dataclasses.replace(control_table(model), firmware=version), 1)


# -- backup ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["XM430-W350", "XL330-M288", "PH54-200-S500"])
def test_a_backup_brings_the_eeprom_back_and_reboots(model):
    servo = VirtualServo(control_table(model), 1)
    write(servo, "return_delay_time", 7)
    write(servo, "position_p_gain", 321)
    assert servo.get("backup_ready") == 0
    assert told(servo, packets.BACKUP, STORE) == 0
    assert servo.get("backup_ready") == 1
    write(servo, "return_delay_time", 9)
    assert told(servo, packets.BACKUP, RESTORE) == 0
    assert servo.boots_at > 1.0
    assert servo.get("return_delay_time") == 7
    assert servo.get("position_p_gain") == control_table(model)["position_p_gain"].default
    assert servo.get("backup_ready") == 1


def test_a_backup_is_refused_under_torque_without_the_key_or_with_nothing_kept():
    servo = VirtualServo(XM430, 1)
    assert told(servo, packets.BACKUP, RESTORE) == packets.ERROR_RESULT
    assert told(servo, packets.BACKUP, b"\x01CTRX") == packets.ERROR_RANGE
    assert told(servo, packets.BACKUP, b"\x03CTRL") == packets.ERROR_RANGE
    write(servo, "torque_enable", 1)
    assert told(servo, packets.BACKUP, STORE) == packets.ERROR_RESULT
    assert servo.get("backup_ready") == 0


def test_the_ram_comes_back_at_power_up_if_the_startup_configuration_says_so():
    servo = VirtualServo(XM430, 1)
    write(servo, "position_p_gain", 321)
    write(servo, "profile_velocity", 40)
    write(servo, "led", 1)
    pointer = servo.memory.register("indirect_address_3")
    assert servo.write(pointer.address, (132).to_bytes(2, "little")) == 0
    told(servo, packets.BACKUP, STORE)
    servo.reboot(2.0)
    assert servo.get("position_p_gain") == 800
    assert write(servo, "startup_configuration", 2) == 0
    servo.reboot(3.0)
    assert servo.get("position_p_gain") == 321
    assert servo.get("profile_velocity") == 40
    assert servo.get("indirect_address_3") == 132
    assert servo.get("led") == 0  # no part of a backup
    assert servo.get("torque_enable") == 0


def test_torque_at_boot_holds_where_the_horn_is():
    servo = VirtualServo(XM430, 1)
    write(servo, "startup_configuration", 1)
    write(servo, "goal_position", 3000)
    servo.place(-0.7)
    servo.reboot(1.0)
    assert servo.get("torque_enable") == 1
    servo.advance(2.0)
    assert servo.angle == pytest.approx(-0.7, abs=0.002)


# -- gates ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "first"),
    [
        ("bus_watchdog", 5, 38),
        ("drive_mode", 1, 38),
        ("drive_mode", 4, 42),
        ("drive_mode", 8, 45),
        ("startup_configuration", 1, 45),
    ],
)
def test_older_firmware_does_not_have_what_came_later(name, value, first):
    old = of_firmware(first - 1)
    assert write(old, name, value) in (packets.ERROR_ACCESS, packets.ERROR_RANGE)
    assert old.get(name) == 0
    assert write(of_firmware(first), name, value) == 0


def test_a_slave_mode_is_for_the_models_with_a_cable_for_it():
    assert write(VirtualServo(XM430, 1), "drive_mode", 2) == packets.ERROR_RANGE
    assert write(VirtualServo(control_table("XM540-W270"), 1), "drive_mode", 2) == 0


@pytest.mark.parametrize(
    ("code", "params", "first", "done"),
    [
        (packets.BACKUP, STORE, 45, 0),
        (packets.CLEAR, b"\x01\x44\x58\x4c\x22", 42, 0),
    ],
)
def test_instructions_came_with_some_firmware(code, params, first, done):
    assert told(of_firmware(first - 1), code, params) == packets.ERROR_INSTRUCTION
    assert told(of_firmware(first), code, params) == done


@pytest.mark.parametrize(("version", "kept"), [(41, False), (42, True)])
def test_a_reset_of_everybody_to_everything_is_ignored_by_later_firmware(version, kept):
    servo = of_firmware(version)
    write(servo, "id", 9)
    told(servo, packets.FACTORY_RESET, b"\xff", to=packets.BROADCAST)
    assert (servo.id == 9) is kept
    assert told(servo, packets.FACTORY_RESET, b"\x01", now=2.0, to=servo.id) == 0


def test_mx_with_protocol_2_has_neither_backup_nor_fast_reads():
    servo = VirtualServo(control_table("MX-28"), 1)
    assert not servo.reads_fast
    assert told(servo, packets.BACKUP, STORE) == packets.ERROR_INSTRUCTION
    assert servo.write(60, b"\x01") == packets.ERROR_ACCESS


# -- the P series ---------------------------------------------------------------------------------


def test_a_p_servo_counts_around_zero_and_turns_many_times():
    servo = VirtualServo(PH54, 1)
    assert servo.get("present_position") == 0
    assert write(servo, "goal_position", 501_434) == packets.ERROR_LIMIT
    assert write(servo, "profile_velocity", 2901) == packets.ERROR_LIMIT
    assert write(servo, "profile_velocity", 2000) == 0  # 20 rpm
    assert write(servo, "torque_enable", 1) == 0
    assert write(servo, "goal_position", -250_962) == 0
    servo.advance(0.4)
    assert servo.get("present_velocity") == pytest.approx(-2000, rel=0.03)
    servo.advance(3.0)
    assert servo.angle == pytest.approx(-math.pi / 2, abs=1e-3)
    write(servo, "torque_enable", 0)
    write(servo, "operating_mode", 4)
    write(servo, "torque_enable", 1)
    assert write(servo, "goal_position", 2_000_000) == 0
    servo.advance(14.0)
    assert servo.get("present_position") == pytest.approx(2_000_000, abs=500)


def test_a_position_register_starts_over_where_four_bytes_end():
    servo = VirtualServo(PH54, 1)
    write(servo, "operating_mode", 4)
    servo.place(2 * math.pi * 2140)
    expected = 2140 * 1_003_846 - 2**32
    assert servo.get("present_position") == pytest.approx(expected, abs=2)


def test_pointers_of_a_p_servo_lie_in_its_eeprom():
    servo = VirtualServo(PH54, 1)
    assert servo.write(168, (580).to_bytes(2, "little")) == 0
    assert servo.write(168, (100).to_bytes(2, "little")) == packets.ERROR_RANGE
    servo.place(0.001)
    low = servo.get("present_position") & 0xFF
    assert servo.read(634, 1) == (0, bytes((low,)))
    write(servo, "torque_enable", 1)
    assert servo.write(168, (581).to_bytes(2, "little")) == packets.ERROR_ACCESS


def test_our_client_finds_configures_and_streams_p_servos():
    joints = [
        JointSpec(f"j{k}", -1.0, 1.0, 0.0, 3.0, 20.0, ServoSpec(k, "PM54-060-S250", "main", zero=0))
        for k in (1, 2)
    ]
    table = control_table("PM54-060-S250")
    wire = VirtualBus([VirtualServo(table, k, baud_index=3, angle=0.2) for k in (1, 2)])
    clock = VirtualClock(1.0)
    bus = ServoBus(
        joints,
        SdkTransport(
            "virtual",
            1_000_000,
            opener=lambda port, baud: VirtualSerial(wire, clock, baudrate=baud, timeout=0.005),
            clock=clock,
        ),
    )
    bus.open()
    bus.identify()
    assert bus.reads_fast
    bus.configure()
    assert wire.servo(1).get("min_position_limit") == pytest.approx(-502834 / 2 / math.pi, abs=1)
    assert wire.servo(1).get("profile_velocity") == 2830  # its limit; the joint's 3 rad/s is more
    assert 3.0 / RPM * 100 > 2830
    bus.hold_present(0.05)
    bus.torque_on()
    bus.watchdog(0.2)
    state = None
    for k in range(100):
        bus.write_goals([0.2 + 0.005 * k, 0.2 - 0.005 * k])
        bus.begin_read()
        state = bus.end_read(clock.now())
        assert state.seen.all()
        clock.sleep_until(clock.now() + 0.01)
    assert state is not None
    assert state.position == pytest.approx([0.695, -0.295], abs=0.05)
    assert state.velocity == pytest.approx([0.5, -0.5], rel=0.15)
