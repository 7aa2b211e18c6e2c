"""Setting up and looking back at the command line, against virtual servos."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bridge.cli import main
from bridge.servo.registers import BAUD_RATES, control_table
from bridge.setup.calibration import Calibration, JointCalibration
from bridge.virtual import PtyServer, VirtualBus, VirtualServo
from robots.registry import load_robot
from tests.bridge.player.stage import dance
from tests.bridge.player.test_replay import record


@pytest.fixture
def one_servo(tmp_path: Path) -> Iterator[tuple[str, VirtualBus]]:
    """A port with one servo out of the box."""
    wire = VirtualBus([VirtualServo(control_table("XL330-M288"), 1)])
    with PtyServer(wire, link=tmp_path / "port") as server:
        yield server.port, wire


def result(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict]:
    """Run with --json; return the status and the one object."""
    status = main([*words, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.realtime
def test_a_servo_is_found_gets_its_place_and_comes_back(one_servo, tmp_path, capsys, monkeypatch):
    """The whole of a new servo's way: scan, setup-id, scan, restore."""
    port, _ = one_servo
    at = ("--port", port, "--robot", "marionette")
    status, found = result(capsys, "scan", *at, "--baud", "57600", "1000000", "--protocol", "2")
    assert status == 0
    assert [(s["id"], s["baud"], s["model"]) for s in found["servos"]] == [(1, 57600, "XL330-M288")]

    monkeypatch.setattr(sys, "stdin", io.StringIO("n\n"))
    setup = ("setup-id", *at, "--backups", str(tmp_path / "b"))
    assert main([*setup, "--joint", "l_elbow", "--baud", "57600"]) == 130
    assert "id: 1 -> 24" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()

    status, changed = result(capsys, *setup, "--joint", "l_elbow", "--baud", "57600", "--yes")
    assert status == 0
    assert changed["changed"] == {"id": [1, 24], "baud_rate": [1, BAUD_RATES.index(1_000_000)]}

    (backup,) = (tmp_path / "b").iterdir()
    restore = ("--restore", str(backup), "--baud", "1000000", "--yes")
    status, changed = result(capsys, *setup, *restore)
    assert status == 0
    assert changed["found"]["id"] == 24
    assert changed["changed"]["id"] == [24, 1]


@pytest.mark.realtime
def test_an_empty_rate_is_a_hardware_fault_with_a_reason(one_servo, capsys):
    status = main(["scan", "--port", one_servo[0], "--baud", "9600", "--protocol", "2"])
    assert status == 3
    assert "nobody answers" in capsys.readouterr().out


def test_what_a_servo_should_become_must_be_said_once(one_servo, capsys):
    for words in ([], ["--id", "3", "--joint", "l_elbow"]):
        assert main(["setup-id", "--port", one_servo[0], *words]) == 2
        assert "what should it become" in capsys.readouterr().err


def test_a_rate_that_does_not_exist_is_wrong_usage(one_servo, capsys):
    assert main(["scan", "--port", one_servo[0], "--baud", "1234"]) == 2
    assert "57600" in capsys.readouterr().err


@pytest.mark.realtime
def test_a_joint_is_jogged_by_keys_from_a_pipe(capsys, monkeypatch):
    read, write = os.pipe()
    os.write(write, b"+" * 15 + b"q")
    os.close(write)
    with os.fdopen(read) as keys:
        monkeypatch.setattr(sys, "stdin", keys)
        status, jogged = result(capsys, "jog", "l_elbow", "--robot", "marionette", "--speed", "90")
    assert status == 0
    assert jogged["steps"] == 15
    assert jogged["end_deg"] > jogged["start_deg"] + 2


def test_a_real_port_is_not_jogged_without_arm(tmp_path, capsys):
    words = ["jog", "l_elbow", "--robot", "marionette", "--port", str(tmp_path / "tty")]
    assert main(words) == 1
    assert "--arm" in capsys.readouterr().err


