"""Strength that grows and fades, and the three steps of stopping."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from bridge.player import StopRequest
from bridge.player.link import Link
from bridge.player.settings import ENDS
from bridge.servo.access import RegisterAccess
from bridge.stop import CUT, is_paused, stop_level, stop_on_signals
from robots.errors import BusError, BusTimeout, SpecError
from tests.bridge.player.stage import BRISK, SMALL, STEP, Stage, states, ticks


@pytest.fixture
def exerted(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Collect the shares of their strength that servos were given."""
    shares: list[float] = []
    exert = Link.exert

    def record(link: Link, share: float) -> None:
        shares.append(share)
        exert(link, share)

    monkeypatch.setattr(Link, "exert", record)
    return shares


def test_strength_grows_while_the_present_pose_is_held():
    stage, duty, angles = Stage(robots=SMALL), [], []
    servo = stage.wires[0].servos[0]

    def progress(state: str, share: float) -> None:
        if state == "ARMED" and servo.memory.get("torque_enable"):
            duty.append(servo.memory.get("goal_pwm"))
            angles.append(servo.angle)

    assert stage.play(on_progress=progress).completed
    assert duty[0] == pytest.approx(BRISK.soft_share * 885, abs=1)
    assert (np.diff(duty) >= 0).all()
    assert duty[-1] == 885
    assert np.ptp(angles) < 0.01


def test_strength_fades_before_torque_goes_off_and_is_given_back(exerted):
    stage = Stage(robots=SMALL)
    stage.play()
    fading = exerted[exerted.index(1.0, exerted.index(1.0) + 1) :]
    last = fading[-10:]
    assert last == sorted(last, reverse=True)
    assert last[-1] < 0.25
    assert stage.torques() == [0] * 6
    for wire in stage.wires:
        for servo in wire.servos:
            assert servo.get("goal_pwm") == servo.get("pwm_limit")
            assert servo.get("bus_watchdog") == 0


def test_in_current_based_mode_strength_is_current():
    """A servo that holds by current must not meet a hand with all of it in the first moment."""
    robots = [
        replace(
            robot,
            joints=tuple(
                replace(joint, servo=replace(joint.servo, mode="current_based_position"))
                for joint in robot.joints
            ),
        )
        for robot in SMALL
    ]
    stage, seen = Stage(robots=robots), []
    servo = stage.wires[0].servos[0]
    most = servo.get("current_limit")

    def progress(state: str, share: float) -> None:
        if servo.get("torque_enable"):
            seen.append((state, servo.get("goal_current") / most))

    assert stage.play(on_progress=progress).completed
    growing = [share for state, share in seen if state == "ARMED"]
    assert growing[0] == pytest.approx(BRISK.soft_share, abs=0.01)
    assert growing == sorted(growing)
    assert {share for state, share in seen if state == "PLAY"} == {1.0}
    assert servo.get("goal_current") == most


def test_robots_end_in_their_rest_pose_unless_told_to_hold():
    for end in ENDS:
        stage, last = Stage(robots=SMALL), []
        stage.play(
            settings=replace(BRISK, end=end, relax_time=0.0),
            on_progress=lambda state, share, stage=stage, last=last: last.append(stage.angles()),
        )
        rest = Stage(robots=SMALL).angles()  # servos come in it
        assert bool(np.abs(last[-1] - rest).max() < 0.01) == (end == "rest")
        assert stage.torques() == [0] * 6


def test_the_way_to_the_rest_pose_is_soft_and_can_be_stopped(tmp_path):
    stage, stop, path = Stage(robots=SMALL), StopRequest(), tmp_path / "t.jsonl"

    def progress(state: str, share: float) -> None:
        if state == "REST" and share > 0.2 and not stop.is_set():
            stop.set()

    settings = replace(BRISK, end="rest")
    outcome = stage.play(settings=settings, stop=stop, on_progress=progress, telemetry=path)
    assert outcome.outcome == "stopped"
    assert states(path)[-3:] == ["REST", "HOLD", "RELAX"]
    for person, robot in zip("ab", SMALL, strict=True):
        goals = np.array([tick["goal"] for tick in ticks(path, person, "REST")])
        bound = BRISK.ramp_speed * robot.max_velocity * STEP + 2e-5
        assert (np.abs(np.diff(goals, axis=0)) <= bound).all()
    with pytest.raises(SpecError, match="did you mean 'rest'"):
        replace(BRISK, end="rset")  # type: ignore[arg-type]


