"""Warm, weak and overworked servos: a word, half the speed, a stop."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bridge.player.health import Health, Level
from bridge.player.telemetry import read_telemetry
from robots.errors import ServoFault
from tests.bridge.player.stage import SMALL, Stage, states, ticks


def judge() -> Health:
    """Return a judge of two servos that switch off at 80 degC and below 9.5 V."""
    limits = {"temperature_limit": 80, "min_voltage_limit": 95}
    table = SimpleNamespace(stall_current=2.0)
    bus = SimpleNamespace(
        ids=(1, 2),
        joint_names=("one", "two"),
        tables=(table, table),
        registers=SimpleNamespace(read=lambda index, name: limits[name]),
    )
    return Health(bus)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "level"),
    [(64, None), (65, Level.WARN), (70, Level.DERATE), (75, Level.STOP), (90, Level.STOP)],
)
def test_heat_is_judged_by_the_servos_own_limit(value, level):
    found = judge().look("present_temperature", {"one": 30.0, "two": float(value)})
    assert [(x.joint, x.level) for x in found] == ([("two", level)] if level else [])


@pytest.mark.parametrize(
    ("value", "level"),
    [(10.5, None), (10.4, Level.WARN), (9.9, Level.DERATE), (9.4, Level.STOP)],
)
def test_a_weak_supply_is_judged_by_the_servos_own_limit(value, level):
    found = judge().look("present_input_voltage", {"one": value})
    assert [x.level for x in found] == ([level] if level else [])


def test_a_moment_of_stall_is_fine_and_a_steady_one_is_not():
    health, levels = judge(), []
    for _ in range(300):
        found = health.feel(np.array([np.nan, -1.9]), 0.02)
        levels += [(x.joint, x.level) for x in found]
    assert levels == [("two", Level.WARN), ("two", Level.DERATE), ("two", Level.STOP)]
    assert not judge().feel(np.array([2.0, 2.0]), 0.02)


def test_each_thing_is_said_once_and_again_only_if_it_gets_worse():
    health = judge()
    said = [len(health.look("present_temperature", {"one": t})) for t in (66.0, 67.0, 71.0, 66.0)]
    assert said == [1, 0, 1, 0]


def heated(temperature: float, path):
    """Play while a servo of b is as warm as that."""
    stage = Stage(robots=SMALL)

    def heat(state: str, share: float) -> None:
        if state in ("ARMED", "RAMP", "PLAY", "HOLD"):
            stage.wires[1].servos[1].motor.temperature = temperature

    try:
        return stage, stage.play(telemetry=path, on_progress=heat)
    finally:
        assert stage.torques() == [0] * 6


def limit() -> int:
    return Stage(robots=SMALL).wires[1].servos[1].get("temperature_limit")


def test_a_warm_servo_is_told_of_and_a_hot_one_slows_both_down(tmp_path):
    _, warm = heated(limit() - 12, tmp_path / "warm.jsonl")
    _, hot = heated(limit() - 8, tmp_path / "hot.jsonl")
    events = read_telemetry(tmp_path / "warm.jsonl")
    assert [x["level"] for x in events if x.get("event") == "unwell"] == ["warn"]
    assert warm.duration == pytest.approx(1.0, abs=0.05)
    assert hot.completed
    assert hot.duration > 1.5
    phases = [[x["phase"] for x in ticks(tmp_path / "hot.jsonl", p, "PLAY")] for p in "ab"]
    assert phases[0] == phases[1]


def test_a_servo_about_to_trip_stops_both_along_their_paths(tmp_path):
    path = tmp_path / "t.jsonl"
    with pytest.raises(ServoFault, match=rf"{SMALL[1].joint_names[1]}.*degC warm"):
        heated(limit() - 4, path)
    assert states(path)[-3:] == ["HOLD", "FAULT", "RELAX"]
