"""The player in virtual time: the way things should go, the start, and lateness."""

from __future__ import annotations

import dataclasses
import itertools
import time
from contextlib import ExitStack

import numpy as np
import pytest

from bridge.player import Verdict, play
from bridge.servo.clock import VirtualClock
from bridge.servo.sdk_transport import SdkTransport
from bridge.trajectory import JointTrajectory
from bridge.virtual import Fault, VirtualBus, VirtualSerial, virtual_bus_for
from robots.errors import (
    BusTimeout,
    ServoFault,
)
from robots.spec import RobotSpec
from tests.bridge.player.stage import BRISK, DANCES, ROBOTS, SMALL, STEP, Stage, states, ticks


def test_a_duet_is_played_from_rest_to_rest(tmp_path):
    stage = Stage()
    performance = stage.play(telemetry=tmp_path / "t.jsonl")
    assert performance.completed
    assert performance.ticks == 51
    assert performance.dropped_ticks == 0
    assert states(tmp_path / "t.jsonl") == [
        *("DISCOVERED", "CONFIGURED", "ARMED", "RAMP", "PLAY", "SETTLE", "RELAX")
    ]
    assert stage.torques() == [0] * 31
    assert stage.open_ports == 0
    for person in "ab":
        tracking = performance.tracking[person]
        assert 0.1 < tracking.rms_deg < 3.0
        assert 20 < tracking.lag_ms < 80
        assert tracking.rms_without_lag_deg < 0.3
        assert tracking.missed_reads == 0


def test_a_performance_is_the_same_every_time():
    first, second = Stage().play(), Stage().play()
    assert first == second


def test_goals_are_the_trajectory_at_absolute_times(tmp_path):
    Stage().play(telemetry=tmp_path / "t.jsonl")
    played = ticks(tmp_path / "t.jsonl", state="PLAY")
    start = played[0]["t"]
    for tick in played:
        assert tick["phase"] == pytest.approx(tick["t"] - start, abs=1e-4)
        sample = DANCES[0].position[round(tick["phase"] / STEP)]
        np.testing.assert_allclose(tick["goal"], sample, atol=1e-4)


def test_both_robots_are_at_the_same_phase_in_every_tick(tmp_path):
    Stage().play(telemetry=tmp_path / "t.jsonl")
    a, b = (ticks(tmp_path / "t.jsonl", robot) for robot in "ab")
    assert [x["phase"] for x in a] == [x["phase"] for x in b]
    assert len(a) > 75


def test_joints_are_matched_by_name_not_by_column():
    shuffled = []
    for trajectory in DANCES:
        order = np.random.default_rng(1).permutation(len(trajectory.joint_names))
        shuffled.append(
            JointTrajectory(
                trajectory.times,
                trajectory.position[:, order],
                tuple(trajectory.joint_names[i] for i in order),
                trajectory.robot,
            )
        )
    assert Stage().play(shuffled) == Stage().play()


def test_half_the_speed_takes_twice_the_time():
    performance = Stage().play(settings=dataclasses.replace(BRISK, speed=0.5))
    assert performance.duration == pytest.approx(2.0, abs=0.021)


def test_progress_is_told():
    told = []
    Stage().play(on_progress=lambda state, share: told.append((state, share)))
    shares = [share for state, share in told if state == "PLAY"]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_telemetry_is_complete_up_to_a_crash(tmp_path):
    """Each line is with the system as soon as it is written."""
    path = tmp_path / "t.jsonl"
    seen = []

    def crash(state: str, share: float) -> None:
        if state == "PLAY" and share > 0.5:
            seen.append(len(ticks(path, state="PLAY")))
            raise RuntimeError("a bug in somebody's callback")

    stage = Stage()
    with pytest.raises(RuntimeError):
        stage.play(telemetry=path, on_progress=crash)
    assert seen[0] > 20
    assert stage.torques() == [0] * 31
    assert stage.open_ports == 0


def test_a_robot_on_two_buses_is_one_robot(tmp_path):
    robot = ROBOTS[0]
    bus = robot.buses["main"]
    split = dataclasses.replace(
        robot,
        buses={name: dataclasses.replace(bus, name=name) for name in ("left", "right")},
        joints=tuple(
            dataclasses.replace(
                joint,
                servo=dataclasses.replace(
                    joint.servo, bus="left" if "l_" in joint.name else "right"
                ),
            )
            for joint in robot.joints
        ),
    )
    clock = VirtualClock()
    wires: list[VirtualBus] = []

    def connector(robot: RobotSpec, bus: str, port: str, clock, stack: ExitStack):
        wires.append(virtual_bus_for(robot, bus, timing=True))

        def opener(name: str, baud: int, wire: VirtualBus = wires[-1]) -> VirtualSerial:
            return VirtualSerial(wire, clock, baudrate=baud, timeout=0.005)

        return SdkTransport(port, robot.buses[bus].baud, opener=opener, clock=clock)

    performance = play(
        (DANCES[0], DANCES[0]),
        (split, robot),
        ports=({"left": "/dev/l", "right": "/dev/r"}, "/dev/other"),
        gate=Verdict(passed=True),
        arm=True,
        write_eeprom=True,
        backups=tmp_path,
        settings=BRISK,
        clock=clock,
        connector=connector,
    )
    assert performance.completed
    assert [len(wire.servos) for wire in wires] == [9, 11, 20]
    split_tracking, whole_tracking = performance.tracking["a"], performance.tracking["b"]
    assert split_tracking.rms_deg == pytest.approx(whole_tracking.rms_deg, rel=0.1)


