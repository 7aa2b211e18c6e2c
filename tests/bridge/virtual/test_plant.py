"""What hangs on the virtual bus: horns that obey at once, motors of their own, the robot's body."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from bridge import stages
from bridge.servo.registers import control_table
from bridge.virtual import VirtualBus, VirtualServo, virtual_bus_for
from bridge.virtual.mujoco_plant import MujocoPlant
from bridge.virtual.plant import PLANTS, SERVO
from robots.errors import SpecError
from robots.registry import load_robot
from robots.spec import RobotSpec

OP3, MARIONETTE = load_robot("op3"), load_robot("marionette")
ARM = """
<mujoco><compiler angle="radian"/><option gravity="{gravity}"/>
  <worldbody>
    <body><freejoint/><geom size=".02" mass="1"/>
      <body><joint name="arm" axis="0 -1 0" damping="{damping}"/>
        <inertial mass="0.5" pos="0.1 0 0" diaginertia="1e-4 1e-4 1e-4"/></body></body>
  </worldbody>
</mujoco>
"""
"""A weight of 0.5 kg on a massless arm of 0.1 m that points forward: 0.4905 N m at the joint."""
TORQUE = 0.5 * 9.81 * 0.1
UNITS = control_table("XM430-W350").units


def write(servo: VirtualServo, **registers: int) -> None:
    for name, value in registers.items():
        register = servo.memory.register(name)
        assert servo.write(register.address, register.encode(value)) == 0, name


def one_armed(tmp_path, gravity: str = "0 0 -9.81", damping: float = 0.0, **servo) -> RobotSpec:
    """Return a robot of one joint, driven by an XM430-W350."""
    model = tmp_path / "robot.xml"
    model.write_text(ARM.format(gravity=gravity, damping=damping))
    joint = dataclasses.replace(
        OP3.joints[0],
        name="arm",
        lower=-0.5,
        upper=0.5,
        rest=0.0,
        servo=dataclasses.replace(OP3.joints[0].servo, **servo),
    )
    return dataclasses.replace(
        OP3, name="arm", folder=tmp_path, model=model, joints=(joint,), landmarks={}
    )


def hang(robot: RobotSpec) -> tuple[VirtualBus, MujocoPlant]:
    bus = virtual_bus_for(robot, plant="mujoco")
    assert isinstance(bus.plant, MujocoPlant)
    bus.advance(0.0)
    return bus, bus.plant


def test_an_instant_horn_is_where_it_is_told_to_be():
    bus = virtual_bus_for(MARIONETTE, plant="instant")
    bus.advance(1.0)
    for servo in bus.servos:
        write(servo, torque_enable=1)
        write(servo, goal_position=2100)
        assert servo.get("present_position") == 2100
    bus.advance(60.0)
    assert {servo.get("present_temperature") for servo in bus.servos} == {25}


def test_an_instant_horn_stays_with_torque_off_and_comes_back_with_torque_on():
    servo = virtual_bus_for(MARIONETTE, plant="instant").servos[0]
    write(servo, goal_position=2100)
    assert servo.get("present_position") == 2048
    servo.place(0.3)
    write(servo, torque_enable=1)
    assert servo.get("present_position") == 2100


def test_an_instant_horn_turns_at_its_goal_velocity():
    servo = virtual_bus_for(MARIONETTE, plant="instant").servos[0]
    write(servo, operating_mode=1)
    write(servo, torque_enable=1)
    write(servo, goal_velocity=100)
    servo.advance(0.5)
    assert servo.angle == pytest.approx(100 * UNITS.velocity * 0.5)
    assert servo.get("present_velocity") == 100


def test_a_body_sags_below_the_goal_and_its_weight_shows_as_current(tmp_path):
    """The worked example of the module, with another arm."""
    bus, _ = hang(one_armed(tmp_path))
    servo = bus.servos[0]
    write(servo, torque_enable=1)
    bus.advance(3.0)
    table = control_table("XM430-W350")
    stiffness = 4.1 / UNITS.position * 800 / 128 / 885  # N m per rad at full voltage
    assert servo.angle == pytest.approx(-TORQUE / stiffness, rel=0.02)
    assert table.current_unit is not None
    amperes = servo.get("present_current") * table.current_unit
    assert amperes == pytest.approx(TORQUE / 4.1 * table.stall_current, rel=0.02)
    assert servo.get("present_velocity") == 0


@pytest.mark.parametrize("direction", [1, -1])
def test_torque_acts_along_the_joint_whichever_way_the_servo_is_mounted(tmp_path, direction):
    robot = one_armed(tmp_path, gravity="0 0 0", direction=direction, ratio=2.0, zero=1000)
    bus, plant = hang(robot)
    servo = bus.servos[0]
    assert servo.get("present_position") == 1000
    write(servo, torque_enable=1)
    write(servo, goal_position=1300)
    bus.advance(3.0)
    assert servo.get("present_position") == pytest.approx(1300, abs=1)
    expected = direction * 300 * UNITS.position / 2
    assert plant.data.qpos[0] == pytest.approx(expected, abs=2e-3)


def test_an_unloaded_servo_reaches_its_no_load_speed(tmp_path):
    bus, _ = hang(one_armed(tmp_path, gravity="0 0 0", damping=3.0))
    servo = bus.servos[0]
    write(servo, operating_mode=16)
    write(servo, torque_enable=1)
    write(servo, goal_pwm=885)
    bus.advance(0.9)
    assert servo.motor.velocity == pytest.approx(servo.table.no_load_speed, rel=0.01)
    write(servo, goal_pwm=442)
    bus.advance(1.8)
    assert servo.motor.velocity == pytest.approx(servo.table.no_load_speed / 2, rel=0.01)


def test_a_weaker_supply_pulls_less(tmp_path):
    bus, _ = hang(one_armed(tmp_path))
    servo = bus.servos[0]
    write(servo, torque_enable=1)
    bus.advance(0.9)
    before = servo.angle
    servo.supply *= 0.8
    bus.advance(1.8)
    assert servo.angle == pytest.approx(before / 0.8, rel=0.02)


def test_a_limp_arm_falls_and_a_driven_one_does_not(tmp_path):
    bus, plant = hang(one_armed(tmp_path, damping=0.05))
    bus.advance(0.0)
    bus.advance(0.9)
    assert bus.servos[0].angle < -1.0
    bus.servos[0].place(0.0)
    write(bus.servos[0], goal_position=2048, torque_enable=1)
    bus.advance(1.8)
    assert abs(bus.servos[0].angle) < 0.05
    assert plant.data.qpos[0] == pytest.approx(bus.servos[0].angle)


def test_a_horn_that_counts_turns_anew_does_not_move_the_body(tmp_path):
    robot = one_armed(tmp_path, gravity="0 0 0", mode="extended_position")
    bus, plant = hang(robot)
    servo = bus.servos[0]
    write(servo, torque_enable=1)
    write(servo, goal_position=2048 + 4096)
    for tick in range(1, 400):
        bus.advance(tick * 0.01)
    assert servo.angle == pytest.approx(math.tau, abs=0.01)
    write(servo, torque_enable=0)
    assert servo.clear_turns() == 0
    bus.advance(4.1)
    assert servo.angle == pytest.approx(0.0, abs=0.01)
    assert plant.data.qpos[0] == pytest.approx(math.tau, abs=0.01)


@pytest.mark.parametrize("robot", [OP3, MARIONETTE], ids=lambda robot: robot.name)
def test_a_robot_holds_its_rest_pose_in_the_air(robot):
    bus, plant = hang(robot)
    for servo in bus.servos:
        write(servo, torque_enable=1)
    bus.advance(1.0)
    present = np.array([servo.get("present_position") for servo in bus.servos])
    goal = np.array([servo.get("goal_position") for servo in bus.servos])
    assert 1 <= np.abs(present - goal).max() <= 15  # it sags, by less than 1.4 degrees
    assert plant.model.nq == len(robot.joints)
    assert plant.model.nu == 0
    assert plant.data.ncon == 0


def test_the_body_moves_the_same_way_however_often_the_bus_is_used():
    """Physics runs on its own grid: packets may come at any time and in any number."""
    ends = []
    for ticks in (np.linspace(0.0, 0.8, 7), np.linspace(0.0, 0.8, 211)):
        bus, plant = hang(MARIONETTE)
        for servo in bus.servos:
            write(servo, torque_enable=1)
            write(servo, goal_position=servo.get("goal_position") + 100)
        for now in ticks:
            bus.advance(float(now))
        ends.append(np.array(plant.data.qpos))
    assert np.array_equal(*ends)


def test_a_bus_that_starts_late_does_not_simulate_the_time_before(tmp_path):
    bus = virtual_bus_for(one_armed(tmp_path), plant="mujoco")
    assert isinstance(bus.plant, MujocoPlant)
    bus.advance(86_400.0)
    assert bus.plant.data.time == 0.0
    assert bus.servos[0].get("realtime_tick") == pytest.approx(86_400_000 % 32768, abs=3)
    bus.advance(86_401.0)
    assert bus.plant.data.time == pytest.approx(1.0)


def test_a_joint_that_is_not_in_the_model_is_named(tmp_path):
    robot = one_armed(tmp_path)
    lost = dataclasses.replace(robot, joints=(dataclasses.replace(robot.joints[0], name="leg"),))
    with pytest.raises(SpecError, match="leg"):
        virtual_bus_for(lost, plant="mujoco")


def test_an_unknown_plant_is_refused():
    with pytest.raises(SpecError, match="mujoco"):
        virtual_bus_for(OP3, plant="mujuco")


def test_a_body_on_two_buses_is_refused():
    bus = OP3.buses["main"]
    split = dataclasses.replace(
        OP3, buses={"main": bus, "more": dataclasses.replace(bus, name="more")}
    )
    with pytest.raises(SpecError, match="2 buses"):
        virtual_bus_for(split, "main", plant="mujoco")
    assert len(virtual_bus_for(split, "main", plant="instant").servos) == 20


def test_the_command_line_offers_every_plant():
    assert set(stages.PLANTS) == set(PLANTS)
    assert stages.PLANTS[0] == SERVO


def test_real_ports_have_no_plant(tmp_path):
    with pytest.raises(SpecError, match="virtual"):
        stages.play(
            (tmp_path / "a.npz", tmp_path / "b.npz"),
            tmp_path / "telemetry.jsonl",
            report=None,
            ports=("/dev/a", "virtual"),
            plant="mujoco",
        )
