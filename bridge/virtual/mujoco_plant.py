"""The robot's own MuJoCo model on the bus: its weight and inertia are what the servos feel.

**The problem.** A motor that turns only itself cannot show what breaks on metal: an arm that sags,
a leg that swings past its goal, a current that rises with the pose. So here the servos' registers
stay what they are and a body is put between them. Time runs on the grid of the servos' own steps
(2 ms), whatever the bus does; each step of the grid is

1. every servo reads its horn's angle, runs profile and position controller, and sets a duty;
2. MuJoCo steps the body twice (1 ms each), the servo being a DC motor on its torque-speed line::

       torque = stall torque * (duty * supply - speed / no-load speed)

   The last term (back-EMF) is a damping of stall torque / no-load speed, which the implicit
   integrator takes exactly; it replaces the damping that the model gives the joint. So a servo
   that turns nothing reaches its no-load speed, and one that is held still its stall torque.
3. angles and speeds of the joints go back to the horns, where Present Position, Velocity, Current
   or Load show them.

Worked example: an XM430-W350 (4.1 N m, P gain 800) pulls with 18.9 N m per rad of error; an arm
that weighs 0.19 N m at the shoulder hangs 0.19 / 18.9 = 0.010 rad = 7 ticks below its goal, and
Present Current shows 0.19 / 4.1 = 4.6 % of the stall current.

**The base hangs.** A fixed base stays where the model has it; a free one is held at the height the
model gives it, upright, as on a gantry: the goals of a dance keep nobody on their feet. Two robots
on two buses do not feel each other. With torque off a joint keeps the damping and friction of its
model and sinks. A joint whose armature is less than that of the servo's rotor (as the motor's time
constant has it) gets the latter. The clock of the body starts with the first packet, however late
that comes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from bridge.servo.registers import control_table
from bridge.virtual.motor import MECHANICAL_TIME, STEP, Motor
from bridge.virtual.servo import VirtualServo
from robots.errors import SimDiverged, SpecError
from robots.mjcf import load_mjspec
from robots.spec import RobotSpec, ServoSpec

GRIP = 1e3
"""Friction of a joint that is held, N m: more than any servo here pulls with."""
SUBSTEPS = 2
"""Steps of MuJoCo in a step of the servos: 1 kHz."""
TURN = 2 * math.pi


@dataclass(slots=True)
class JointMotor(Motor):
    """A motor whose horn is moved by the body; it only says how it pushes."""

    effort: float = 0.0
    """Share of stall torque, before back-EMF."""
    driven: bool = False
    """Whether back-EMF brakes it: not with torque off."""

    def drive(self, duty: float, supply: float, load: float, dt: float) -> None:
        """Set the effort; arguments as for :meth:`Motor.drive`."""
        self.duty, self.driven = duty, True
        self.effort = duty * supply - load
        self.current = duty * supply - self.velocity / self.no_load_speed
        self.warm(dt)

    def coast(self, dt: float) -> None:
        """Let go."""
        self.duty = self.current = self.error_sum = self.effort = 0.0
        self.driven = False
        self.warm(dt)


class MujocoPlant:
    """Steps the servos of a robot and its model together."""

    def __init__(self, robot: RobotSpec, servos: Sequence[VirtualServo]) -> None:
        """Compile the model in the pose of the horns.

        Args:
            robot: The robot.
            servos: One per joint, in the order of the joints, each driven by a
                :class:`JointMotor`.

        Raises:
            SpecError: MuJoCo refuses the model, or a joint is not in it.
        """
        self._servos = tuple(servos)
        self._motors = [_joint_motor(servo) for servo in servos]
        self.model = _compile(robot)
        """``mujoco.MjModel`` of the robot, hung up."""
        self.data = mujoco.MjData(self.model)
        """``mujoco.MjData``."""
        joints = [_joint(self.model, robot, joint.name) for joint in robot.joints]
        self._qpos = np.array([self.model.jnt_qposadr[joint] for joint in joints])
        self._dof = np.array([self.model.jnt_dofadr[joint] for joint in joints])
        specs = [joint.servo for joint in robot.joints]
        zero = np.array([spec.zero for spec in specs])
        units = [control_table(spec.model).units for spec in specs]
        center = np.array([unit.center for unit in units])
        self._zero = (zero - center) * [unit.position for unit in units]
        self._gear = np.array([spec.direction * spec.ratio for spec in specs], float)
        stall = np.array([spec.hardware.stall_torque for spec in specs])
        speed = np.array([motor.no_load_speed for motor in self._motors])
        self._torque = self._gear * stall
        self._back_emf = self._gear**2 * stall / speed
        self._damping = np.array(self.model.dof_damping[self._dof])
        self._friction = np.array(self.model.dof_frictionloss[self._dof])
        self._turns = np.zeros(len(specs))
        self._seen: list[float] = []
        self._time = 0.0
        self._started = False
        self._take_over([motor.angle for motor in self._motors])

    def advance(self, now: float) -> None:
        """Let time pass until ``now`` s, on the servos' grid of steps.

        Raises:
            SimDiverged: The body's equations have no finite solution any more.
        """
        steps = int((now - self._time) / STEP + 1e-9)
        if not self._started:
            self._started = True
            self._time += steps * STEP
            steps = 0
        for _ in range(steps):
            self._time += STEP
            for servo in self._servos:
                servo.advance(self._between(now))
                servo.drive.wake()
            self._step()
        for servo in self._servos:
            servo.advance(self._between(now))

    def _between(self, now: float) -> float:
        """Return a time behind the last point of the grid, where rounding cannot add a step."""
        return min(now, self._time + STEP / 2)

    def _step(self) -> None:
        """Move the body by one step of the servos, and the horns with it."""
        data, motors = self.data, self._motors
        angles = [motor.angle for motor in motors]
        if angles != self._seen:
            self._take_over(angles)
        driven = np.array([motor.driven for motor in motors])
        self.model.dof_damping[self._dof] = np.where(driven, self._back_emf, self._damping)
        stuck = np.array([motor.stuck for motor in motors])
        self.model.dof_frictionloss[self._dof] = np.where(stuck, GRIP, self._friction)
        data.qfrc_applied[self._dof] = self._torque * [motor.effort for motor in motors]
        mujoco.mj_step(self.model, data, SUBSTEPS)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            raise SimDiverged(
                f"the body's accelerations are not finite after {data.time:.3f} s",
                hint="look at masses, armature and joint ranges of the robot's model",
            )
        self._seen = (self._horn(data.qpos[self._qpos]) + self._turns).tolist()
        speeds = (self._gear * data.qvel[self._dof]).tolist()
        for motor, angle, speed in zip(motors, self._seen, speeds, strict=True):
            motor.angle, motor.velocity = angle, speed

    def _horn(self, position: np.ndarray) -> np.ndarray:
        return self._zero + self._gear * position

    def _take_over(self, angles: list[float]) -> None:
        """Follow horns that were put elsewhere: by whole turns in name only, else by hand."""
        before = self._horn(self.data.qpos[self._qpos]) + self._turns
        moved = np.array(angles) - before
        turns = np.rint(moved / TURN) * TURN if self._seen else np.zeros(len(angles))
        self._turns += turns
        by_hand = np.abs(moved - turns) > 1e-9
        place = (np.array(angles) - self._turns - self._zero) / self._gear
        self.data.qpos[self._qpos[by_hand]] = place[by_hand]
        self.data.qvel[self._dof[by_hand]] = 0.0
        self._seen = list(angles)


def _joint_motor(servo: VirtualServo) -> JointMotor:
    if not isinstance(servo.motor, JointMotor):
        raise ValueError(f"servo {servo.id} does not have a JointMotor")
    return servo.motor


def _joint(model: Any, robot: RobotSpec, name: str) -> int:
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    if joint < 0:
        raise SpecError(
            f"joint '{name}' of robot.toml is not in the model",
            where=str(robot.model),
            hint=f"see 'pasdedeux robots {robot.name}'",
        )
    return joint


def _rotor_inertia(servo: ServoSpec) -> float:
    """Return what the rotor adds to the inertia of the joint, kg m^2, at the least."""
    hardware = servo.hardware
    return servo.ratio**2 * MECHANICAL_TIME * hardware.stall_torque / hardware.no_load_speed


def _compile(robot: RobotSpec) -> Any:
    """Return the robot's model with its base held and without actuators of its own."""
    spec = load_mjspec(robot)
    for key in list(spec.keys):
        spec.delete(key)
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    rotors = {joint.name: _rotor_inertia(joint.servo) for joint in robot.joints}
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            spec.delete(joint)
        else:
            joint.armature = max(joint.armature, rotors.get(joint.name, 0.0))
    spec.option.timestep = STEP / SUBSTEPS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    try:
        return spec.compile()
    except ValueError as error:
        raise SpecError(f"the model does not hang: {error}", where=str(robot.model)) from error
