"""Sweep and home on virtual servos that a hand moves; the file, and lerobot's."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import pytest

from bridge.servo.clock import VirtualClock
from bridge.servo.registers import control_table
from bridge.servo.sdk_transport import SdkTransport
from bridge.setup.calibrate import Limp, Sweep, limp_robot, measured, verify
from bridge.setup.calibration import (
    MARGIN,
    Calibration,
    JointCalibration,
    from_lerobot,
    to_lerobot,
)
from bridge.virtual import Fault, FaultPlan, VirtualSerial, virtual_bus_for
from robots.errors import BusError, ServoFault, SpecError
from robots.registry import load_robot
from tests.bridge.setup.rig import never, no, yes

ROBOT = load_robot("marionette")
TICK = control_table("XL330-M288").units.position
"""rad."""
NAMES = ("neck_pan", "l_elbow")
OFFSET = {"neck_pan": 150, "l_elbow": -300}
"""Ticks by which the horns of this unit sit off."""


class Unit:
    """A unit of the marionette whose joints a hand moves."""

    def __init__(self, *faults: Fault) -> None:
        self.clock = VirtualClock(1.0)
        self.wire = virtual_bus_for(ROBOT, faults=FaultPlan(faults))

    def put(self, name: str, angle: float) -> None:
        servo = self.wire.servo(ROBOT.joint(name).servo.id)
        servo.place(angle + OFFSET.get(name, 0) * TICK)

    @contextmanager
    def limp(self, joints: tuple[str, ...] = NAMES):
        def opener(port: str, baud: int):
            return VirtualSerial(self.wire, self.clock, baudrate=baud, timeout=0.005)

        def connector(robot, bus, port, clock, stack):
            return SdkTransport("test", robot.buses[bus].baud, opener=opener, clock=clock)

        with limp_robot(ROBOT, "test", self.clock, joints=joints, connector=connector) as limp:
            yield limp

    def hand(self, ends: dict[str, tuple[float, float]]) -> Callable[[], bool]:
        """Return the ``done`` of a sweep during which the joints go to both ends and back to 0."""
        way = [0.0, *(-k / 4 for k in range(1, 5)), *(k / 4 - 1 for k in range(9)), 0.5, 0.0]
        step = iter(way)

        def done() -> bool:
            share = next(step, None)
            for name, (low, high) in ends.items():
                self.put(name, (share or 0.0) * (high if (share or 0.0) > 0 else -low))
            return share is None

        return done


ENDS = {"neck_pan": (-1.2, 1.0), "l_elbow": (-0.2, 2.0)}


def swept(unit: Unit, limp: Limp, ends=ENDS) -> Sweep:
    return limp.sweep(unit.hand(ends))


def calibrated(unit: Unit) -> Calibration:
    with unit.limp() as limp:
        return measured(limp, swept(unit, limp), limp.pose(), unit="left", home="zero")


def test_zero_and_reach_of_a_unit_are_found():
    found = calibrated(Unit())
    for name, (low, high) in ENDS.items():
        joint = found.joints[name]
        assert abs(joint.zero - (2048 + OFFSET[name])) <= 1
        assert abs(joint.range_min - (joint.zero + low / TICK)) <= 2
        assert abs(joint.range_max - (joint.zero + high / TICK)) <= 2
        assert joint.firmware is not None


def test_a_unit_homed_in_its_rest_pose_has_the_same_zero():
    unit = Unit()
    with unit.limp() as limp:
        sweep = swept(unit, limp)
        for name in NAMES:
            unit.put(name, ROBOT.joint(name).rest)
        found = measured(limp, sweep, limp.pose(), unit="left", home="rest")
    for name in NAMES:
        assert abs(found.joints[name].zero - (2048 + OFFSET[name])) <= 1


def test_torque_goes_off_before_anything_is_measured():
    unit = Unit()
    for servo in unit.wire.servos:
        servo.write(64, b"\x01")
    with unit.limp():
        ids = {ROBOT.joint(name).servo.id for name in NAMES}
        assert all(unit.wire.servo(n).get("torque_enable") == 0 for n in ids)
        assert unit.wire.servo(1).get("torque_enable") == 1  # no joint that takes part


def test_lost_reads_are_missing_from_the_sweep_and_nothing_else():
    lossy = calibrated(Unit(Fault("drop", probability=0.05)))
    for name in NAMES:
        assert abs(lossy.joints[name].zero - (2048 + OFFSET[name])) <= 1


def test_a_joint_that_was_not_swept_is_named():
    unit = Unit()
    with unit.limp() as limp:
        sweep = swept(unit, limp, {"neck_pan": (-1.0, 1.0)})
        with pytest.raises(SpecError, match="l_elbow was hardly moved"):
            measured(limp, sweep, limp.pose(), unit="left", home="zero")


def test_a_reach_over_the_end_of_the_turn_is_refused():
    """Position mode cannot cross from tick 4095 to 0: the horn must be turned on its shaft."""
    unit = Unit()
    with unit.limp() as limp:
        sweep = swept(unit, limp, {**ENDS, "neck_pan": (-1.0, 3.1)})
        with pytest.raises(SpecError, match="neck_pan passes the end of its servo's turn"):
            measured(limp, sweep, limp.pose(), unit="left", home="zero")


def test_jumps_over_the_end_of_a_turn_are_unrolled():
    sweep = Sweep()
    for tick in (4000, 4090, 10, 100, 4090):
        sweep.see({"j": tick}, {"j": 4096})
    assert (sweep.low["j"], sweep.high["j"]) == (4000, 4196)


def test_a_home_pose_outside_of_the_sweep_is_refused():
    unit = Unit()
    with unit.limp() as limp:
        sweep = swept(unit, limp)
        unit.put("neck_pan", 1.3)
        with pytest.raises(SpecError, match="not swept as far"):
            measured(limp, sweep, limp.pose(), unit="left", home="zero")


def test_an_offset_in_a_servo_is_cleared_only_if_the_user_says_so(tmp_path):
    unit = Unit()
    elbow = unit.wire.servo(ROBOT.joint("l_elbow").servo.id)
    elbow.write(20, (99).to_bytes(4, "little"))
    with unit.limp() as limp:
        with pytest.raises(ServoFault, match="l_elbow"):
            limp.make_plain(no, tmp_path)
        assert elbow.get("homing_offset") == 99
        limp.make_plain(yes, tmp_path)
        assert elbow.get("homing_offset") == 0
        limp.make_plain(never, tmp_path)  # nothing left to ask
    assert len(list(tmp_path.iterdir())) == 1


def test_a_servo_of_another_model_is_no_unit_of_this_robot():
    unit = Unit()
    unit.wire.servo(ROBOT.joint("l_elbow").servo.id).memory.set("model_number", 1060)
    with pytest.raises(BusError, match="XL430"), unit.limp():
        pass


def test_a_unit_that_stands_as_calibrated_passes_and_a_turned_horn_does_not():
    unit = Unit()
    kept = calibrated(unit)
    with unit.limp() as limp:
        for name in NAMES:
            unit.put(name, 0.01)
        assert [d.problems for d in verify(limp, kept, home="zero")] == [(), ()]
        unit.put("neck_pan", 16 * TICK * 8)  # a spline tooth or so
        neck, elbow = verify(limp, kept, home="zero")
    assert "+11." in neck.problems[0]
    assert not elbow.problems


def test_a_calibrated_robot_never_gets_wider_limits():
    robot = calibrated(Unit()).apply(ROBOT)
    neck, elbow = robot.joint("neck_pan"), robot.joint("l_elbow")
    assert neck.lower == pytest.approx(-1.2 + MARGIN, abs=3e-3)
    assert neck.upper == pytest.approx(1.0 - MARGIN, abs=3e-3)
    assert elbow.lower == ROBOT.joint("l_elbow").lower  # it was swept further than designed
    assert robot.joint("waist") == ROBOT.joint("waist")
    assert elbow.servo.zero == pytest.approx(2048 - 300, abs=1)


def test_a_rest_pose_out_of_reach_is_refused():
    joint = JointCalibration(24, "XL330-M288", 2048, 1, 2400, 3000)
    with pytest.raises(SpecError, match="rest pose"):
        Calibration("marionette", "u", {"l_elbow": joint}).apply(ROBOT)


def test_a_calibration_of_another_robot_or_servo_is_refused():
    joint = JointCalibration(25, "XL330-M288", 2048, 1, 1000, 3000)
    with pytest.raises(SpecError, match="calibrate again"):
        Calibration("marionette", "u", {"l_elbow": joint}).apply(ROBOT)
    with pytest.raises(SpecError, match="is for 'op3'"):
        Calibration("op3", "u", {}).apply(ROBOT)


def test_a_file_comes_back_as_it_was(tmp_path):
    found = calibrated(Unit())
    found.save(tmp_path / "left.json")
    assert Calibration.load(tmp_path / "left.json") == found


def test_lerobots_file_says_the_same_both_ways(tmp_path):
    found = calibrated(Unit())
    path = tmp_path / "lerobot.json"
    rows = to_lerobot(found)
    path.write_text(json.dumps(rows))
    assert rows["l_elbow"] == {
        "id": 24,
        "drive_mode": 0,
        "homing_offset": 2047 - found.joints["l_elbow"].zero,
        "range_min": found.joints["l_elbow"].range_min + rows["l_elbow"]["homing_offset"],
        "range_max": found.joints["l_elbow"].range_max + rows["l_elbow"]["homing_offset"],
    }
    again = from_lerobot(path, ROBOT, unit="left")
    for name, joint in found.joints.items():
        other = again.joints[name]
        assert (other.zero, other.range_min, other.range_max) == (
            joint.zero,
            joint.range_min,
            joint.range_max,
        )


GOOD = {"id": 24, "drive_mode": 0, "homing_offset": 0, "range_min": 1000, "range_max": 3000}


@pytest.mark.parametrize(
    ("row", "word"),
    [
        ({**GOOD, "id": 3}, "id 3"),
        ({**GOOD, "drive_mode": 1}, "reversed"),
        ({**GOOD, "range_max": 1000}, "empty"),
        ({**GOOD, "range_max": "3000"}, "whole numbers"),
        ({**GOOD, "homing_offset": 9000}, "tick"),
        ({"id": 24}, "not a motor"),
        (3, "not a motor"),
    ],
)
def test_a_lerobot_file_that_cannot_be_meant_is_refused(tmp_path: Path, row, word):
    path = tmp_path / "lerobot.json"
    path.write_text(json.dumps({"l_elbow": row}))
    with pytest.raises(SpecError, match=word):
        from_lerobot(path, ROBOT, unit="u")


def test_a_range_that_lerobots_limits_cannot_hold_is_refused():
    joint = JointCalibration(24, "XL330-M288", 500, 1, 400, 3900)
    with pytest.raises(SpecError, match="one turn"):
        to_lerobot(Calibration("marionette", "u", {"l_elbow": joint}))


def test_lerobots_file_in_the_wrong_place_is_recognised(tmp_path):
    path = tmp_path / "x.json"
    path.write_text(json.dumps({"l_elbow": GOOD}))
    with pytest.raises(SpecError, match="--from-lerobot"):
        Calibration.load(path)


def test_degrees_of_margin_are_what_the_documentation_says():
    assert math.degrees(MARGIN) == pytest.approx(2)
