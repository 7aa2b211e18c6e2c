"""Virtual servos for a robot."""

from __future__ import annotations

from bridge.servo.registers import (
    BAUD_RATES,
    OPERATING_MODES,
    POSITION_UNIT,
    TickScale,
    control_table,
)
from bridge.virtual.bus import VirtualBus
from bridge.virtual.faults import FaultPlan
from bridge.virtual.servo import VirtualServo
from robots.errors import SpecError, nearest
from robots.spec import JointSpec, RobotSpec


def virtual_bus_for(
    robot: RobotSpec,
    bus: str | None = None,
    *,
    timing: bool = False,
    faults: FaultPlan | None = None,
) -> VirtualBus:
    """Return a bus with the servos that a robot has on one of its buses, in the robot's rest pose.

    The servos come as a robot builder leaves them: ids and bit rate set, everything else factory.

    Args:
        robot: The robot.
        bus: Name of the bus; may be left out if the robot has only one.
        timing: Whether bytes take the time of the bus's bit rate.
        faults: What goes wrong.

    Raises:
        SpecError: There is no such bus, it does not speak Protocol 2.0, or a servo has no table.
    """
    if bus is None and len(robot.buses) == 1:
        bus = next(iter(robot.buses))
    if bus is None or bus not in robot.buses:
        raise SpecError(
            f"{robot.name} has no bus '{bus}'" if bus else f"{robot.name} has several buses",
            allowed=", ".join(robot.buses),
            hint=nearest(bus or "", robot.buses),
        )
    spec = robot.buses[bus]
    if spec.protocol != 2.0:
        raise SpecError(
            f"protocol {spec.protocol}", where=f"{robot.name}: bus.{bus}", allowed="2.0"
        )
    if spec.baud not in BAUD_RATES:
        raise SpecError(
            f"baud {spec.baud}",
            where=f"{robot.name}: bus.{bus}",
            allowed=", ".join(map(str, BAUD_RATES)),
        )
    servos = [_servo(joint, spec.baud) for joint in robot.joints if joint.servo.bus == bus]
    return VirtualBus(servos, baud=spec.baud if timing else None, faults=faults)


def _servo(joint: JointSpec, baud: int) -> VirtualServo:
    servo = joint.servo
    scale = TickScale.of(servo.zero, servo.direction, servo.ratio)
    angle = (int(scale.to_ticks(joint.rest)[0]) - 2048) * POSITION_UNIT
    virtual = VirtualServo(control_table(servo.model), servo.id, baud_index=BAUD_RATES.index(baud))
    if OPERATING_MODES[servo.mode] != virtual.get("operating_mode"):
        # A multi-turn joint is meaningless in the factory mode: its builder has set the mode.
        virtual.memory.set("operating_mode", OPERATING_MODES[servo.mode])
    virtual.place(angle)
    virtual.memory.set("goal_position", virtual.get("present_position"))
    return virtual
