"""What goes away for a while: both robots wait at one phase, and go on from it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from bridge.player import StopRequest
from bridge.player.telemetry import read_telemetry
from bridge.virtual import Fault
from robots.errors import BusError, BusTimeout, PortLost
from tests.bridge.player.stage import BRISK, SMALL, STEP, Stage, fault_time, states, ticks


def away(kind: str, start: float, seconds: float) -> Fault:
    """Return a fault of the first servo (silence) or of the whole bus, during the dance."""
    begin = fault_time(start, SMALL)
    servo = SMALL[0].joints[0].servo.id if kind == "silence" else None
    return Fault(kind, start=begin, end=begin + seconds, servo_id=servo)  # type: ignore[arg-type]


def require_one_phase_without_a_leap(path) -> None:
    """Both robots stand at one phase in each tick, which never falls; no goal leaps."""
    a, b = (ticks(path, person) for person in "ab")
    assert [x["phase"] for x in a] == [x["phase"] for x in b]
    played = [x["phase"] for x in a if x["state"] == "PLAY"]
    assert (np.diff(played) >= -1e-5).all()
    for person, robot in zip("ab", SMALL, strict=True):
        goals = np.array([x["goal"] for x in ticks(path, person)])
        assert (np.abs(np.diff(goals, axis=0)) <= robot.max_velocity * 2 * STEP + 1e-4).all()


@pytest.mark.parametrize("kind", ["silence", "unplug"])
def test_both_wait_at_one_phase_for_what_comes_back_and_go_on(tmp_path, kind):
    stage, path = Stage(away(kind, 0.5, 0.3), robots=SMALL), tmp_path / "t.jsonl"
    performance = stage.play(telemetry=path)
    assert performance.completed
    assert states(path)[3:] == ["RAMP", "PLAY", "FREEZE", "RESUME", "PLAY", "SETTLE", "RELAX"]
    require_one_phase_without_a_leap(path)
    frozen = {x["phase"] for person in "ab" for x in ticks(path, person, "FREEZE")}
    assert len(frozen) == 1
    assert ticks(path, state="PLAY")[-1]["phase"] == pytest.approx(1.0, abs=1e-3)
    assert stage.torques() == [0] * 6
    assert stage.open_ports == 0


def test_servos_stopped_by_their_watchdog_meanwhile_are_led_back_gently(tmp_path):
    stage, path = Stage(away("unplug", 0.5, 0.9), robots=SMALL), tmp_path / "t.jsonl"
    settings = dataclasses.replace(BRISK, recover_time=2.0)
    assert stage.play(telemetry=path, settings=settings).completed
    require_one_phase_without_a_leap(path)
    back = ticks(path, "a", "RESUME")
    np.testing.assert_allclose(back[0]["goal"], back[0]["present"], atol=0.01)
    goals = np.array([x["goal"] for x in back])
    assert (np.abs(np.diff(goals, axis=0)) <= 0.2 * SMALL[0].max_velocity * STEP + 1e-4).all()
    assert [servo.get("bus_watchdog") for servo in stage.wires[0].servos] == [0, 0, 0]


def test_what_stays_away_ends_the_dance_after_the_bound(tmp_path):
    stage, path = Stage(away("silence", 0.5, 9.0), robots=SMALL), tmp_path / "t.jsonl"
    with pytest.raises(BusTimeout, match=SMALL[0].joint_names[0]):
        stage.play(telemetry=path)
    assert states(path)[-3:] == ["FREEZE", "FAULT", "RELAX"]
    waited = [x["t"] for x in ticks(path, state="FREEZE")]
    assert waited[-1] - waited[0] == pytest.approx(BRISK.recover_time, abs=0.1)
    assert stage.torques()[1:] == [0] * 5


def test_three_lost_answers_are_coasted_over_and_a_fourth_is_not(tmp_path):
    settings = dataclasses.replace(BRISK, health_period=60)  # each tick reads once
    for count, freezes in ((3, False), (4, True)):
        path = tmp_path / f"{count}.jsonl"
        # From half a tick before the first; that read waits for two ticks, the others for one.
        stage = Stage(away("drop", 0.49, (count + 1) * STEP), robots=SMALL)
        stage.play(telemetry=path, settings=settings)
        assert ("FREEZE" in states(path)) is freezes


def test_trouble_that_comes_too_often_ends_the_dance():
    stage = Stage(away("silence", 0.2, 0.2), away("silence", 1.6, 0.2), robots=SMALL)
    settings = dataclasses.replace(BRISK, recoveries=1)
    with pytest.raises(BusTimeout):
        stage.play(settings=settings)
    assert stage.torques() == [0] * 6


def test_a_stop_while_both_wait_relaxes_them(tmp_path):
    stage, path = Stage(away("unplug", 0.5, 9.0), robots=SMALL), tmp_path / "t.jsonl"
    stop = StopRequest()

    def progress(state: str, share: float) -> None:
        if state == "FREEZE":
            stop.set()

    with pytest.raises(PortLost):  # torque cannot be switched off behind a lost port
        stage.play(telemetry=path, stop=stop, on_progress=progress)
    assert stage.torques()[3:] == [0] * 3


def test_a_servo_that_comes_back_limp_is_a_fault_not_a_lunge():
    stage = Stage(away("silence", 0.5, 0.3), robots=SMALL)
    servo = stage.wires[0].servos[0]
    done = []

    def restart(state: str, share: float) -> None:
        if state == "FREEZE" and not done:
            done.append(servo.reboot(stage.clock.now()))

    with pytest.raises(BusError, match=r"lost its torque"):
        stage.play(on_progress=restart)
    assert stage.torques() == [0] * 6


def test_a_pause_stops_both_at_one_phase_and_ends_softly(tmp_path):
    stage, path, stop = Stage(robots=SMALL), tmp_path / "t.jsonl", StopRequest()
    seen = []

    def progress(state: str, share: float) -> None:
        if state == "PLAY":
            seen.append(share)
            if len(seen) in (20, 80):
                stop.pause()

    assert stage.play(telemetry=path, stop=stop, on_progress=progress).completed
    require_one_phase_without_a_leap(path)
    steps = np.diff([x["phase"] for x in ticks(path, state="PLAY")])
    assert (steps[48:78] == 0).all()  # half a second to slow down in
    assert (np.abs(np.diff(steps)) <= STEP * STEP / 0.5 + 1e-4).all()
    rates = [x["rate"] for x in read_telemetry(path) if x.get("event") == "rate"]
    assert rates == [0.0, 1.0]


def test_goals_lost_on_their_way_are_made_up_for_by_the_next():
    """Nobody answers a sync write; the one after it carries the whole pose again."""
    begin = fault_time(0.1, SMALL)
    stage = Stage(Fault("deaf", start=begin, end=begin + 0.8, probability=0.15), robots=SMALL)
    performance = stage.play()
    assert performance.completed
    assert performance.tracking["a"].missed_reads > 0
    assert performance.tracking["a"].max_deg < 10
