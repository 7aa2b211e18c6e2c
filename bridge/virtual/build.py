"""Virtual servos for a robot."""

from __future__ import annotations

from bridge.servo.registers import (
    BAUD_RATES,
    OPERATING_MODES,
    ControlTable,
    TickScale,
    control_table,
)
from bridge.virtual.bus import VirtualBus
from bridge.virtual.drive import Drive
from bridge.virtual.faults import FaultPlan
from bridge.virtual.instant import InstantDrive
from bridge.virtual.plant import INSTANT, MUJOCO, SERVO, require_plant
from bridge.virtual.servo import VirtualServo
from robots.errors import SpecError, nearest
from robots.spec import JointSpec, RobotSpec


def virtual_bus_for(
    robot: RobotSpec,
    bus: str | None = None,
    *,
    timing: bool = False,
    faults: FaultPlan | None = None,
    plant: str = SERVO,
) -> VirtualBus:
    """Return a bus with the servos that a robot has on one of its buses, in the robot's rest pose.

    The servos come as a robot builder leaves them: ids and bit rate set, everything else factory.

    Args:
        robot: The robot.
        bus: Name of the bus; may be left out if the robot has only one.
        timing: Whether bytes take the time of the bus's bit rate.
        faults: What goes wrong.
        plant: What moves, one of :data:`~bridge.virtual.plant.PLANTS`.

    Raises:
        SpecError: There is no such bus or plant, the bus does not speak Protocol 2.0, a servo has
            no table, or the robot's model cannot hang on this bus.
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
    require_plant(plant, robot)
    servos = [_servo(joint, spec.baud, plant) for joint in robot.joints if joint.servo.bus == bus]
    body = None
    if plant == MUJOCO:
        from bridge.virtual.mujoco_plant import MujocoPlant  # MuJoCo is loaded where it is needed

        body = MujocoPlant(robot, servos)
    return VirtualBus(servos, baud=spec.baud if timing else None, faults=faults, plant=body)


def _drive(table: ControlTable, plant: str) -> Drive:
    if plant == INSTANT:
        return InstantDrive(table, 0.0)
    if plant == MUJOCO:
        from bridge.virtual.mujoco_plant import JointMotor

        return Drive(table, 0.0, JointMotor(table.no_load_speed))
    return Drive(table, 0.0)


def _servo(joint: JointSpec, baud: int, plant: str) -> VirtualServo:
    servo = joint.servo
    table = control_table(servo.model)
    tick = int(TickScale.of_servos([servo]).to_ticks(joint.rest)[0])
    angle = (tick - table.units.center) * table.units.position
    virtual = VirtualServo(
        table, servo.id, baud_index=BAUD_RATES.index(baud), drive=_drive(table, plant)
    )
    if OPERATING_MODES[servo.mode] != virtual.get("operating_mode"):
        # A multi-turn joint is meaningless in the factory mode: its builder has set the mode.
        virtual.memory.set("operating_mode", OPERATING_MODES[servo.mode])
    virtual.place(angle)
    virtual.memory.set("goal_position", virtual.get("present_position"))
    return virtual
