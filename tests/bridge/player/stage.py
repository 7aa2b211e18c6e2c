"""Two robots on virtual buses in virtual time: where the player's tests take place."""

from __future__ import annotations

from contextlib import ExitStack
from functools import cache
from pathlib import Path

import numpy as np

from bridge.player import PlayerSettings, Verdict, play
from bridge.player.telemetry import read_telemetry
from bridge.servo.clock import VirtualClock
from bridge.servo.sdk_transport import SdkTransport
from bridge.trajectory import JointTrajectory
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualSerial, virtual_bus_for
from robots.registry import load_robot
from robots.spec import RobotSpec

ROBOTS = (load_robot("op3"), load_robot("marionette"))
STEP = 0.02
BRISK = PlayerSettings(rate=50, ramp_time=0.5, settle_time=0.1, hold_time=0.1)
"""Short, so that the whole file runs in seconds."""


def dance(robot: RobotSpec, *, duration: float = 1.0, phase: float = 0.0) -> JointTrajectory:
    """Return a smooth trajectory around the rest pose, well inside all limits."""
    times = np.arange(0.0, duration + 1e-9, 0.02)
    room = np.minimum(robot.upper - robot.rest, robot.rest - robot.lower)
    amplitude = np.minimum(0.3, 0.8 * room)
    wave = np.sin(2 * np.pi * 0.5 * times[:, None] + phase + np.arange(len(room)))
    return JointTrajectory(times, robot.rest + amplitude * wave, robot.joint_names, robot.name)


DANCES = (dance(ROBOTS[0]), dance(ROBOTS[1], phase=1.0))


class Stage:
    """Two robots on virtual buses in virtual time, with everything recorded."""

    def __init__(self, *faults: Fault, b_faults: tuple[Fault, ...] = (), seed: int = 0):
        self.clock = VirtualClock(0.0)
        plans = (FaultPlan(faults, seed=seed), FaultPlan(b_faults, seed=seed + 1))
        self.wires: list[VirtualBus] = [
            virtual_bus_for(robot, timing=True, faults=plan)
            for robot, plan in zip(ROBOTS, plans, strict=True)
        ]
        self.goals: list[list[tuple[float, np.ndarray]]] = [[], []]
        self.open_ports = 0

    def connect(self, robot: RobotSpec, bus: str, port: str, clock, stack: ExitStack):
        wire = self.wires[ROBOTS.index(robot)]

        def opener(name: str, baud: int) -> VirtualSerial:
            self.open_ports += 1
            serial = VirtualSerial(wire, clock, baudrate=baud, timeout=0.005)
            close = serial.close

            def closed() -> None:
                self.open_ports -= 1
                close()

            serial.close = closed
            return serial

        return SdkTransport(port, robot.buses[bus].baud, opener=opener, clock=clock)

    def play(self, trajectories=DANCES, **options):
        options.setdefault("gate", Verdict(passed=True))
        options.setdefault("settings", BRISK)
        return play(trajectories, ROBOTS, clock=self.clock, connector=self.connect, **options)

    def torques(self) -> list[int]:
        return [s.memory.get("torque_enable") for wire in self.wires for s in wire.servos]

    def angles(self) -> np.ndarray:
        return np.array([servo.angle for wire in self.wires for servo in wire.servos])


def ticks(path: Path, robot: str = "a", state: str | None = None) -> list[dict]:
    lines = [line for line in read_telemetry(path) if line["kind"] == "tick"]
    return [x for x in lines if x["robot"] == robot and state in (None, x["state"])]


def states(path: Path) -> list[str]:
    return [x["state"] for x in read_telemetry(path) if x.get("event") == "state"]


@cache
def start_of_play() -> float:
    """Return when the dance itself begins, s: virtual time is the same in every run."""
    stage, starts = Stage(), []
    stage.play(on_progress=lambda state, share: starts.append((stage.clock.now(), state)))
    return next(now for now, state in starts if state == "PLAY")


def fault_time(seconds: float) -> float:
    """Return a moment of the dance, s of the clock."""
    return start_of_play() + seconds
