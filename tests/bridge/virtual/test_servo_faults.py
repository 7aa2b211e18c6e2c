"""What faults do to the servos themselves: by physics, where there is physics to it."""

from __future__ import annotations

import pytest

from bridge.servo import packets
from bridge.servo.packets import Parser, instruction
from bridge.servo.registers import control_table
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualServo, virtual_bus_for
from bridge.virtual.faults import KINDS, Kind
from robots.registry import load_robot

XM430 = control_table("XM430-W350")
AMPERE = XM430.current_unit or 0.0
"""Of one count."""


def bus(*faults: Fault, ids=(1, 2)) -> VirtualBus:
    return VirtualBus([VirtualServo(XM430, servo_id) for servo_id in ids], faults=FaultPlan(faults))


def word(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def write(wire: VirtualBus, name: str, value: int, *, to: int = 1, now: float = 0.0) -> int:
    """Return the error of a write over the wire; -1 if nobody answers."""
    register = XM430[name]
    params = word(register.address) + register.encode(value)
    answers = wire.feed(now, instruction(to, packets.WRITE, params))
    found = Parser().feed(b"".join(data for _, data in answers))
    return found[0].params[0] if found else -1


def read(wire: VirtualBus, name: str, now: float, *, of: int = 1, baud: int | None = None) -> int:
    """Return a register read over the wire; -1 if no answer is intact."""
    register = XM430[name]
    request = instruction(of, packets.READ, word(register.address, register.length))
    answers = wire.feed(now, request, baud=baud)
    found = Parser().feed(b"".join(data for _, data in answers))
    return register.decode(found[0].params[1:]) if found else -1


def test_a_weak_supply_sets_the_voltage_bit_and_leaves_torque_on():
    wire = bus(Fault("brownout", 1.0, 2.0, servo_id=1, value=9.0))
    write(wire, "torque_enable", 1)
    assert read(wire, "present_input_voltage", 1.5) == 90
    assert read(wire, "hardware_error_status", 1.6) == 1 << 0
    assert read(wire, "torque_enable", 1.6) == 1
    assert read(wire, "hardware_error_status", 1.6, of=2) == 0
    assert read(wire, "present_input_voltage", 2.5) == 120
    assert read(wire, "hardware_error_status", 2.6) == 1 << 0  # latched


def test_a_weak_supply_takes_torque_if_shutdown_says_so():
    wire = bus(Fault("brownout", 1.0, 2.0, value=9.0))
    write(wire, "shutdown", 53)
    write(wire, "torque_enable", 1)
    assert read(wire, "torque_enable", 1.5) == 0
    assert write(wire, "torque_enable", 1, now=2.5) == packets.ALERT | packets.ERROR_RESULT


def test_a_servo_slows_down_while_its_supply_is_weak():
    speeds = []
    for volts in (12.0, 9.6):
        wire = bus(Fault("brownout", 0.1, 1.0, value=volts))
        write(wire, "torque_enable", 1)
        write(wire, "goal_position", 4000, now=0.2)
        speeds.append(read(wire, "present_velocity", 0.5))
    assert speeds[1] == pytest.approx(0.8 * speeds[0], rel=0.05)


@pytest.mark.parametrize(("kind", "value"), [("brownout", 3.0), ("unplug", 0.0)])
def test_a_servo_without_power_forgets_its_ram_and_comes_back_limp(kind: Kind, value):
    wire = bus(Fault(kind, 1.0, 2.0, servo_id=1, value=value))
    for name, count in (("torque_enable", 1), ("led", 1), ("bus_watchdog", 100)):
        write(wire, name, count)
        write(wire, name, count, to=2)
    write(wire, "goal_position", 3000)
    assert read(wire, "led", 1.5) == -1
    assert read(wire, "led", 1.5, of=2) == 1
    assert read(wire, "led", 2.1) == -1  # it boots
    for name in ("torque_enable", "led", "bus_watchdog", "hardware_error_status"):
        assert read(wire, name, 2.5) == 0
    assert read(wire, "goal_position", 2.5) == read(wire, "present_position", 2.5)
    assert read(wire, "torque_enable", 2.5, of=2) == 1


def test_a_dip_between_two_packets_is_not_missed():
    wire = bus(Fault("brownout", 1.0, 1.001, servo_id=1, value=0.0))
    write(wire, "torque_enable", 1)
    assert read(wire, "torque_enable", 5.0) == 0


def test_a_silent_servo_keeps_its_ram():
    wire = bus(Fault("silence", 1.0, 2.0, servo_id=1))
    write(wire, "torque_enable", 1)
    assert read(wire, "torque_enable", 1.5) == -1
    assert read(wire, "torque_enable", 2.5) == 1


def test_a_servo_that_restarts_at_another_rate_is_heard_there_alone():
    wire = bus(Fault("baud", 1.0, 2.0, servo_id=1, value=1_000_000))
    write(wire, "torque_enable", 1)
    assert read(wire, "id", 1.5, baud=57600) == -1
    assert read(wire, "baud_rate", 1.5, baud=1_000_000) == 3
    assert read(wire, "id", 1.5, of=2, baud=57600) == 2
    assert read(wire, "torque_enable", 2.5, baud=57600) == 0


def test_a_second_servo_of_an_id_damages_answers_and_hears_what_is_written():
    wire = bus(Fault("clash", 1.0, 2.0, servo_id=1, value=0.3))
    assert read(wire, "present_position", 0.5) == 2048
    assert read(wire, "present_position", 1.5) == -1
    assert read(wire, "model_number", 1.6) == 1020  # both say the same
    write(wire, "torque_enable", 1, now=1.7)
    assert read(wire, "present_position", 2.5) == 2048
    assert read(wire, "present_position", 1.5, of=2) == 2048
    assert len(wire.servos) == 2


def test_old_firmware_has_no_fast_read_and_no_watchdog():
    fast = word(132, 4) + bytes([1])
    request = instruction(packets.BROADCAST, packets.FAST_SYNC_READ, fast)
    wire = bus(Fault("firmware", 1.0, 2.0, servo_id=1, value=37))
    for now, version, answers, error in (
        (0.5, XM430.firmware, 1, 0),
        (1.5, 37, 0, packets.ERROR_ACCESS),
        (2.5, XM430.firmware, 1, 0),
    ):
        assert read(wire, "firmware_version", now) == version
        assert len(wire.feed(now, request)) == answers
        assert write(wire, "bus_watchdog", 10, now=now) == error


def test_old_firmware_stays_old_when_it_restarts():
    wire = bus(Fault("firmware", servo_id=1, value=40))
    wire.feed(0.1, instruction(1, packets.REBOOT))
    assert read(wire, "firmware_version", 1.0) == 40


def test_a_hot_room_warms_a_servo_until_it_switches_off():
    """25 degC towards 300 with 120 s: the limit of 80 after 120 ln(275 / 220) = 26.8 s."""
    wire = bus(Fault("heat", servo_id=1, value=300.0))
    write(wire, "torque_enable", 1)
    assert read(wire, "present_temperature", 20.0) == pytest.approx(67, abs=1)
    assert read(wire, "torque_enable", 26.0) == 1
    assert read(wire, "torque_enable", 28.0) == 0
    assert read(wire, "hardware_error_status", 28.0) == 1 << 2
    assert read(wire, "present_temperature", 28.0, of=2) == 25


def test_heat_comes_from_effort():
    """A load of 0.7 needs 0.7 of the stall current: 160 * 0.49 = 78 K in the end."""
    wire = bus(Fault("load", servo_id=1, value=0.7))
    write(wire, "torque_enable", 1)
    # So far the P gain alone lets it sag until its duty carries the load.
    current = read(wire, "present_current", 5.0) * AMPERE / XM430.stall_current
    assert current == pytest.approx(0.7, abs=0.02)
    assert read(wire, "present_temperature", 60.0) == pytest.approx(25 + 78 * 0.393, abs=3)
    assert read(wire, "hardware_error_status", 60.0) == 0
    assert read(wire, "hardware_error_status", 150.0) == 1 << 2
    assert read(wire, "torque_enable", 150.0) == 0


def test_a_load_is_gone_when_it_is_over_and_loads_add_up():
    wire = bus(
        Fault("load", 1.0, 5.0, servo_id=1, value=0.2),
        Fault("load", 2.0, 3.0, servo_id=1, value=0.2),
    )
    write(wire, "torque_enable", 1)
    shares = [
        read(wire, "present_current", now) * AMPERE / XM430.stall_current
        for now in (0.9, 1.9, 2.9, 4.9, 6.0)
    ]
    assert shares == pytest.approx([0.0, 0.2, 0.4, 0.2, 0.0], abs=0.02)


def test_a_stuck_horn_draws_stall_current_until_overload_takes_torque():
    wire = bus(Fault("stuck", 1.0, 9.0, servo_id=1))
    for servo in (1, 2):
        write(wire, "torque_enable", 1, to=servo)
        write(wire, "goal_position", 3500, to=servo, now=1.1)
    assert read(wire, "present_position", 2.0) == 2048
    assert read(wire, "present_velocity", 2.0) == 0
    current = read(wire, "present_current", 2.0) * AMPERE
    assert current == pytest.approx(0.95 * XM430.stall_current, rel=0.02)  # the cable takes 5 %
    assert read(wire, "present_position", 2.0, of=2) == pytest.approx(3500, abs=3)
    assert read(wire, "hardware_error_status", 2.9) == 0
    assert read(wire, "hardware_error_status", 3.3) == 1 << 5
    assert read(wire, "torque_enable", 3.3) == 0


def test_a_horn_that_was_stuck_for_a_moment_goes_on():
    wire = bus(Fault("stuck", 1.0, 2.0, servo_id=1))
    write(wire, "torque_enable", 1)
    write(wire, "goal_position", 3000, now=1.1)
    assert read(wire, "present_position", 1.9) == 2048
    assert read(wire, "present_position", 4.0) == pytest.approx(3000, abs=3)


def test_a_body_in_physics_gets_stuck_too():
    robot = load_robot("marionette")
    servo = robot.joints[0].servo
    wire = virtual_bus_for(
        robot, plant="mujoco", faults=FaultPlan([Fault("stuck", 0.5, servo_id=servo.id)])
    )
    register = XM430["goal_position"]
    wire.feed(0.01, instruction(servo.id, packets.PING))
    write(wire, "torque_enable", 1, to=servo.id, now=0.4)
    before = wire.servo(servo.id).get("present_position")
    goal = before + 200
    params = word(register.address) + register.encode(goal)
    wire.feed(0.6, instruction(servo.id, packets.WRITE, params))
    wire.advance(0.9)
    held = wire.servo(servo.id)
    assert abs(held.get("present_position") - before) <= 20  # friction in physics creeps
    assert abs(held.motor.current) > 0.2


def test_faults_of_servos_happen_at_their_time_however_often_the_bus_is_asked():
    faults = (
        Fault("load", 0.31, 1.7, servo_id=1, value=0.5),
        Fault("stuck", 0.9, 1.2, servo_id=1),
        Fault("brownout", 1.3, 1.9, servo_id=1, value=10.0),
    )
    ends = []
    for often in (1, 7, 200):
        wire = bus(*faults)
        write(wire, "torque_enable", 1)
        write(wire, "goal_position", 2600, now=0.2)
        for k in range(often):
            wire.advance(0.2 + 2.0 * (k + 1) / often)
        ends.append((wire.servo(1).angle, wire.servo(1).motor.temperature))
    assert ends[1] == pytest.approx(ends[0], abs=1e-9)
    assert ends[2] == pytest.approx(ends[0], abs=1e-9)


@pytest.mark.parametrize("kind", sorted(name for name, k in KINDS.items() if k.scope == "servo"))
def test_a_servo_is_as_before_when_a_fault_is_over(kind: Kind):
    """But for what it remembers: a restart clears RAM, an error stays until the next one."""
    wire = bus(Fault(kind, 1.0, 1.5, servo_id=1, value=60 if kind == "heat" else float("nan")))
    for now in (0.5, 1.2, 3.0):
        read(wire, "id", now)
    wire.feed(3.0, instruction(1, packets.REBOOT))
    names = set(XM430.registers) - {"realtime_tick", "present_temperature"}
    after = {name: wire.servo(1).get(name) for name in names}
    other = bus()
    other.advance(3.0)
    assert after == {name: other.servo(1).get(name) for name in names}
    assert read(wire, "torque_enable", 4.0) == 0
