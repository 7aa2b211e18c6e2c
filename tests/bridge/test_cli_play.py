"""What ``pasdedeux play`` understands, and what it says and returns afterwards."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from bridge.cli import main
from bridge.player import PlayerSettings, process
from bridge.player.request import PlayRequest
from bridge.player.settings import ENDS
from bridge.player.telemetry import Performance, Tracking
from bridge.stop import StopRequest
from robots.errors import ServoFault

DONE = Performance(
    completed=True,
    outcome="completed",
    duration=1.0,
    rate=60.0,
    ticks=61,
    late_ticks=2,
    dropped_ticks=1,
    jitter_p99_ms=0.5,
    skew_p99_ms=0.12,
    tracking={"a": Tracking("op3", 1.25, 4.0, "l_el", 33.0, 0.4, 0)},
)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[PlayRequest]:
    """Collect what would be played; it always goes well."""
    requests: list[PlayRequest] = []

    def conduct(request: PlayRequest, *, stop, on_progress) -> Performance:
        assert isinstance(stop, StopRequest)
        on_progress("PLAY", 0.5)
        requests.append(request)
        return DONE

    monkeypatch.setattr(process, "conduct", conduct)
    return requests


def request_of(asked: list[PlayRequest], *words: str) -> PlayRequest:
    assert main(["play", "a.npz", "b.npz", *words]) == 0
    return asked.pop()


PLAIN = PlayRequest(trajectories=(Path("a.npz"), Path("b.npz")), telemetry=Path("telemetry.jsonl"))


def test_without_flags_it_is_virtual_and_nothing_is_allowed(asked):
    assert request_of(asked) == PLAIN


REAL = ("/dev/ttyUSB0", "/dev/ttyUSB1")


@pytest.mark.parametrize(
    ("words", "changes"),
    [
        ("--report r.json", {"report": Path("r.json")}),
        ("-o folder", {"telemetry": Path("folder/telemetry.jsonl")}),
        ("-o folder/t.jsonl", {"telemetry": Path("folder/t.jsonl")}),
        ("--port virtual", {}),
        (f"--port {REAL[0]} {REAL[1]} --arm", {"ports": REAL, "arm": True}),
        (f"--port {REAL[0]} virtual", {"ports": (REAL[0], "virtual")}),
        ("--plant mujoco", {"plant": "mujoco"}),
        ("--transport rustypot", {"transport": "rustypot"}),
        ("--force", {"force": True}),
        ("--speed 0.3", {"settings": PlayerSettings(speed=0.3)}),
        ("--rate 100", {"settings": PlayerSettings(rate=100.0)}),
        ("--end hold", {"settings": PlayerSettings(end="hold")}),
        ("--dry-run", {"settings": PlayerSettings(dry_run=True)}),
        ("--only l_el r_el", {"only": ("l_el", "r_el")}),
        ("--without head_pan", {"without": ("head_pan",)}),
        ("--write-eeprom", {"write_eeprom": True}),
        ("--realtime", {"realtime": True}),
        ("--robot-a my/robot", {"robots": ("my/robot", None)}),
        ("--robot-b op3", {"robots": (None, "op3")}),
        ("--calibration-a c.json", {"calibrations": (Path("c.json"), None)}),
        ("--calibration-b c.json", {"calibrations": (None, Path("c.json"))}),
    ],
)
def test_each_flag_changes_what_it_says_and_nothing_else(asked, words, changes):
    assert request_of(asked, *words.split()) == replace(PLAIN, **changes)


def test_the_command_line_offers_every_end(capsys):
    with pytest.raises(SystemExit):
        main(["play", "--help"])
    assert "{" + ",".join(ENDS) + "}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("--port /dev/ttyUSB0", "1 port given for two robots"),
        ("--port /dev/a /dev/b /dev/c", "3 port given"),
        ("--plant instant --port /dev/a /dev/b", "virtual ports alone"),
        ("--rate 0", "rate is 0.0"),
        ("--speed 9", "speed is 9.0"),
    ],
)
def test_what_cannot_be_is_wrong_usage_in_one_line(asked, capsys, words, reason):
    assert main(["play", "a.npz", "b.npz", *words.split()]) == 2
    assert reason in capsys.readouterr().err
    assert not asked


@pytest.mark.parametrize("words", ["--transport morse", "--plant jelly", "--end nowhere", "--only"])
def test_words_that_do_not_exist_are_wrong_usage(asked, words):
    with pytest.raises(SystemExit) as stop:
        main(["play", "a.npz", "b.npz", *words.split()])
    assert stop.value.code == 2


def test_it_says_how_it_went_and_how_well(asked, capsys):
    assert main(["play", "a.npz", "b.npz"]) == 0
    said = capsys.readouterr().out
    assert "a (op3): 1.25° off (at most 4.0°, l_el), 33 ms behind" in said
    assert "61 ticks at 60 Hz, 2 late, 1 left out, 0.12 ms" in said
    assert main(["play", "a.npz", "b.npz", "--json"]) == 0
    assert Performance.from_json(json.loads(capsys.readouterr().out)) == DONE


def test_a_stop_and_a_fault_have_their_own_exit_status(monkeypatch, capsys):
    outcome = replace(DONE, completed=False, outcome="stopped")
    monkeypatch.setattr(process, "conduct", lambda request, **_: outcome)
    assert main(["play", "a.npz", "b.npz"]) == 130
    capsys.readouterr()

    def fail(request: PlayRequest, **_: object) -> Performance:
        raise ServoFault("hardware error: overload", where="l_el (id 6)")

    monkeypatch.setattr(process, "conduct", fail)
    assert main(["play", "a.npz", "b.npz"]) == 3
    assert "l_el (id 6): hardware error: overload" in capsys.readouterr().err
