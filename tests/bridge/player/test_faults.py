"""What the player does when servos, wires and adapters fail."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bridge.player.telemetry import read_telemetry
from bridge.virtual import Fault
from robots.errors import (
    BusError,
    BusTimeout,
    PortLost,
    ServoFault,
)
from tests.bridge.player.stage import BRISK, ROBOTS, Stage, fault_time, states, ticks


def test_lost_answers_are_coasted_over(tmp_path):
    stage = Stage(Fault("drop", start=fault_time(0), probability=0.1), seed=2)
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
    fault = Fault("hardware", start=fault_time(0.3), servo_id=joint.servo.id, value=5)
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