def stopped(times: int, path=None):
    stage, stop, began = Stage(robots=SMALL), StopRequest(), []

    def progress(state: str, share: float) -> None:
        if state == "PLAY" and share > 0.4 and not stop.is_set():
            began.append(stage.clock.now())
            for _ in range(times):
                stop.set()

    outcome = stage.play(stop=stop, on_progress=progress, telemetry=path).outcome
    assert outcome == "stopped"
    assert stage.torques() == [0] * 6
    return stage.clock.now() - began[0]


def test_the_first_stop_slows_down_the_second_relaxes_the_third_cuts(tmp_path, exerted):
    path = tmp_path / "t.jsonl"
    slow = stopped(1, path)
    assert states(path)[-3:] == ["PLAY", "HOLD", "RELAX"]
    quick = stopped(2, path)
    assert states(path)[-2:] == ["PLAY", "RELAX"]
    assert exerted[-1] < 0.25
    cut = stopped(3, path)
    assert exerted[-1] == 1.0  # no fading any more
    assert slow > BRISK.stop_time + BRISK.hold_time + BRISK.relax_time
    assert BRISK.relax_time < quick < slow - BRISK.stop_time
    assert cut < 0.08


def test_torque_off_reaches_servos_whatever_failed_before(monkeypatch):
    """When nothing that names a servo gets through, one packet to all of them still does."""
    stage, write_all, write = Stage(robots=SMALL), RegisterAccess.write_all, RegisterAccess.write
    over = []

    def all_but_off(access: RegisterAccess, name: str, values) -> None:
        if name == "torque_enable" and over:
            raise BusTimeout("lost", where=access.transport.port)
        write_all(access, name, values)

    def one_but_off(access: RegisterAccess, index: int, name: str, value: int) -> None:
        if name == "torque_enable" and over:
            raise BusTimeout("lost", where=access.who(index))
        write(access, index, name, value)

    monkeypatch.setattr(RegisterAccess, "write_all", all_but_off)
    monkeypatch.setattr(RegisterAccess, "write", one_but_off)

    def progress(state: str, share: float) -> None:
        if state == "SETTLE":
            over.append(state)

    with pytest.raises(BusError, match="lost"):
        stage.play(on_progress=progress)
    assert stage.torques() == [0] * 6


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="a system without SIGHUP")
def test_signals_stop_and_pause():
    before = signal.getsignal(signal.SIGHUP)
    with stop_on_signals() as stop:
        for count, number in enumerate((signal.SIGHUP, signal.SIGTERM, signal.SIGTSTP), 1):
            signal.raise_signal(number)
            assert stop_level(stop) == count
        signal.raise_signal(signal.SIGINT)
        assert stop_level(stop) == CUT
        signal.raise_signal(signal.SIGUSR1)
        assert is_paused(stop)
        signal.raise_signal(signal.SIGUSR1)
        assert not is_paused(stop)
    assert signal.getsignal(signal.SIGHUP) == before


def test_the_program_does_not_end_before_a_player_in_a_thread_has_relaxed():
    code = """
import threading, time
from bridge.stop import StopRequest, relaxed_at_exit
stop, ready = StopRequest(), threading.Event()
def play():
    with relaxed_at_exit(stop):
        ready.set()
        stop.wait(30)
        time.sleep(0.2)
        print("relaxed", stop.level, flush=True)
threading.Thread(target=play, daemon=True).start()
ready.wait()
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["relaxed", "2"]
