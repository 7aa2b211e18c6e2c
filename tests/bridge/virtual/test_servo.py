"""A virtual servo obeys the rules of its control table and moves like one."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.servo import packets
from bridge.servo.registers import control_table, model_names
from bridge.virtual import VirtualServo

XM430 = control_table("XM430-W350")


def write(servo: VirtualServo, name: str, value: int) -> int:
    register = servo.memory.register(name)
    return servo.write(register.address, register.encode(value))


def ready(model: str = "XM430-W350", **changes: int) -> VirtualServo:
    """Return a servo with torque on that holds where it is."""
    servo = VirtualServo(control_table(model), 1)
    for name, value in changes.items():
        assert write(servo, name, value) == 0
    assert write(servo, "torque_enable", 1) == 0
    return servo


def test_eeprom_is_locked_while_torque_is_on():
    servo = ready()
    assert write(servo, "operating_mode", 4) == packets.ERROR_ACCESS
    assert write(servo, "torque_enable", 0) == 0
    assert write(servo, "operating_mode", 4) == 0


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("present_position", 0, packets.ERROR_ACCESS),
        ("led", 2, packets.ERROR_RANGE),
        ("operating_mode", 2, packets.ERROR_RANGE),
        ("goal_position", 4096, packets.ERROR_LIMIT),
        ("goal_position", -1, packets.ERROR_LIMIT),
        ("goal_pwm", 886, packets.ERROR_LIMIT),
        ("goal_current", -1194, packets.ERROR_LIMIT),
        ("profile_velocity", 32768, packets.ERROR_RANGE),
    ],
)
def test_a_refused_write_names_its_reason_and_changes_nothing(name, value, error):
    servo = VirtualServo(XM430, 1)
    before = servo.get(name)
    assert write(servo, name, value) == error
    assert servo.get(name) == before


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (116, b"\0\0", packets.ERROR_LENGTH),  # half a register
        (117, b"\0\0\0", packets.ERROR_LENGTH),  # from its middle
        (66, b"\0", packets.ERROR_ACCESS),  # nothing there
        (1020, bytes(8), packets.ERROR_ACCESS),  # beyond the table
    ],
)
def test_writes_cover_whole_registers(address, data, error):
    assert VirtualServo(XM430, 1).write(address, data) == error


def test_a_long_write_is_all_or_nothing():
    servo = VirtualServo(XM430, 1)
    acceleration, velocity = (10).to_bytes(4, "little"), (99999).to_bytes(4, "little")
    assert servo.write(108, acceleration + velocity) == packets.ERROR_RANGE
    assert servo.get("profile_acceleration") == 0


def test_position_limits_bind_goals_in_position_mode_only():
    servo = VirtualServo(XM430, 1)
    assert write(servo, "max_position_limit", 3000) == 0
    assert write(servo, "goal_position", 3001) == packets.ERROR_LIMIT
    assert write(servo, "operating_mode", 4) == 0
    assert write(servo, "goal_position", 300_000) == 0
    assert write(servo, "goal_position", 1_048_576) == packets.ERROR_RANGE


def test_a_new_mode_resets_gains_profile_and_goals():
    servo = VirtualServo(XM430, 1)
    for name, value in (("position_p_gain", 50), ("profile_velocity", 7), ("goal_pwm", 100)):
        write(servo, name, value)
    write(servo, "operating_mode", 5)
    assert servo.get("position_p_gain") == 800
    assert servo.get("profile_velocity") == 0
    assert servo.get("goal_pwm") == 885


def test_torque_comes_on_with_a_stale_goal_as_on_a_real_servo():
    servo = VirtualServo(XM430, 1)
    write(servo, "goal_position", 3000)
    write(servo, "torque_enable", 1)
    servo.advance(1.0)
    assert servo.get("present_position") == pytest.approx(3000, abs=3)


def test_a_limp_servo_stays_where_it_is_put():
    servo = VirtualServo(XM430, 1)
    servo.place(0.5)
    write(servo, "goal_position", 1000)
    servo.advance(1.0)
    assert servo.angle == 0.5


def test_a_step_is_reached_no_faster_than_no_load_speed():
    servo = ready()
    write(servo, "goal_position", 4000)
    angles = []
    for k in range(1, 200):
        servo.advance(k * 0.01)
        angles.append(servo.angle)
    speed = max(b - a for a, b in itertools.pairwise(angles)) / 0.01
    assert 0.9 * XM430.no_load_speed < speed < XM430.no_load_speed * (1 + 1e-9)
    assert servo.get("present_position") == pytest.approx(4000, abs=2)
    assert servo.get("moving") == 0


def test_a_weak_supply_makes_it_slower():
    speeds = []
    for volts in (12.0, 9.6):
        servo = ready()
        servo.supply = volts
        write(servo, "goal_position", 4000)
        servo.advance(0.4)
        speeds.append(servo.get("present_velocity"))
    assert speeds[1] == pytest.approx(0.8 * speeds[0], rel=0.05)


def test_lag_to_a_ramp_is_that_of_the_p_gain():
    """885 * 128 / P ticks of error give full duty: the documented 45 ms plus the motor's 15."""
    servo = ready()
    speed = 500.0  # ticks/s
    for k in range(200):
        servo.advance(k * 0.01)
        write(servo, "goal_position", 2048 + round(speed * k * 0.01))
    lag = (2048 + speed * 1.99 - servo.get("present_position")) / speed
    assert lag == pytest.approx(0.045, abs=0.012)


def test_profile_velocity_limits_speed():
    servo = ready(profile_velocity=40)
    write(servo, "goal_position", 4000)
    servo.advance(0.5)
    assert servo.get("present_velocity") == pytest.approx(40, abs=2)
    assert servo.get("velocity_trajectory") == 40


