"""The player in virtual time: what it promises, and what it does when things go wrong."""

from __future__ import annotations

import dataclasses
import threading
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.player import PlayerSettings, StopRequest, Verdict, play
from bridge.player.telemetry import read_telemetry
from bridge.ports import VIRTUAL, ports_of
from bridge.servo.clock import VirtualClock
from bridge.servo.sdk_transport import SdkTransport
from bridge.trajectory import JointTrajectory
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualSerial, virtual_bus_for
from robots.errors import (
    BusError,
    BusTimeout,
    DuetError,
    GateRefused,
    LimitViolation,
    PortLost,
    ServoFault,
    SpecError,
)
from robots.registry import load_robot
from robots.spec import RobotSpec

ROBOTS = (load_robot("op3"), load_robot("marionette"))
STEP = 0.02
BRISK = PlayerSettings(rate=50, ramp_time=0.5, settle_time=0.1, hold_time=0.1)
"""Short, so that the whole file runs in seconds."""


def dance(robot: RobotSpec, *, duration: float = 1.0, phase: float = 0.0) -> JointTrajectory:
    """Return a smooth trajectory around the rest pose, well inside all limits."""
    times = np.arange(0.0, duration + 1e-9, 0.02)
    room = np.minimum(robot.upper - robot.rest, robot.rest - robot.lower)
    amplitude = np.minimum(0.3, 0.8 * room)
    wave = np.sin(2 * np.pi * 0.5 * times[:, None] + phase + np.arange(len(room)))
    return JointTrajectory(times, robot.rest + amplitude * wave, robot.joint_names, robot.name)


DANCES = (dance(ROBOTS[0]), dance(ROBOTS[1], phase=1.0))


class Stage:
    """Two robots on virtual buses in virtual time, with everything recorded."""

    def __init__(self, *faults: Fault, b_faults: tuple[Fault, ...] = (), seed: int = 0):
        self.clock = VirtualClock(0.0)
        plans = (FaultPlan(faults, seed=seed), FaultPlan(b_faults, seed=seed + 1))
        self.wires: list[VirtualBus] = [
            virtual_bus_for(robot, timing=True, faults=plan)
            for robot, plan in zip(ROBOTS, plans, strict=True)
        ]
        self.goals: list[list[tuple[float, np.ndarray]]] = [[], []]
        self.open_ports = 0

    def connect(self, robot: RobotSpec, bus: str, port: str, clock, stack: ExitStack):
        wire = self.wires[ROBOTS.index(robot)]

        def opener(name: str, baud: int) -> VirtualSerial:
            self.open_ports += 1
            serial = VirtualSerial(wire, clock, baudrate=baud, timeout=0.005)
            close = serial.close

            def closed() -> None:
                self.open_ports -= 1
                close()

            serial.close = closed
            return serial

        return SdkTransport(port, robot.buses[bus].baud, opener=opener, clock=clock)

    def play(self, trajectories=DANCES, **options):
        options.setdefault("gate", Verdict(passed=True))
        options.setdefault("settings", BRISK)
        return play(trajectories, ROBOTS, clock=self.clock, connector=self.connect, **options)

    def torques(self) -> list[int]:
        return [s.memory.get("torque_enable") for wire in self.wires for s in wire.servos]

    def angles(self) -> np.ndarray:
        return np.array([servo.angle for wire in self.wires for servo in wire.servos])


def ticks(path: Path, robot: str = "a", state: str | None = None) -> list[dict]:
    lines = [line for line in read_telemetry(path) if line["kind"] == "tick"]
    return [x for x in lines if x["robot"] == robot and state in (None, x["state"])]


def states(path: Path) -> list[str]:
    return [x["state"] for x in read_telemetry(path) if x.get("event") == "state"]


# -- the way things should go ---------------------------------------------------------------------


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
        np.testing.assert_allclose(tick["goal"], DANCES[0].at(tick["phase"]), atol=1e-4)


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


def test_a_robot_on_two_buses_is_one_robot():
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
        settings=BRISK,
        clock=clock,
        connector=connector,
    )
    assert performance.completed
    assert [len(wire.servos) for wire in wires] == [9, 11, 20]
    split_tracking, whole_tracking = performance.tracking["a"], performance.tracking["b"]
    assert split_tracking.rms_deg == pytest.approx(whole_tracking.rms_deg, rel=0.1)


# -- refused before anything is opened ------------------------------------------------------------


def refused(error: type[DuetError], match: str, trajectories=DANCES, **options) -> None:
    stage = Stage()
    with pytest.raises(error, match=match):
        stage.play(trajectories, **options)
    assert [wire.instructions for wire in stage.wires] == [0, 0]
    assert stage.open_ports == 0


