"""A player that is killed in the middle of the dance, on pseudo-terminals and in real time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bridge.player import PlayerSettings, Verdict, play
from bridge.trajectory import JointTrajectory
from bridge.virtual import PtyServer, VirtualBus, virtual_bus_for
from tests.bridge.player.stage import SMALL, ticks

WATCHDOG = 0.5
PATIENT = PlayerSettings(
    rate=30,
    ramp_time=1.0,
    settle_time=0.1,
    hold_time=0.1,
    soft_time=0.2,
    relax_time=0.2,
    max_stall=5,
    watchdog=WATCHDOG,
)
PLAYER = """
import sys
from pathlib import Path
from bridge.player import Verdict, play
from tests.bridge.player.test_kill import PATIENT, SMALL, slow_dances
def progress(state, share):
    if state == "PLAY" and share > 0.02:
        print("dancing", flush=True)
play(slow_dances(), SMALL, gate=Verdict(True), settings=PATIENT, ports=sys.argv[1:3], arm=True,
     write_eeprom=True, backups=Path(sys.argv[3]), on_progress=progress)
"""


def slow_dances() -> tuple[JointTrajectory, JointTrajectory]:
    """Return half a minute of constant motion."""
    times = np.arange(0.0, 30.0, 0.02)
    both = []
    for robot in SMALL:
        room = np.minimum(0.4, 0.8 * np.minimum(robot.upper - robot.rest, robot.rest - robot.lower))
        wave = np.sin(2 * times)[:, None] * room
        both.append(JointTrajectory(times, robot.rest + wave, robot.joint_names, robot.name))
    return both[0], both[1]


def killed_in_the_dance(ports: list[str], backups: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", PLAYER, *ports, str(backups)]
    player = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert player.stdout is not None
        assert player.stdout.readline() == "dancing\n"
    finally:
        os.kill(player.pid, signal.SIGKILL)
        player.wait()


def angles(buses: list[VirtualBus]) -> np.ndarray:
    return np.array([servo.angle for bus in buses for servo in bus.servos])


@pytest.mark.slow
@pytest.mark.realtime
def test_servos_stop_when_the_player_is_killed_and_the_next_start_does_not_lunge(tmp_path):
    buses = [virtual_bus_for(robot) for robot in SMALL]
    with PtyServer(buses[0], timing=True) as a, PtyServer(buses[1], timing=True) as b:
        killed_in_the_dance([a.port, b.port], tmp_path)
        time.sleep(WATCHDOG + 0.2)
        for bus in buses:
            bus.advance(time.monotonic())
        servos = [servo for bus in buses for servo in bus.servos]
        assert [servo.get("bus_watchdog") for servo in servos] == [-1] * 6
        assert [servo.get("torque_enable") for servo in servos] == [1] * 6  # held, not dropped
        stopped = angles(buses)
        time.sleep(0.3)
        for bus in buses:
            bus.advance(time.monotonic())
        np.testing.assert_allclose(angles(buses), stopped, atol=2e-3)

        dance = [
            JointTrajectory(track.times[:40], track.position[:40], track.joint_names, track.robot)
            for track in slow_dances()
        ]
        path = tmp_path / "t.jsonl"
        performance = play(
            dance,
            SMALL,
            gate=Verdict(passed=True),
            settings=PATIENT,
            ports=(a.port, b.port),
            arm=True,
            telemetry=path,
        )
        assert performance.completed
        for person, robot in zip("ab", SMALL, strict=True):
            first = ticks(path, person)[0]
            np.testing.assert_allclose(first["goal"], first["present"], atol=0.01)
            present = np.array([x["present"] for x in ticks(path, person, "RAMP")], float)
            at = np.array([x["t"] for x in ticks(path, person, "RAMP")])
            speed = np.abs(present[5:] - present[:-5]) / (at[5:] - at[:-5])[:, None]
            assert (np.nan_to_num(speed) <= 0.3 * robot.max_velocity).all()
        assert [servo.get("torque_enable") for servo in servos] == [0] * 6