def test_a_time_based_profile_takes_its_time():
    servo = ready(drive_mode=4, profile_velocity=1000, profile_acceleration=250)
    write(servo, "goal_position", 3048)
    servo.advance(0.5)
    assert abs(servo.get("position_trajectory") - 2548) < 20
    servo.advance(1.02)
    assert servo.get("position_trajectory") == 3048


def test_reverse_mode_turns_the_sign():
    servo = VirtualServo(XM430, 1)
    write(servo, "drive_mode", 1)
    servo.place(0.5)
    assert servo.get("present_position") == 2048 - round(0.5 / XM430.units.position)


@pytest.mark.parametrize("model", model_names())
def test_every_model_moves_to_its_goal(model):
    servo = ready(model)
    eighth = servo.table.units.ticks_per_turn / 8
    goal = round(servo.get("present_position") + eighth)
    assert write(servo, "goal_position", goal) == 0
    servo.advance(4.0)
    assert abs(servo.get("present_position") - goal) < max(3, eighth / 100)
    assert servo.angle == pytest.approx(math.pi / 4, abs=0.01)


def test_the_bus_watchdog_stops_a_servo_and_refuses_goals_until_cleared():
    servo = ready(profile_velocity=40)
    servo.hear(0.0)
    write(servo, "goal_position", 4000)
    write(servo, "bus_watchdog", 5)  # 100 ms
    servo.advance(0.09)
    assert servo.get("bus_watchdog") == 5
    servo.advance(2.0)
    assert servo.get("bus_watchdog") == -1
    stopped = servo.get("present_position")
    assert stopped < 2048 + 0.12 * 40 * 0.229 * 4096 / 60 + 5
    assert write(servo, "goal_position", 3000) == packets.ERROR_RANGE
    servo.advance(3.0)
    assert servo.get("present_position") == pytest.approx(stopped, abs=2)
    assert write(servo, "bus_watchdog", 0) == 0
    assert write(servo, "goal_position", 3000) == 0


def test_a_latched_error_takes_torque_and_only_a_reboot_gives_it_back():
    servo = ready()
    servo.trip(5)
    assert servo.get("torque_enable") == 0
    assert servo.alert == packets.ALERT
    assert write(servo, "torque_enable", 1) == packets.ERROR_RESULT
    servo.reboot(1.0)
    assert servo.alert == 0
    assert write(servo, "torque_enable", 1) == 0


def test_an_error_outside_the_shutdown_mask_leaves_torque_on():
    servo = ready()
    servo.trip(0)
    assert servo.get("torque_enable") == 1
    assert servo.alert == packets.ALERT


def test_a_blocked_servo_draws_current_warms_up_and_trips():
    servo = VirtualServo(XM430, 1, load=lambda angle: 1.0)
    write(servo, "torque_enable", 1)
    servo.advance(1.0)
    write(servo, "goal_position", 4000)
    servo.advance(1.5)
    assert servo.get("present_current") > 600  # of 855 at stall
    assert servo.get("present_input_voltage") < 120
    servo.advance(5.0)
    assert servo.get("hardware_error_status") & 1 << 5
    assert servo.motor.temperature > 25.5


def test_factory_reset_keeps_what_it_is_told_to_keep():
    servo = VirtualServo(XM430, 7, baud_index=3)
    write(servo, "return_delay_time", 0)
    assert servo.factory_reset(2, 0.0) == 0
    assert (servo.id, servo.get("baud_rate")) == (7, 3)
    assert servo.get("return_delay_time") == 250
    servo.factory_reset(0xFF, 0.0)
    assert (servo.id, servo.get("baud_rate")) == (1, 1)


def test_indirect_data_shows_and_writes_what_its_pointers_say():
    servo = VirtualServo(control_table("XL330-M288"), 1)
    for index in range(4):
        pointer = servo.memory.register(f"indirect_address_{index + 1}")
        assert servo.write(pointer.address, (116 + index).to_bytes(2, "little")) == 0
    assert servo.write(208, (1234).to_bytes(4, "little")) == 0
    assert servo.get("goal_position") == 1234
    assert servo.read(208, 4) == (0, (1234).to_bytes(4, "little"))
    assert servo.write(208, b"\0\0") == packets.ERROR_LENGTH


def test_registered_writes_wait_for_the_action():
    servo = VirtualServo(XM430, 1)
    assert servo.action() == packets.ERROR_RESULT
    assert servo.register_write(65, b"\x01") == 0
    assert servo.get("registered_instruction") == 1
    assert servo.get("led") == 0
    assert servo.action() == 0
    assert servo.get("led") == 1


@settings(max_examples=30, deadline=None)
@given(
    goals=st.lists(st.integers(0, 4095), min_size=1, max_size=5),
    cuts=st.lists(st.floats(0.001, 0.2), min_size=1, max_size=8),
)
def test_the_same_commands_give_the_same_motion_however_often_it_is_watched(goals, cuts):
    def run(watched: bool) -> float:
        servo = ready()
        now = 0.0
        for goal in goals:
            write(servo, "goal_position", goal)
            if watched:
                for cut in cuts:
                    servo.advance(now + cut)
            now += 0.25
            servo.advance(now)
        return servo.angle

    assert run(watched=True) == pytest.approx(run(watched=False), abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(address=st.integers(0, 700), data=st.binary(min_size=1, max_size=16))
def test_no_write_raises_or_breaks_the_servo(address, data):
    servo = VirtualServo(XM430, 1)
    assert 0 <= servo.write(address, data) <= 7
    servo.advance(0.1)
    assert math.isfinite(servo.angle)
    assert servo.read(address, len(data))[0] == 0
