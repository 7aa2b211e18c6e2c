"""Telemetry told again: the same figures as the player's, also without a last line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from bridge.player.canvas import Canvas
from bridge.player.plot import plot
from bridge.player.replay import BROKEN_OFF, replay
from bridge.player.telemetry import SCHEMA
from robots.errors import MotionFileError

JOINTS = ("one", "two")
RATE, LAG = 50.0, 0.04


def tick(t: float, robot: str, state: str = "PLAY", shift: float = 0.0) -> dict:
    goal = [0.5 * math.sin(2 * t), 0.3 * math.cos(3 * t)]
    present = [0.5 * math.sin(2 * (t - LAG)), 0.3 * math.cos(3 * (t - LAG))]
    return {
        "kind": "tick",
        "t": round(10 + t, 5),
        "robot": robot,
        "state": state,
        "phase": round(t, 5),
        "goal": goal,
        "present": present,
        "error": [a - b for a, b in zip(goal, present, strict=True)],
        "current": [0.1, None],
        "late": 0.0001,
        "sent": 0.0002 + shift,
        "read": 0.004,
    }


def record(path: Path, *, summary: bool = True, skip: tuple[int, ...] = ()) -> Path:
    about = {name: {"name": f"robot {name}", "joints": JOINTS} for name in "ab"}
    lines: list[dict] = [
        {"kind": "header", "schema": SCHEMA, "rate": RATE, "speed": 1.0, "robots": about},
        {"kind": "event", "t": 10.0, "event": "state", "state": "RAMP"},
    ]
    for k in range(20):
        lines += [tick(k / RATE, "a", "RAMP"), tick(k / RATE, "b", "RAMP")]
    lines.append({"kind": "event", "t": 10.4, "event": "state", "state": "PLAY"})
    for k in range(20, 220):
        if k in skip:
            continue
        t = k / RATE
        lines += [tick(t, "a"), tick(t, "b", shift=0.0003)]
        if k % 40 == 0:
            heat = {"one": 30 + k / 50, "two": 31.0}
            health = {"kind": "event", "t": 10 + t, "event": "health", "robot": "a"}
            lines.append({**health, "present_temperature": heat})
    if summary:
        lines.append({"kind": "event", "t": 15.0, "event": "state", "state": "RELAX"})
        lines.append({"kind": "summary", "completed": True, "outcome": "completed"})
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


def test_figures_are_computed_from_the_ticks(tmp_path):
    told = replay(record(tmp_path / "t.jsonl", skip=(50, 51, 90)))
    done = told.performance
    assert (done.completed, done.outcome, told.closed) == (True, "completed", True)
    assert (done.ticks, done.dropped_ticks, done.late_ticks) == (197, 3, 0)
    assert done.duration == pytest.approx(199 / RATE)
    assert done.skew_p99_ms == pytest.approx(0.3)
    assert done.tracking["a"].lag_ms == pytest.approx(1e3 * LAG, abs=1.5)
    assert done.tracking["b"].robot == "robot b"


def test_a_file_without_its_end_gives_the_same_figures_and_says_so(tmp_path):
    whole = replay(record(tmp_path / "t.jsonl")).performance
    path = record(tmp_path / "crash.jsonl", summary=False)
    path.write_text(path.read_text() + '{"kind":"tick","t":1')
    told = replay(path)
    assert not told.closed
    assert (told.performance.completed, told.performance.outcome) == (False, BROKEN_OFF)
    assert told.performance.tracking == whole.tracking
    assert told.performance.ticks == whole.ticks


def test_a_tick_of_which_only_one_robots_line_was_written_does_not_count(tmp_path):
    path = record(tmp_path / "t.jsonl", summary=False)
    path.write_text(path.read_text() + json.dumps(tick(220 / RATE, "a")) + "\n")
    assert replay(path).performance.ticks == 200


def test_a_fault_without_a_summary_is_the_outcome(tmp_path):
    path = record(tmp_path / "t.jsonl", summary=False)
    fault = {"kind": "event", "t": 14.5, "event": "fault", "type": "BusTimeout", "error": "gone"}
    path.write_text(path.read_text() + json.dumps(fault) + "\n")
    told = replay(path)
    assert told.performance.outcome == "BusTimeout: gone"
    assert (pytest.approx(4.5), "fault: gone") in told.events


def test_a_pause_is_no_dropped_tick(tmp_path):
    path = record(tmp_path / "t.jsonl", summary=False)
    lines = path.read_text().splitlines()
    pause = {"kind": "event", "t": 14.4, "event": "state", "state": "PLAY"}
    later = [json.dumps(tick(t, robot)) for t in (8.0, 8.02) for robot in "ab"]
    path.write_text("\n".join([*lines, json.dumps(pause), *later]) + "\n")
    assert replay(path).performance.dropped_ticks == 0


def test_lags_along_the_dance_are_those_of_the_dance(tmp_path):
    times, lags = replay(record(tmp_path / "t.jsonl")).tracks[0].lags()
    assert len(times) >= 4
    np.testing.assert_allclose(lags, 1e3 * LAG, atol=3)


def test_the_picture_shows_goals_positions_and_heat(tmp_path):
    told = replay(record(tmp_path / "t.jsonl", summary=False))
    plot(told, tmp_path / "t.png")
    data = (tmp_path / "t.png").read_bytes()
    assert data.startswith(b"\x89PNG")
    assert len(data) > 5000


def test_the_same_file_gives_the_same_picture(tmp_path):
    told = replay(record(tmp_path / "t.jsonl"))
    for name in ("1.png", "2.png"):
        plot(told, tmp_path / name)
    assert (tmp_path / "1.png").read_bytes() == (tmp_path / "2.png").read_bytes()


def test_a_run_that_ended_before_its_first_tick_can_be_told_and_drawn(tmp_path):
    path = record(tmp_path / "t.jsonl")
    path.write_text("\n".join(path.read_text().splitlines()[:2]) + "\n")
    told = replay(path)
    assert told.performance.ticks == 0
    assert math.isnan(told.performance.tracking["a"].rms_deg)
    plot(told, tmp_path / "t.png")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}\n",
        "3\n",
        json.dumps({"kind": "header", "schema": SCHEMA}) + "\n",
        json.dumps({"kind": "header", "schema": SCHEMA, "robots": {}, "rate": 5}) + "\n",
    ],
)
def test_a_file_that_is_no_telemetry_is_refused_with_its_name(tmp_path, text):
    path = tmp_path / "t.jsonl"
    path.write_text(text)
    with pytest.raises(MotionFileError, match=r"t\.jsonl"):
        replay(path)


def test_a_damaged_tick_is_refused_with_its_file(tmp_path):
    path = record(tmp_path / "t.jsonl")
    lines = path.read_text().splitlines()
    broken = json.loads(lines[5])
    broken["goal"] = [1.0]
    path.write_text("\n".join([*lines[:5], json.dumps(broken), *lines[6:]]) + "\n")
    with pytest.raises(MotionFileError, match="damaged"):
        replay(path)


def test_a_curve_has_a_gap_where_nothing_was_heard():
    canvas = Canvas(100, 60)
    x = np.arange(11.0)
    y = np.where((x > 3) & (x < 7), np.nan, 1.0)
    canvas.curve((0, 0, 100, 60), (0, 10), (0, 2), x, y, (0, 0, 0))
    drawn = (canvas.pixels == 0).all(axis=2).any(axis=0)
    assert drawn[5:25].all()
    assert not drawn[35:65].any()
    assert drawn[72:95].all()


def test_every_letter_a_label_may_need_has_its_dots():
    for character in "abcdefghijklmnopqrstuvwxyz0123456789.,-_:/()+%=°ACV":
        canvas, box = Canvas(12, 14), Canvas(12, 14)
        canvas.text(0, 0, character)
        box.text(0, 0, "\x00")
        assert (canvas.pixels != box.pixels).any(), character
        assert (canvas.pixels != 255).any(), character
