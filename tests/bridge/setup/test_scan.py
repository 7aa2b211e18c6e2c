"""Finding servos: any rate, any id, and two of one id."""

from __future__ import annotations

import dataclasses
import errno

import pytest

from bridge.servo.registers import control_table
from bridge.setup.line import Line
from bridge.setup.scan import OLD_BAUDS, mismatches, scan
from bridge.virtual import Fault, PtyServer, VirtualBus, VirtualServo
from robots.errors import PortLost
from robots.registry import load_robot
from tests.bridge.setup.rig import XL330, Merging, Rig, servo

AX, MX, PH54 = (control_table(name) for name in ("AX-12A", "MX-28(1.0)", "PH54-200-S500"))


def test_servos_are_found_at_every_rate_with_model_and_firmware():
    rig = Rig([servo(1), servo(252, 1_000_000, XL330), servo(7, 4_500_000)])
    found = scan(rig.line)
    assert [(s.id, s.baud, s.model) for s in found.servos] == [
        (1, 57600, "XM430-W350"),
        (252, 1_000_000, "XL330-M288"),
        (7, 4_500_000, "XM430-W350"),
    ]
    assert found.servos[0].firmware == rig.wire.servo(1).get("firmware_version")
    assert not any(s.clash for s in found.servos)
    assert not found.noisy
    assert not found.echo


def test_an_empty_line_has_nobody_and_nothing_is_written():
    rig = Rig([])
    assert scan(rig.line, [57600]).servos == ()


def test_a_scan_writes_to_no_servo():
    one = servo(1)
    before = one.memory.read(0, 120)
    scan(Rig([one]).line, [57600])
    assert one.memory.read(0, 120) == before


def test_two_servos_of_one_id_that_answer_one_after_the_other_clash():
    found = scan(Rig([servo(3), servo(3, table=XL330), servo(4)]).line, [57600])
    assert [(s.id, s.clash) for s in found.servos] == [(3, True), (4, False)]


def test_two_models_of_one_id_damage_their_answers_and_clash():
    found = scan(Rig([servo(3), servo(3, table=XL330), servo(4)], serial=Merging).line, [57600])
    assert [(s.id, s.clash) for s in found.servos] == [(3, True), (4, False)]
    assert not found.noisy  # the clash explains the damage


def test_two_equal_servos_of_one_id_are_told_apart_by_where_they_stand():
    """Their answers to a ping are the same bit by bit: only their positions give them away."""
    pair = [servo(3, angle=0.1), servo(3, angle=0.7)]
    (found,) = scan(Rig(pair, serial=Merging).line, [57600]).servos
    assert found.clash
    assert found.model == "XM430-W350"


def test_a_servo_whose_answers_are_all_damaged_is_found_by_id():
    found = scan(Rig([servo(5), servo(6)], Fault("corrupt", servo_id=5)).line, [57600])
    assert [(s.id, s.clash) for s in found.servos] == [(5, True), (6, False)]


def test_what_stands_in_the_way_of_playing_is_noted():
    odd, hot, fine = servo(1), servo(2), servo(3)
    odd.write(20, (512).to_bytes(4, "little"))
    odd.write(10, b"\x01")
    hot.trip(2)
    fine.write(9, b"\x00")
    notes = [" ".join(s.notes) for s in scan(Rig([odd, hot, fine]).line, [57600]).servos]
    assert "homing_offset 512" in notes[0]
    assert "drive_mode 1" in notes[0]
    assert "return delay 500 us" in notes[0]
    assert "overheating" in notes[1]
    assert notes[2] == ""


def test_a_model_without_a_table_is_found_all_the_same():
    table = dataclasses.replace(XL330, number=4321, name="unheard of")
    (found,) = scan(Rig([servo(9, table=table)]).line, [57600]).servos
    assert (found.number, found.model, found.clash) == (4321, "model 4321", False)
    assert "no control table" in found.notes[0]


