"""How a performance is stopped from outside."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from bridge.player import StopRequest
from tests.bridge.player.stage import STEP, Stage, states, ticks


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