def changed(index: int, row: int, column: int, value: float):
    position = DANCES[index].position.copy()
    position[row, column] = value
    trajectories = list(DANCES)
    trajectories[index] = dataclasses.replace(DANCES[index], position=position)
    return trajectories


@pytest.mark.parametrize("row", [0, 30, -1])
def test_a_goal_outside_the_limits_is_refused_with_joint_time_and_limit(row):
    name = ROBOTS[1].joint_names[3]
    when = DANCES[1].times[row]
    beyond = changed(1, row, 3, ROBOTS[1].upper[3] + 0.01)
    refused(LimitViolation, rf"{name}.*at {when:.3f} s", beyond)


def test_a_trajectory_too_fast_for_a_joint_is_refused_but_plays_slower():
    step = ROBOTS[0].max_velocity[2] * 0.02 * 1.5
    before = DANCES[0].position[30, 2]
    fast = changed(0, 31, 2, before + step)
    refused(LimitViolation, rf"{ROBOTS[0].joint_names[2]}.*rad/s", fast)
    slow = dataclasses.replace(BRISK, speed=0.3)
    assert Stage().play(fast, settings=slow).completed


@given(row=st.integers(0, 50), column=st.integers(0, 19), bad=st.sampled_from([np.nan, np.inf]))
@settings(max_examples=20, deadline=None)
def test_a_goal_that_is_not_finite_cannot_even_be_a_trajectory(row, column, bad):
    with pytest.raises(LimitViolation, match=ROBOTS[0].joint_names[column]):
        changed(0, row, column, bad)


def test_a_trajectory_for_another_robot_is_refused():
    refused(LimitViolation, "is for 'marionette'", (DANCES[1], DANCES[1]))


def test_missing_and_unknown_joints_are_named():
    short = JointTrajectory(
        DANCES[0].times, DANCES[0].position[:, 1:], DANCES[0].joint_names[1:], "op3"
    )
    refused(LimitViolation, ROBOTS[0].joint_names[0], (short, DANCES[1]))
    names = ("r_sho_pich", *DANCES[0].joint_names[1:])
    odd = dataclasses.replace(DANCES[0], joint_names=names)
    refused(LimitViolation, "did you mean 'r_sho_pitch'", (odd, DANCES[1]))


def test_a_failed_report_is_refused_unless_forced_on_virtual_ports():
    failed = Verdict(passed=False)
    refused(GateRefused, "did not pass", gate=failed)
    refused(
        GateRefused,
        "did not pass",
        gate=failed,
        force=True,
        arm=True,
        ports=("/dev/ttyUSB0", VIRTUAL),
    )
    assert Stage().play(gate=failed, force=True).completed


def test_real_ports_need_to_be_armed():
    refused(GateRefused, "--arm", ports=("/dev/ttyUSB0", "/dev/ttyUSB1"))
    refused(SpecError, "one port", ports=("/dev/ttyUSB0", "/dev/ttyUSB0"), arm=True)


def test_ports_are_given_by_bus():
    robot = ROBOTS[0]
    assert ports_of(robot, "/dev/x") == {"main": "/dev/x"}
    assert ports_of(robot, {"main": "/dev/y"}) == {"main": "/dev/y"}
    with pytest.raises(SpecError, match="main"):
        ports_of(robot, {"mian": "/dev/y"})
    with pytest.raises(SpecError, match="main"):
        ports_of(robot, {})


@pytest.mark.parametrize("bad", [{"speed": 0.0}, {"rate": 0.0}, {"watchdog": 3.0}])
def test_settings_outside_their_ranges_are_refused(bad):
    with pytest.raises(SpecError, match=next(iter(bad))):
        PlayerSettings(**bad)


# -- the start ------------------------------------------------------------------------------------


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


# -- faults in the middle -------------------------------------------------------------------------


def test_lost_answers_are_coasted_over(tmp_path):
    stage = Stage(Fault("drop", probability=0.03), seed=2)
    performance = stage.play(telemetry=tmp_path / "t.jsonl")
    assert performance.completed
    assert performance.tracking["a"].missed_reads > 5
    assert performance.tracking["b"].missed_reads == 0


@pytest.mark.parametrize("kind", ["corrupt", "truncate", "noise", "duplicate"])
def test_spoilt_answers_do_not_stop_the_dance(kind):
    stage = Stage(Fault(kind, start=fault_time(0), probability=0.03), seed=3)
    performance = stage.play()
    assert performance.completed
    assert performance.tracking["a"].max_deg < 10