def test_a_joint_that_is_not_there_is_wrong_usage(capsys):
    assert main(["jog", "l_elbo", "--robot", "marionette"]) == 2
    assert "did you mean 'l_elbow'" in capsys.readouterr().err


def test_lerobots_calibration_goes_in_and_out(tmp_path, capsys):
    row = {"id": 24, "drive_mode": 0, "homing_offset": -100, "range_min": 1500, "range_max": 3900}
    theirs, ours, again = (tmp_path / name for name in ("theirs.json", "left.json", "again.json"))
    theirs.write_text(json.dumps({"l_elbow": row}))
    words = ("calibrate", str(ours), "--robot", "marionette")
    status, made = result(capsys, *words, "--from-lerobot", str(theirs))
    assert status == 0
    assert made["unit"] == "left"
    assert made["joints"]["l_elbow"]["zero"] == 2147
    assert main([*words, "--to-lerobot", str(again)]) == 0
    assert json.loads(again.read_text()) == {"l_elbow": row}


def test_a_unit_that_cannot_reach_as_far_as_the_dance_is_refused(tmp_path, capsys):
    paths = [str(tmp_path / f"{person}.npz") for person in "ab"]
    for path in paths:
        dance(load_robot("marionette")).save(path)
    unit = tmp_path / "left.json"
    elbow = JointCalibration(24, "XL330-M288", 2048, 1, 2048, 2446)  # to 35 degrees, not 42
    Calibration("marionette", "left", {"l_elbow": elbow}).save(unit)
    words = ["play", *paths, "--force", "-o", str(tmp_path / "t.jsonl")]
    assert main([*words, "--calibration-b", str(unit)]) == 1
    assert "marionette: l_elbow" in capsys.readouterr().err
    Calibration("op3", "left", {}).save(unit)
    assert main([*words, "--calibration-b", str(unit)]) == 2
    assert "is for 'op3'" in capsys.readouterr().err


@pytest.mark.realtime
def test_a_unit_is_verified_in_the_pose_it_stands_in(tmp_path, capsys):
    unit = tmp_path / "left.json"
    elbow = JointCalibration(24, "XL330-M288", 2048, 1, 1900, 3900)
    Calibration("marionette", "left", {"l_elbow": elbow}).save(unit)
    words = ("calibrate", str(unit), "--robot", "marionette", "--joint", "l_elbow", "--verify")
    status, verified = result(capsys, *words, "--yes", "--home", "rest")
    assert (status, verified["passed"]) == (0, True)
    status, verified = result(capsys, *words, "--yes", "--home", "zero")
    assert (status, verified["passed"]) == (1, False)
    assert "+25." in verified["joints"][0]["problems"][0]


@pytest.mark.realtime
def test_a_unit_that_was_not_swept_gets_no_file(tmp_path, capsys):
    words = ["calibrate", str(tmp_path / "u.json"), "--robot", "marionette", "--joint", "l_elbow"]
    assert main([*words, "--seconds", "0.1", "--yes"]) == 2
    assert "l_elbow was hardly moved" in capsys.readouterr().err
    assert not (tmp_path / "u.json").exists()


def test_a_run_that_broke_off_is_told_and_drawn(tmp_path, capsys):
    path = record(tmp_path / "t.jsonl", summary=False)
    status, told = result(capsys, "replay", str(path))
    assert status == 0
    assert not told["closed"]
    assert told["performance"]["outcome"] == "broken off"
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    assert main(["replay", str(path), "--no-plot"]) == 0
    assert "no closing line" in capsys.readouterr().out


def test_a_file_that_is_no_telemetry_is_wrong_usage(tmp_path, capsys):
    path = tmp_path / "t.jsonl"
    path.write_text("{}\n")
    assert main(["replay", str(path)]) == 2
    assert "not telemetry" in capsys.readouterr().err


def test_a_doctor_needs_to_know_whose_servos_hang_on_a_port(capsys):
    assert main(["doctor", "--port", "virtual"]) == 2
    assert "--robot" in capsys.readouterr().err