def test_a_robot_is_compared_with_what_was_found():
    robot = load_robot("marionette")
    first, second, third = (joint.servo.id for joint in robot.joints[:3])
    rig = Rig(
        [servo(first, 1_000_000, XL330), servo(second, 57600, XL330), servo(99, 1_000_000, XL330)]
    )
    lines = mismatches(scan(rig.line, [57600, 1_000_000]), robot, "main")
    assert not any(f"id {first})" in line for line in lines)
    assert f"{robot.joints[1].name} (id {second}): set to 57600 bit/s, not 1000000" in lines
    assert f"{robot.joints[2].name} (id {third}): missing" in lines
    assert any(line.startswith("id 99 ") for line in lines)


def test_a_port_that_is_not_there_is_said_to_be_gone():
    def opener(port: str, baud: int):
        raise OSError(errno.ENOENT, "No such file or directory")

    with pytest.raises(PortLost, match="cannot be opened"):
        scan(Line("/dev/nothing", opener), [57600])


def test_an_adapter_unplugged_in_the_middle_is_said_to_be_gone():
    rig = Rig([servo(1)], Fault("unplug", start=1.3))
    with pytest.raises(PortLost, match="gone away"):
        scan(rig.line)


@pytest.mark.realtime
def test_over_a_terminal_every_servo_is_heard_at_its_own_rate_alone(tmp_path):
    """4.5 Mbit/s has no constant of its own: it must not be taken for no rate at all."""
    with PtyServer(VirtualBus([servo(1), servo(2, 4_500_000)]), link=tmp_path / "p") as server:
        found = scan(Line(server.port), [57600, 4_500_000])
    assert [(s.id, s.baud, s.clash) for s in found.servos] == [
        (1, 57600, False),
        (2, 4_500_000, False),
    ]


def test_servos_of_protocol_1_are_found_and_named_beside_those_of_protocol_2():
    old = [VirtualServo(AX, 1), VirtualServo(AX, 253), VirtualServo(MX, 5), servo(1, 1_000_000)]
    found = scan(Rig(old).line, [1_000_000], old_bauds=OLD_BAUDS)
    assert [(s.protocol, s.id, s.baud, s.model, s.firmware, s.clash) for s in found.servos] == [
        (2, 1, 1_000_000, "XM430-W350", 48, False),
        (1, 5, 57600, "MX-28(1.0)", 40, False),
        (1, 1, 1_000_000, "AX-12A", 24, False),
        (1, 253, 1_000_000, "AX-12A", 24, False),
    ]
    assert all("cannot be played" in s.notes[0] for s in found.servos[1:])
    assert found.bauds == (1_000_000, 57600)
    assert not found.noisy


def test_an_x_servo_set_to_protocol_1_is_named_too():
    odd = servo(6)
    odd.write(13, b"\x01")
    (found,) = scan(Rig([odd]).line, [57600], old_bauds=[57600]).servos
    assert (found.protocol, found.id, found.model, found.firmware) == (1, 6, "XM430-W350", 48)


def test_two_servos_of_one_id_clash_in_protocol_1():
    pair = [VirtualServo(AX, 3, angle=0.1), VirtualServo(AX, 3, angle=0.7), VirtualServo(AX, 4)]
    found = scan(Rig(pair).line, [], old_bauds=[1_000_000])
    assert [(s.id, s.clash) for s in found.servos] == [(3, True), (4, False)]


def test_an_echo_is_no_servo_and_a_servo_behind_an_echo_is_found():
    rig = Rig([VirtualServo(AX, 9)], Fault("echo"))
    found = scan(rig.line, [], old_bauds=[1_000_000])
    assert found.echo
    assert [(s.id, s.model) for s in found.servos] == [(9, "AX-12A")]


def test_an_xl320_and_a_p_servo_are_found_with_what_ails_them():
    small, strong = VirtualServo(control_table("XL320"), 1), VirtualServo(PH54, 2, baud_index=3)
    small.trip(0)
    strong.trip(1)
    first, second = scan(Rig([small, strong]).line, [1_000_000]).servos
    assert first.model == "XL320"
    assert "hardware error: overload" in first.notes
    assert second.model == "PH54-200-S500"
    assert "hardware error: motor hall sensor" in second.notes