@cache
def start_of_play() -> float:
    """Return when the dance itself begins, s: virtual time is the same in every run."""
    stage, starts = Stage(), []
    stage.play(on_progress=lambda state, share: starts.append((stage.clock.now(), state)))
    return next(now for now, state in starts if state == "PLAY")


def fault_time(seconds: float) -> float:
    """Return a moment of the dance, s of the clock."""
    return start_of_play() + seconds


def test_a_servo_that_dies_freezes_both_robots_and_relaxes_them(tmp_path):
    path = tmp_path / "t.jsonl"
    dead = ROBOTS[1].joints[4].servo.id
    stage = Stage(b_faults=(Fault("silence", start=fault_time(0.5), servo_id=dead),))
    with pytest.raises(BusTimeout, match=ROBOTS[1].joint_names[4]) as caught:
        stage.play(telemetry=path)
    assert any("while relaxing" in note for note in caught.value.__notes__)
    assert states(path)[-2:] == ["FAULT", "RELAX"]
    off = [s.memory.get("torque_enable") for w in stage.wires for s in w.servos if s.id != dead]
    assert not any(off[:19])
    assert sum(stage.torques()) == 1  # the one that cannot hear
    assert stage.open_ports == 0
    last = read_telemetry(path)[-1]
    assert last["kind"] == "summary"
    assert not last["completed"]


def test_a_hardware_alert_stops_both_robots_and_names_joint_and_cause():
    joint = ROBOTS[0].joints[7]
    fault = Fault("hardware", start=fault_time(0.3), servo_id=joint.servo.id, bit=5)
    stage = Stage(fault)
    with pytest.raises(ServoFault, match=rf"{joint.name}.*overload"):
        stage.play()
    assert stage.torques() == [0] * 31


def test_a_servo_that_restarts_is_noticed():
    stage = Stage()
    servo = stage.wires[0].servos[6]
    done = []

    def brown_out(state: str, share: float) -> None:
        if state == "PLAY" and share > 0.3 and not done:
            done.append(servo.reboot(stage.clock.now()))

    with pytest.raises(ServoFault, match=rf"{ROBOTS[0].joint_names[6]}.*lost its torque"):
        stage.play(on_progress=brown_out)
    assert stage.torques() == [0] * 31


def test_a_joint_that_cannot_follow_ends_the_dance():
    stage = Stage()
    servo = stage.wires[0].servos[0]

    def jam(state: str, share: float) -> None:
        if state == "PLAY":
            servo.place(servo.angle if share < 0.2 else 1.5)

    with pytest.raises(ServoFault, match=ROBOTS[0].joint_names[0]):
        stage.play(on_progress=jam, settings=dataclasses.replace(BRISK, stray=0.6, stray_time=0.2))


@pytest.mark.parametrize("moment", [-0.9, -0.7, -0.3, 0.0, 0.5, 0.97])
def test_an_unplugged_adapter_relaxes_the_other_robot(moment):
    stage = Stage(Fault("unplug", start=max(0.0, fault_time(moment))))
    with pytest.raises(PortLost):
        stage.play()
    assert stage.torques()[20:] == [0] * 11
    assert stage.open_ports == 0


def test_servos_behind_an_unplugged_adapter_stop_by_themselves():
    stage = Stage(Fault("unplug", start=fault_time(0.5)))
    with pytest.raises(PortLost):
        stage.play()
    wire = stage.wires[0]
    assert any(stage.torques()[:20])
    wire.advance(stage.clock.now() + 1.0)
    held = [servo.get("bus_watchdog") for servo in wire.servos]
    assert held == [-1] * 20


def test_a_performance_that_cannot_be_relaxed_says_so():
    dead = ROBOTS[0].joints[1].servo.id
    stage = Stage()

    def kill(state: str, share: float) -> None:
        if state == "SETTLE" and share >= 1.0:
            stage.wires[0].faults.faults.append(Fault("silence", servo_id=dead))

    with pytest.raises(BusError, match=ROBOTS[0].joint_names[1]):
        stage.play(on_progress=kill)
    assert sum(stage.torques()) == 1


# -- stopping -------------------------------------------------------------------------------------


def stop_at(event: threading.Event, share_of_play: float, times: int = 1):
    def progress(state: str, share: float) -> None:
        if state == "PLAY" and share >= share_of_play and not event.is_set():
            for _ in range(times):
                event.set()

    return progress