@pytest.mark.parametrize("seed", range(4))
def test_from_any_pose_the_first_pose_is_reached_softly(seed, tmp_path):
    """A first frame far from the present pose must not make the robots lunge."""
    rng = np.random.default_rng(seed)
    stage, path = Stage(), tmp_path / "t.jsonl"
    for robot, wire in zip(ROBOTS, stage.wires, strict=True):
        for joint, servo in zip(robot.joints, wire.servos, strict=True):
            angle = rng.uniform(joint.lower, joint.upper)
            servo.place(
                joint.servo.direction * angle + (joint.servo.zero - 2048) * 2 * np.pi / 4096
            )
            servo.memory.set("goal_position", int(rng.integers(0, 4096)))
    assert stage.play(telemetry=path).completed
    for person, robot in zip("ab", ROBOTS, strict=True):
        ramp = ticks(path, person, "RAMP")
        goals, present = (np.array([row[key] for row in ramp]) for key in ("goal", "present"))
        np.testing.assert_allclose(goals[0], present[0], atol=3e-3)
        bound = 0.2 * robot.max_velocity
        assert (np.abs(np.diff(goals, axis=0)) <= bound * STEP + 2e-5).all()
        assert np.abs(np.diff(goals, axis=0)).max() > 0.3 * bound.min() * STEP  # it did move
        # What the horns did, over five ticks: their own step response averages out.
        moved = np.abs(present[5:] - present[:-5]) / (5 * STEP)
        assert (moved <= 1.15 * bound).all()


def test_torque_stays_off_when_a_servo_is_missing():
    stage = Stage(b_faults=(Fault("silence", servo_id=ROBOTS[1].joints[2].servo.id),))
    with pytest.raises(BusTimeout, match=ROBOTS[1].joint_names[2]):
        stage.play()
    assert stage.torques() == [0] * 31
    assert stage.open_ports == 0


def test_a_wrong_model_is_refused_by_name():
    stage = Stage()
    stage.wires[0].servos[3].memory.set("model_number", 1060)
    with pytest.raises(ServoFault, match=rf"{ROBOTS[0].joint_names[3]}.*XL430-W250"):
        stage.play()
    assert stage.torques() == [0] * 31


def test_torque_left_on_by_a_dead_player_is_no_reason_to_lunge():
    """After a kill the servos hold, stopped by their watchdog; the next start takes over."""
    stage = Stage()
    for wire in stage.wires:
        for servo in wire.servos:
            servo.memory.set("torque_enable", 1)
            servo.memory.set("bus_watchdog", -1)
            servo._reload()
    assert stage.play().completed


def stall(stage: Stage, seconds: float):
    done = []

    def progress(state: str, share: float) -> None:
        if state == "PLAY" and share > 0.4 and not done:
            done.append(stage.clock.sleep_until(stage.clock.now() + seconds))

    return progress


def test_late_ticks_are_left_out_never_caught_up(tmp_path):
    stage, path = Stage(), tmp_path / "t.jsonl"
    performance = stage.play(telemetry=path, on_progress=stall(stage, 0.1))
    assert performance.completed
    assert performance.dropped_ticks == pytest.approx(4, abs=1)
    assert performance.duration == pytest.approx(1.0, abs=0.021)
    times = [tick["t"] for tick in ticks(path, state="PLAY")]
    assert min(np.diff(times)) > STEP - 1e-4  # no burst
    goals = np.array([tick["goal"] for tick in ticks(path, state="PLAY")])
    speed = np.abs(np.diff(goals, axis=0)) / np.diff(times)[:, None]
    assert (speed <= ROBOTS[0].max_velocity).all()


def test_a_host_that_stalls_too_long_gives_up_safely():
    stage = Stage()
    with pytest.raises(BusTimeout, match="paused"):
        stage.play(on_progress=stall(stage, 1.0))
    assert stage.torques() == [0] * 31


@pytest.mark.parametrize("leap", [3600.0, -3600.0])
def test_setting_the_wall_clock_changes_nothing(monkeypatch, leap):
    undisturbed = Stage(robots=SMALL).play()
    steps = itertools.count()
    monkeypatch.setattr(time, "time", lambda: 1.7e9 + leap * next(steps))
    assert Stage(robots=SMALL).play() == undisturbed
