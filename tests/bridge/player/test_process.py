"""A player in a process of its own: what holds it up, what stops it, what it tells."""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from bridge.player import PlayerSettings, StopRequest, process
from bridge.player.conductor import _Voice
from bridge.player.process import conduct
from bridge.player.request import PlayRequest
from bridge.player.telemetry import Performance, Tracking, read_telemetry
from bridge.virtual import PtyServer, VirtualBus, virtual_bus_for
from robots.errors import BusError, GateRefused, PortLost
from tests.bridge.player.stage import FEW, ROBOTS, states, write_duet

pytestmark = pytest.mark.realtime

QUICK = PlayerSettings(
    rate=30,
    ramp_time=0.5,
    settle_time=0.1,
    hold_time=0.2,
    stop_time=0.3,
    soft_time=0.1,
    relax_time=0.2,
    max_stall=5,
    watchdog=1.5,
)


@pytest.fixture
def buses(tmp_path: Path) -> Iterator[list[VirtualBus]]:
    """Three servos of each robot on pseudo-terminals ``a`` and ``b`` in the test's folder."""
    both = [
        virtual_bus_for(replace(robot, joints=tuple(j for j in robot.joints if j.name in FEW)))
        for robot in ROBOTS
    ]
    with (
        PtyServer(both[0], link=tmp_path / "a", timing=True),
        PtyServer(both[1], link=tmp_path / "b", timing=True),
    ):
        yield both


def request(folder: Path, *, duration: float = 1.0, **changes) -> PlayRequest:
    """Return what plays a few joints on the ports ``a`` and ``b`` of a folder."""
    a, b, report = write_duet(folder, duration=duration)
    whole = PlayRequest(
        trajectories=(a, b),
        telemetry=folder / "t.jsonl",
        report=report,
        ports=(str(folder / "a"), str(folder / "b")),
        settings=QUICK,
        arm=True,
        only=FEW,
        write_eeprom=True,
        backups=folder / "backups",
    )
    return replace(whole, **changes)


def torques(buses: list[VirtualBus]) -> list[int]:
    for bus in buses:
        bus.advance(time.monotonic())
    return [servo.get("torque_enable") for bus in buses for servo in bus.servos]


def wait_until(what: Callable[[], bool], seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)


def dancing(path: Path) -> Callable[[], bool]:
    """Return whether the dance has begun, by its telemetry."""
    return lambda: path.exists() and '"PLAY"' in path.read_text("utf-8")


def test_a_request_and_a_performance_survive_being_told(tmp_path):
    asked = request(tmp_path, calibrations=(tmp_path / "c.json", None), robots=("op3", None))
    assert PlayRequest.from_json(json.loads(json.dumps(asked.to_json()))) == asked
    track = Tracking("op3", 1.5, 3.0, "head", 31.0, 0.5, 4)
    whole = Performance(True, "completed", 1.0, 50.0, 51, 0, 0, 0.1, 0.2, {"a": track})
    assert Performance.from_json(json.loads(json.dumps(whole.to_json()))) == whole
    bare = replace(track, lag_ms=math.nan)
    told = Performance.from_json(replace(whole, tracking={"a": bare}).to_json())
    assert math.isnan(told.tracking["a"].lag_ms)


def test_what_nobody_listens_to_is_left_out_and_the_last_word_is_not():
    """A caller that does not read must not make the player wait, nor get halves of lines."""
    theirs, ours = os.pipe()
    voice = _Voice(ours)
    for index in range(3000):
        voice.say("log", ["name", logging.INFO, f"{index} " + "x" * 400])
    os.set_blocking(theirs, False)
    heard = bytearray(os.read(theirs, 1 << 20))
    voice.result("performance", {"outcome": "completed"})
    heard += os.read(theirs, 1 << 20)
    lines = [json.loads(line) for line in heard.splitlines()]
    assert lines[-1] == ["performance", {"outcome": "completed"}]
    assert 50 < len(lines) < 500
    assert [int(text.split()[0]) for _, (_, _, text) in lines[:-1]] == list(range(len(lines) - 1))
    os.close(theirs)
    voice.say("log", ["name", logging.INFO, "nobody is there any more"])
    os.close(ours)


def test_a_caller_that_stands_still_holds_nothing_up(buses, tmp_path, caplog):
    """In the caller's own process a pause of half a second would end the performance."""
    told: list[tuple[str, float]] = []

    def linger(state: str, share: float) -> None:
        told.append((state, share))
        if state == "PLAY" and len([x for x in told if x[0] == state]) == 3:
            time.sleep(0.9)

    impatient = replace(QUICK, max_stall=0.7)
    caplog.set_level(logging.INFO)
    performance = conduct(request(tmp_path, duration=2.0, settings=impatient), on_progress=linger)
    assert performance.completed
    path = tmp_path / "t.jsonl"
    assert performance.to_json().items() <= read_telemetry(path)[-1].items()
    assert torques(buses) == [0] * 6
    heard = [state for state, _ in told]
    assert [s for i, s in enumerate(heard) if s != (heard[i - 1] if i else "")] == states(path)
    assert told[-2][1] <= 1.0
    logged = [r.getMessage() for r in caplog.records if r.name == "bridge.player.streamer"]
    assert logged == states(path)