@pytest.mark.parametrize("event", [StopRequest, threading.Event])
def test_a_stop_slows_down_along_the_path_then_holds_then_relaxes(tmp_path, event):
    stage, stop, path = Stage(), event(), tmp_path / "t.jsonl"
    performance = stage.play(telemetry=path, stop=stop, on_progress=stop_at(stop, 0.4))
    assert not performance.completed
    assert performance.outcome == "stopped"
    assert states(path)[-3:] == ["PLAY", "HOLD", "RELAX"]
    phases = [tick["phase"] for tick in ticks(path, state="PLAY")]
    steps = np.diff(phases)
    assert (steps <= STEP + 2e-5).all()
    falling = steps[21:]
    assert len(falling) == pytest.approx(25, abs=1)
    assert (np.diff(falling) <= 2e-5).all()
    assert falling[-1] < 0.002
    assert phases[-1] == pytest.approx(0.42 + 0.25, abs=0.03)
    assert stage.torques() == [0] * 31


def test_a_second_stop_relaxes_at_once(tmp_path):
    stage, stop, path = Stage(), StopRequest(), tmp_path / "t.jsonl"
    performance = stage.play(telemetry=path, stop=stop, on_progress=stop_at(stop, 0.4, times=2))
    assert performance.outcome == "stopped"
    assert states(path)[-2:] == ["PLAY", "RELAX"]
    assert len(ticks(path, state="PLAY")) < 25
    assert stage.torques() == [0] * 31


def test_a_stop_before_the_start_never_arms():
    stage, stop = Stage(), StopRequest()
    stop.set()
    assert stage.play(stop=stop).outcome == "stopped"
    assert stage.torques() == [0] * 31


def test_a_stop_in_the_ramp_ends_there(tmp_path):
    stage, stop, path = Stage(), StopRequest(), tmp_path / "t.jsonl"

    def progress(state: str, share: float) -> None:
        if state == "RAMP" and share > 0.3 and not stop.is_set():
            stop.set()

    stage.play(telemetry=path, stop=stop, on_progress=progress)
    assert states(path)[-3:] == ["RAMP", "HOLD", "RELAX"]


def test_a_keyboard_interrupt_relaxes_before_it_goes_on():
    stage = Stage()

    def interrupt(state: str, share: float) -> None:
        if state == "PLAY" and share > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stage.play(on_progress=interrupt)
    assert stage.torques() == [0] * 31
    assert stage.open_ports == 0


# -- time -----------------------------------------------------------------------------------------


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


# -- everything at once ---------------------------------------------------------------------------

KINDS = ("drop", "corrupt", "truncate", "duplicate", "noise", "deaf", "silence", "hardware")


@pytest.mark.parametrize("seed", range(6))
def test_random_fault_timelines_end_safely(seed, tmp_path):
    """No goal outside limits, no step beyond the speed limit, a relaxed end, nothing hangs."""
    rng = np.random.default_rng(seed)
    plans: list[list[Fault]] = [[], []]
    for plan, robot in zip(plans, ROBOTS, strict=True):
        for _ in range(int(rng.integers(0, 4))):
            kind = str(rng.choice(KINDS))
            start = float(rng.uniform(0, 2.5))
            target = robot.joints[int(rng.integers(len(robot.joints)))].servo.id
            plan.append(
                Fault(
                    kind,  # type: ignore[arg-type]
                    start=start,
                    end=start + float(rng.uniform(0.05, 1.0)),
                    probability=float(rng.uniform(0.01, 0.5)),
                    servo_id=target,
                )
            )
    stage = Stage(*plans[0], b_faults=tuple(plans[1]), seed=seed)
    path = tmp_path / "t.jsonl"
    try:
        outcome = stage.play(telemetry=path).outcome
    except BusError as error:
        outcome = str(error)
    assert outcome
    for person, robot in zip("ab", ROBOTS, strict=True):
        rows = ticks(path, person)
        if rows:
            goals = np.array([row["goal"] for row in rows])
            assert (goals >= robot.lower - 1e-4).all()
            assert (goals <= robot.upper + 1e-4).all()
            elapsed = np.diff([row["t"] for row in rows])[:, None] + 1e-4
            assert (np.abs(np.diff(goals, axis=0)) <= robot.max_velocity * elapsed).all()
    stage.clock.sleep_until(20.0)
    for plan, wire in zip(plans, stage.wires, strict=True):
        wire.advance(20.0)
        deaf = {fault.servo_id for fault in plan if fault.kind in ("silence", "deaf")}
        for servo in wire.servos:
            held = servo.memory.get("torque_enable")
            assert not held or deaf  # only who could not hear may still hold
    assert stage.open_ports == 0
