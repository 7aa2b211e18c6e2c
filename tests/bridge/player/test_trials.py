"""Dry runs, single joints, and servos whose EEPROM is not as it should be."""

from __future__ import annotations

import dataclasses

import pytest

from bridge.player import Verdict
from bridge.servo.registers import control_table
from bridge.virtual import Fault, VirtualServo
from robots.errors import ServoFault, SpecError
from tests.bridge.player.stage import BRISK, SMALL, Stage, states, ticks

REAL = ("/dev/ttyUSB0", "/dev/ttyUSB1")
DRY = dataclasses.replace(BRISK, dry_run=True)


def registers(servo: VirtualServo, area: str | None = None) -> dict[str, int]:
    """Return what a client can write."""
    spans = control_table(servo.table.name).spans
    rows = [r for r in spans if r.access == "rw" and area in (None, r.area)]
    return {row.name: servo.memory.get(row.name) for row in rows}


def every(stage: Stage, area: str | None = None) -> list[dict[str, int]]:
    return [registers(servo, area) for wire in stage.wires for servo in wire.servos]


def test_a_dry_run_reads_everything_and_writes_nothing(tmp_path):
    """Not even on real ports, so it needs neither --arm nor a clear stage."""
    stage, path = Stage(robots=SMALL), tmp_path / "t.jsonl"
    before, stood = every(stage), stage.angles()
    performance = stage.play(settings=DRY, telemetry=path, ports=REAL)
    assert performance.completed
    assert every(stage) == before
    assert (stage.angles() == stood).all()
    assert states(path)[-4:] == ["RAMP", "PLAY", "SETTLE", "RELAX"]
    assert ticks(path, state="PLAY")[-1]["present"] == ticks(path, state="RAMP")[0]["present"]


def test_a_dry_run_finds_what_a_performance_would_refuse():
    stage = Stage(robots=SMALL)
    stage.wires[1].servos[2].memory.set("homing_offset", 100)
    with pytest.raises(ServoFault, match=rf"{SMALL[1].joint_names[2]}.*homing_offset"):
        stage.play(settings=DRY, gate=Verdict(passed=False), force=True, ports=REAL)


def test_joints_that_do_not_play_are_not_even_spoken_to():
    """A servo that is missing does not matter then."""
    absent = SMALL[0].joints[1]
    stage = Stage(Fault("silence", servo_id=absent.servo.id), robots=SMALL)
    others = [registers(stage.wires[0].servos[1]), registers(stage.wires[1].servos[0])]
    torque = []
    assert stage.play(
        without=[absent.name, SMALL[1].joint_names[0]],
        on_progress=lambda state, share: torque.append(stage.torques()),
    ).completed
    assert [registers(stage.wires[0].servos[1]), registers(stage.wires[1].servos[0])] == others
    assert max(torque) == [1, 0, 1, 0, 1, 1]


def test_one_joint_of_each_robot_can_play_alone(tmp_path):
    stage, path = Stage(robots=SMALL), tmp_path / "t.jsonl"
    names = [SMALL[0].joint_names[2], SMALL[1].joint_names[1]]
    performance = stage.play(only=names, telemetry=path)
    assert performance.completed
    assert len(ticks(path)[0]["goal"]) == 1


def test_a_joint_that_nobody_has_is_refused_with_the_nearest_name():
    with pytest.raises(SpecError, match="did you mean 'r_sho_pitch'"):
        Stage(robots=SMALL).play(without=["r_sho_pich"])
    with pytest.raises(SpecError, match="no joint is left"):
        Stage(robots=SMALL).play(only=[SMALL[0].joint_names[0]])


def test_eeprom_of_real_servos_is_not_written_unasked():
    stage = Stage(robots=SMALL)
    before = every(stage)
    with pytest.raises(ServoFault, match=r"return_delay_time 250 -> 0.*--write-eeprom"):
        stage.play(ports=REAL, arm=True)
    stored = every(stage, "eeprom")
    assert [
        {name: row[name] for name in kept} for row, kept in zip(before, stored, strict=True)
    ] == stored
    assert stage.torques() == [0] * 6


def test_eeprom_of_real_servos_is_backed_up_before_it_is_written(tmp_path):
    stage = Stage(robots=SMALL)
    told = {"ports": REAL, "arm": True, "backups": tmp_path}
    assert stage.play(write_eeprom=True, **told).completed
    assert len(list(tmp_path.glob("*.json"))) == 6
    assert all(row["return_delay_time"] == 0 for row in every(stage))
    assert stage.play(**told).completed  # nothing differs any more