def test_a_caller_that_fails_relaxes_the_robots_first(buses, tmp_path):
    def fail(state: str, share: float) -> None:
        if state == "PLAY":
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        conduct(request(tmp_path, duration=9.0), on_progress=fail)
    assert states(tmp_path / "t.jsonl")[-2:] == ["PLAY", "RELAX"]
    assert torques(buses) == [0] * 6


def test_a_stop_and_a_pause_reach_the_player(buses, tmp_path):
    stop, told = StopRequest(), []

    def progress(state: str, share: float) -> None:
        told.append(state)
        if told.count("PLAY") in (2, 8):
            stop.pause()
        elif told.count("PLAY") == 12:
            stop.set()

    performance = conduct(request(tmp_path, duration=9.0), stop=stop, on_progress=progress)
    assert performance.outcome == "stopped"
    path = tmp_path / "t.jsonl"
    assert states(path)[-3:] == ["PLAY", "HOLD", "RELAX"]
    assert [x["rate"] for x in read_telemetry(path) if x.get("event") == "rate"] == [0.0, 1.0]
    assert torques(buses) == [0] * 6


def test_errors_come_back_as_they_were_raised(tmp_path):
    with pytest.raises(PortLost, match=r"nowhere-1.*cannot be opened") as caught:
        conduct(request(tmp_path, ports=("/dev/nowhere-1", "/dev/nowhere-2")))
    assert caught.value.where == "/dev/nowhere-1"
    assert "dialout" in caught.value.hint
    with pytest.raises(GateRefused, match="did not pass"):
        conduct(request(tmp_path, report=None))
    assert not (tmp_path / "t.jsonl").exists()


def test_a_player_that_dies_or_fails_is_a_fault_of_the_hardware_side(buses, tmp_path, monkeypatch):
    """Nobody knows what the servos do then, so it is no mere exception."""
    players = []
    popen = subprocess.Popen

    def start_player(*words, **options):
        players.append(popen(*words, **options))
        return players[-1]

    monkeypatch.setattr(process.subprocess, "Popen", start_player)

    def kill(state: str, share: float) -> None:
        if state == "PLAY":
            players[-1].kill()

    with pytest.raises(BusError, match=r"without a word.*-9"):
        conduct(request(tmp_path, duration=9.0), on_progress=kill)
    time.sleep(QUICK.watchdog + 0.2)
    for bus in buses:
        bus.advance(time.monotonic())
    assert [s.get("bus_watchdog") for bus in buses for s in bus.servos] == [-1] * 6

    asked = request(tmp_path)
    object.__setattr__(asked, "robots", (7, None))  # what a bug may send
    with pytest.raises(BusError, match="the player failed") as caught:
        conduct(asked)
    assert "Traceback" in caught.value.__notes__[0]


CALLER = """
import sys
from pathlib import Path
from bridge.player.process import conduct
from tests.bridge.player.test_process import request
conduct(request(Path(sys.argv[1]), duration=30.0))
"""


def start(*words: str, cwd: Path) -> subprocess.Popen[bytes]:
    path = os.pathsep.join(p for p in sys.path if p)
    return subprocess.Popen(
        [sys.executable, *words],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


@pytest.mark.skipif(sys.platform != "linux", reason="Linux has these")
def test_real_time_priority_is_taken_where_it_is_allowed_and_not_missed_elsewhere(tmp_path):
    code = """
import logging, os
from bridge.player.conductor import _undisturbed
logging.basicConfig()
_undisturbed(realtime=True)
print(os.sched_getscheduler(0) & os.SCHED_FIFO, os.sched_getparam(0).sched_priority)
print(os.popen("ps -o cls= -p $$").read().strip())
"""
    path = os.pathsep.join(p for p in sys.path if p)
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    mine, of_children = done.stdout.splitlines()
    assert mine == ("0 0" if "no real-time priority" in done.stderr else f"{os.SCHED_FIFO} 20")
    assert of_children == "TS"


@pytest.mark.slow
def test_a_caller_that_is_killed_leaves_no_dancing_robots(buses, tmp_path):
    path = tmp_path / "t.jsonl"
    caller = start("-c", CALLER, str(tmp_path), cwd=tmp_path)
    try:
        wait_until(dancing(path))
        assert torques(buses) == [1] * 6
    finally:
        caller.kill()
        caller.wait()
    wait_until(lambda: '"summary"' in path.read_text("utf-8"))
    assert states(path)[-3:] == ["PLAY", "HOLD", "RELAX"]
    assert read_telemetry(path)[-1]["outcome"] == "stopped"
    assert torques(buses) == [0] * 6


@pytest.mark.slow
@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_stops_the_command_safely(buses, tmp_path, presses):
    a, b, report = write_duet(tmp_path, duration=30.0)
    path = tmp_path / "t.jsonl"
    command = start(
        *("-m", "bridge.cli.main", "play", str(a), str(b), "--report", str(report)),
        *("--port", str(tmp_path / "a"), str(tmp_path / "b"), "--arm", "--write-eeprom"),
        *("--only", *FEW, "--rate", "30", "-o", str(path)),
        cwd=tmp_path,
    )
    try:
        wait_until(dancing(path))
        time.sleep(0.1 * presses)  # another moment of the dance each time
        for _ in range(presses):
            os.killpg(command.pid, signal.SIGINT)  # as a terminal does
            time.sleep(0.05)
        assert command.wait(30) == 130
    finally:
        command.kill()
    assert states(path)[-2:] == (["HOLD", "RELAX"] if presses == 1 else ["PLAY", "RELAX"])
    assert torques(buses) == [0] * 6
