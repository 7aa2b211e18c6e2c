"""How one unit of a robot was put together: zero, direction and reach of each joint, in a file.

**The problem.** ``robot.toml`` describes the design; every unit built from it has its horns a
spline tooth off and its own end stops. That belongs neither into the design nor into the servos (an
offset there is invisible and moves their limits), so it is a file per unit.

Ticks are those of a servo whose homing offset and drive mode are 0::

    tick = zero + direction * ratio * angle * 4096 / 2 pi      within range_min .. range_max

**lerobot** keeps the same facts otherwise: it writes a homing offset into the servo, so that the
pose in which it was homed reads 2047, and counts the range from there. Worked example, a joint that
is homed at tick 2200 and reaches from 1500 to 3000::

    here      zero 2200, range 1500 .. 3000
    lerobot   homing_offset 2047 - 2200 = -153, range 1347 .. 2847
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from bridge.servo.registers import TickScale, control_table
from bridge.setup.backup import read_object
from robots.errors import SpecError, nearest
from robots.files import plain, write_json
from robots.servos import servo_model
from robots.spec import JointSpec, RobotSpec

SCHEMA = "pasdedeux.calibration/1"
MARGIN = math.radians(2)
"""rad that a calibrated joint stays away from the ends of its sweep."""
LEROBOT_HOME = 2047
"""What lerobot makes a servo read in the pose in which it is homed."""
LEROBOT_KEYS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")

Home = Literal["zero", "rest"]
"""Pose in which a robot is homed: all joints at 0, or its rest pose."""
HOMES: tuple[Home, ...] = ("zero", "rest")


@dataclass(frozen=True, slots=True)
class JointCalibration:
    """One joint of one unit; ticks of a servo without offset or reversal of its own."""

    id: int
    """Servo id."""
    model: str
    """The maker's name."""
    zero: int
    """Tick at joint angle 0."""
    direction: int
    """+1 if ticks grow with the angle, -1 if they fall."""
    range_min: int
    """Lowest tick that the joint reached."""
    range_max: int
    """Highest."""
    firmware: int | None = None
    """Of the servo; ``None`` if not known."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.range_min >= self.range_max:
            raise SpecError(
                f"range {self.range_min} to {self.range_max} is empty", where=f"servo {self.id}"
            )
        if self.direction not in (-1, 1):
            raise SpecError(f"direction {self.direction}", where=f"servo {self.id}", allowed="+-1")


@dataclass(frozen=True, slots=True)
class Calibration:
    """One unit of a robot."""

    robot: str
    """Name of the design."""
    unit: str
    """Name of the unit, for people."""
    joints: dict[str, JointCalibration]
    """By joint name."""

    def save(self, path: Path) -> None:
        """Write it as JSON."""
        write_json(path, {"schema": SCHEMA, **plain(self)})

    @classmethod
    def load(cls, path: Path) -> Calibration:
        """Read one.

        Raises:
            SpecError: The file is not a calibration.
        """
        data = read_object(path)
        if data.get("schema") != SCHEMA:
            hint = ""
            if all(isinstance(row, dict) and "homing_offset" in row for row in data.values()):
                hint = "it looks like lerobot's: calibrate --from-lerobot reads it"
            raise SpecError("is not a calibration", where=str(path), allowed=SCHEMA, hint=hint)
        try:
            joints = {
                str(name): JointCalibration(**row) for name, row in dict(data["joints"]).items()
            }
            return cls(str(data["robot"]), str(data["unit"]), joints)
        except (KeyError, TypeError, ValueError) as error:
            raise SpecError(f"is damaged: {error}", where=str(path)) from error

    def apply(self, robot: RobotSpec) -> RobotSpec:
        """Return the robot with this unit's zeros, directions and limits.

        Limits shrink to what the sweep reached, less :data:`MARGIN`; they never grow. Joints that
        are not in the file stay as designed.

        Raises:
            SpecError: The calibration is of another robot, or of other servos, or the rest pose is
                out of a joint's reach.
        """
        if robot.name != self.robot:
            raise SpecError(
                f"the calibration of unit '{self.unit}' is for '{self.robot}'", where=robot.name
            )
        for name in self.joints:
            robot.joint(name)
        joints = tuple(
            _calibrated(joint, self.joints[joint.name]) if joint.name in self.joints else joint
            for joint in robot.joints
        )
        return replace(robot, joints=joints)


def _calibrated(joint: JointSpec, found: JointCalibration) -> JointSpec:
    servo = joint.servo
    if (servo.id, servo.model) != (found.id, found.model):
        raise SpecError(
            f"was calibrated with servo {found.id} ({found.model}),"
            f" the robot's file has {servo.id} ({servo.model})",
            where=f"joint.{joint.name}",
            hint="calibrate again",
        )
    servo = replace(servo, zero=found.zero, direction=found.direction)
    scale = TickScale.of_servos([servo])
    ends = sorted(float(scale.from_ticks(tick)[0]) for tick in (found.range_min, found.range_max))
    lower, upper = max(joint.lower, ends[0] + MARGIN), min(joint.upper, ends[1] - MARGIN)
    if not lower <= joint.rest <= upper:
        raise SpecError(
            f"the rest pose, {math.degrees(joint.rest):.0f} degrees, is out of this unit's reach",
            where=f"joint.{joint.name}",
            allowed=f"{math.degrees(lower):.0f} to {math.degrees(upper):.0f} degrees",
            hint="sweep the joint further, or check the home pose and direction",
        )
    return replace(joint, lower=lower, upper=upper, servo=servo)


def home_angle(joint: JointSpec, home: Home) -> float:
    """Return where a joint stands in the home pose, rad."""
    return joint.rest if home == "rest" else 0.0


def zero_at(joint: JointSpec, tick: int, home: Home) -> int:
    """Return the tick of joint angle 0 if the servo reads ``tick`` in the home pose.

    Raises:
        SpecError: It would lie beyond the servo's turn.
    """
    servo = joint.servo
    tables = [control_table(servo.model)]
    away = TickScale.of(0, servo.direction, servo.ratio, tables).to_ticks(home_angle(joint, home))
    zero = tick - int(away[0])
    first, last = servo.hardware.first, servo.hardware.last
    if not first <= zero <= last:
        raise SpecError(
            f"angle 0 would be at tick {zero}",
            where=f"joint.{joint.name}",
            allowed=f"{first} to {last}",
            hint="is it in the home pose? else turn the horn on the shaft",
        )
    return zero


def to_lerobot(calibration: Calibration) -> dict[str, dict[str, int]]:
    """Return lerobot's calibration of the same unit: by joint, with :data:`LEROBOT_KEYS`.

    The drive mode is always 0: nothing reverses the servo itself.

    Raises:
        SpecError: A range does not fit into the one turn that lerobot's limits have.
    """
    rows: dict[str, dict[str, int]] = {}
    for name, joint in calibration.joints.items():
        offset = LEROBOT_HOME - joint.zero
        low, high = joint.range_min + offset, joint.range_max + offset
        last = servo_model(joint.model).last
        if low < 0 or high > last:
            raise SpecError(
                f"its range would be {low} to {high}",
                where=f"joint.{name}",
                allowed=f"0 to {last}",
                hint="lerobot's limits hold one turn around the home pose",
            )
        values = (joint.id, 0, offset, low, high)
        rows[name] = dict(zip(LEROBOT_KEYS, values, strict=True))
    return rows


def from_lerobot(path: Path, robot: RobotSpec, *, unit: str, home: Home = "zero") -> Calibration:
    """Read lerobot's calibration file of a unit.

    Args:
        path: ``{joint: {id, drive_mode, homing_offset, range_min, range_max}}``.
        robot: The design; joints are matched by name.
        unit: Name for the unit.
        home: The pose in which the unit was homed there.

    Raises:
        SpecError: The file is damaged, names joints or ids that the robot does not have, or was
            made with reversed servos.
    """
    joints: dict[str, JointCalibration] = {}
    for name, row in read_object(path).items():
        where = f"{path}: {name}"
        if name not in robot.joint_names:
            raise SpecError(
                f"{robot.name} has no such joint",
                where=where,
                allowed=", ".join(robot.joint_names),
                hint=nearest(name, robot.joint_names),
            )
        values = _lerobot_row(row, where)
        joint = robot.joint(name)
        if values["id"] != joint.servo.id:
            raise SpecError(f"id {values['id']}", where=where, allowed=str(joint.servo.id))
        if values["drive_mode"]:
            raise SpecError(
                f"drive_mode {values['drive_mode']}",
                where=where,
                allowed="0",
                hint="a reversed servo counts otherwise: calibrate this unit here",
            )
        offset = values["homing_offset"]
        joints[name] = JointCalibration(
            id=joint.servo.id,
            model=joint.servo.model,
            zero=zero_at(joint, LEROBOT_HOME - offset, home),
            direction=joint.servo.direction,
            range_min=values["range_min"] - offset,
            range_max=values["range_max"] - offset,
        )
    if not joints:
        raise SpecError("names no joint", where=str(path))
    return Calibration(robot.name, unit, joints)


def _lerobot_row(row: Any, where: str) -> dict[str, int]:
    if not isinstance(row, Mapping) or set(row) != set(LEROBOT_KEYS):
        raise SpecError("is not a motor of lerobot", where=where, allowed=", ".join(LEROBOT_KEYS))
    if any(type(value) is not int for value in row.values()):
        raise SpecError(f"holds {json.dumps(row)[:80]}", where=where, allowed="whole numbers")
    return {str(key): value for key, value in row.items()}
