"""The virtual bus byte by byte, on no clock but ours."""

from __future__ import annotations

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bridge.servo import packets
from bridge.servo.packets import Packet, Parser, instruction
from bridge.servo.registers import control_table
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualServo
from bridge.virtual.build import virtual_bus_for
from robots.errors import SpecError
from robots.registry import load_robot

XM430 = control_table("XM430-W350")


def bus(*ids: int, **options) -> VirtualBus:
    return VirtualBus([VirtualServo(XM430, servo_id) for servo_id in ids], **options)


def ask(wire: VirtualBus, data: bytes, now: float = 0.0) -> list[Packet]:
    answers = b"".join(answer for _, answer in wire.feed(now, data))
    return Parser().feed(answers)


def word(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def test_a_ping_is_answered_with_model_and_firmware():
    (answer,) = ask(bus(1), instruction(1, packets.PING))
    assert answer.params == bytes([0, *word(1020), XM430.firmware])


def test_a_broadcast_ping_is_answered_by_all_in_order():
    answers = ask(bus(3, 1, 2), instruction(packets.BROADCAST, packets.PING))
    assert [answer.servo_id for answer in answers] == [1, 2, 3]


def test_a_servo_answers_to_its_shadow_id():
    wire = bus(1)
    ask(wire, instruction(1, packets.WRITE, word(12) + b"\x05"))
    (answer,) = ask(wire, instruction(5, packets.PING))
    assert answer.servo_id == 5


def test_absent_servos_are_silent():
    assert bus(1).feed(0.0, instruction(2, packets.PING)) == []


def test_status_return_level_decides_who_answers():
    wire = bus(1)
    read = instruction(1, packets.READ, word(132, 4))
    quiet = instruction(1, packets.WRITE, word(68) + b"\x00")
    assert len(ask(wire, quiet)) == 1  # answered: the level holds from then on
    assert ask(wire, quiet) == []
    assert ask(wire, read) == []
    assert len(ask(wire, instruction(1, packets.PING))) == 1
    ask(wire, instruction(1, packets.WRITE, word(68) + b"\x01"))
    assert len(ask(wire, read)) == 1


def test_timing_is_that_of_the_wire():
    """The worked example of the module: 10 bytes there, 14 back, at a megabit."""
    wire = bus(1, baud=1_000_000)
    wire.servo(1).memory.set("return_delay_time", 0)
    ((due, _),) = wire.feed(0.0, instruction(1, packets.PING))
    assert due == pytest.approx(0.24e-3)
    wire.servo(1).memory.set("return_delay_time", 250)
    ((due, _),) = wire.feed(1.0, instruction(1, packets.PING))
    assert due == pytest.approx(1 + 0.74e-3)


def test_a_sync_read_takes_the_time_its_bytes_need():
    wire = bus(*range(1, 21), baud=1_000_000)
    for servo in wire.servos:
        servo.memory.set("return_delay_time", 0)
    request = instruction(packets.BROADCAST, packets.SYNC_READ, word(132, 4) + bytes(range(1, 21)))
    answers = wire.feed(0.0, request)
    assert len(request) == 34
    assert answers[-1][0] == pytest.approx((34 + 20 * 15) * 10e-6)
    assert [answer[4] for _, answer in answers] == list(range(1, 21))


def test_an_absent_servo_does_not_keep_the_others_from_answering():
    request = instruction(packets.BROADCAST, packets.SYNC_READ, word(132, 4) + bytes([1, 2, 3]))
    assert [answer.servo_id for answer in ask(bus(1, 3), request)] == [1, 3]


def test_a_fast_read_breaks_off_at_an_absent_servo():
    params = word(132, 4) + bytes([1, 2])
    request = instruction(packets.BROADCAST, packets.FAST_SYNC_READ, params)
    (whole,) = ask(bus(1, 2), request)
    assert len(whole.params) == 2 * 8 - 2  # the last CRC is the packet's own
    assert ask(bus(1), request) == []


def test_sync_and_bulk_writes_reach_their_servos_and_nobody_answers():
    wire = bus(1, 2)
    sync = word(65, 1) + bytes([1, 1, 9, 1, 2, 1])
    assert wire.feed(0.0, instruction(packets.BROADCAST, packets.SYNC_WRITE, sync)) == []
    assert [servo.get("led") for servo in wire.servos] == [1, 1]
    bulk = bytes([1]) + word(65, 1) + b"\x00" + bytes([2]) + word(116, 4) + b"\x10\x00\x00\x00"
    assert wire.feed(0.0, instruction(packets.BROADCAST, packets.BULK_WRITE, bulk)) == []
    assert wire.servo(1).get("led") == 0
    assert wire.servo(2).get("goal_position") == 16


def test_bulk_reads_answer_each_with_its_own_registers():
    params = bytes([1]) + word(7, 1) + bytes([2]) + word(0, 2)
    answers = ask(bus(1, 2), instruction(packets.BROADCAST, packets.BULK_READ, params))
    assert [answer.params for answer in answers] == [b"\x00\x01", b"\x00" + word(1020)]


def test_reg_write_and_action_move_together():
    wire = bus(1, 2)
    for servo_id in (1, 2):
        ask(wire, instruction(servo_id, packets.REG_WRITE, word(65) + b"\x01"))
    assert [servo.get("led") for servo in wire.servos] == [0, 0]
    assert wire.feed(0.0, instruction(packets.BROADCAST, packets.ACTION)) == []
    assert [servo.get("led") for servo in wire.servos] == [1, 1]


def test_a_rebooting_servo_is_silent_for_a_moment():
    wire = bus(1)
    assert len(ask(wire, instruction(1, packets.REBOOT), now=1.0)) == 1
    assert ask(wire, instruction(1, packets.PING), now=1.05) == []
    assert len(ask(wire, instruction(1, packets.PING), now=2.0)) == 1


def test_factory_reset_and_clear_check_their_parameters():
    wire = bus(1)
    (refused,) = ask(wire, instruction(1, packets.CLEAR, b"\x02"))
    assert refused.params[0] == packets.ERROR_RANGE
    (done,) = ask(wire, instruction(1, packets.CLEAR, bytes.fromhex("0144584c22")))
    assert done.params[0] == 0
    (done,) = ask(wire, instruction(1, packets.FACTORY_RESET, b"\x01"))
    assert done.params[0] == 0


def test_unknown_instructions_are_refused_by_name():
    (answer,) = ask(bus(1), instruction(1, 0x77))
    assert answer.params[0] == packets.ERROR_INSTRUCTION


def test_two_equal_servos_with_one_id_are_heard_as_one():
    assert len(ask(bus(1, 1), instruction(1, packets.PING))) == 1


def test_servos_set_to_another_rate_hear_nothing():
    wire = bus(1)
    ping = instruction(1, packets.PING)
    assert wire.feed(0.0, ping, baud=1_000_000) == []
    assert len(wire.feed(0.1, ping, baud=57600)) == 1


def test_half_a_packet_is_forgotten_after_silence():
    wire = bus(1)
    ping = instruction(1, packets.PING)
    wire.feed(0.0, ping[:7])
    assert len(wire.feed(0.01, ping[7:])) == 1
    wire.feed(1.0, b"\xff\xff\xfd\x00\x01\xff\x03")  # claims a kilobyte
    assert len(wire.feed(2.0, ping)) == 1


def test_every_packet_on_the_bus_feeds_the_watchdog():
    wire = bus(1, 2)
    for servo in wire.servos:
        servo.memory.set("torque_enable", 1)
        servo.write(98, b"\x05")
    now = 0.0
    for _ in range(50):
        now += 0.05
        wire.feed(now, instruction(2, packets.PING))
    assert wire.servo(1).get("bus_watchdog") == 5
    wire.feed(now + 0.2, instruction(2, packets.PING))
    assert wire.servo(1).get("bus_watchdog") == -1


def test_faults_strike_as_planned_and_the_same_way_every_time():
    def run() -> list[bytes]:
        plan = FaultPlan(
            [Fault("drop", probability=0.3), Fault("corrupt", probability=0.3)], seed=5
        )
        wire = bus(1, faults=plan)
        return [
            b"".join(data for _, data in wire.feed(k * 0.01, instruction(1, packets.PING)))
            for k in range(100)
        ]

    first = run()
    assert first == run()
    clean = bus(1).feed(0.0, instruction(1, packets.PING))[0][1]
    assert 15 < first.count(b"") < 45
    assert 30 < first.count(clean) < 70


def test_a_silent_servo_neither_hears_nor_answers():
    wire = bus(1, faults=FaultPlan([Fault("silence", start=1.0, end=2.0, servo_id=1)]))
    led = instruction(1, packets.WRITE, word(65) + b"\x01")
    assert wire.feed(1.5, led) == []
    assert wire.servo(1).get("led") == 0
    assert len(wire.feed(2.0, led)) == 1


def test_a_planned_hardware_error_comes_once():
    wire = bus(1, faults=FaultPlan([Fault("hardware", start=1.0, servo_id=1, value=2)]))
    wire.feed(1.5, instruction(1, packets.PING))
    assert wire.servo(1).get("hardware_error_status") == 4
    ask(wire, instruction(1, packets.REBOOT), now=1.6)
    (answer,) = ask(wire, instruction(1, packets.PING), now=3.0)
    assert answer.params[0] == 0


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=30)), max_size=8))
@example([(packets.FAST_SYNC_READ, b"\x00\x00\x00\x80\x00\x00")])
def test_no_instruction_raises(messages):
    """Two servos asked for 32768 bytes each once overflowed the chained answer's length."""
    wire = bus(1, 2)
    for index, (code, params) in enumerate(messages):
        for servo_id in (1, packets.BROADCAST):
            for due, _ in wire.feed(index * 0.01, instruction(servo_id, code, params)):
                assert due >= index * 0.01


def test_a_robots_bus_holds_its_servos_in_rest_pose():
    robot = load_robot("op3")
    wire = virtual_bus_for(robot)
    assert [servo.id for servo in wire.servos] == [joint.servo.id for joint in robot.joints]
    for joint, servo in zip(robot.joints, wire.servos, strict=True):
        tick = joint.servo.zero + joint.servo.direction * joint.rest * 4096 / 6.283185307179586
        assert servo.get("present_position") == pytest.approx(tick, abs=1)
        assert servo.get("torque_enable") == 0


def test_an_unknown_bus_is_refused():
    with pytest.raises(SpecError, match="main"):
        virtual_bus_for(load_robot("op3"), "mian")
