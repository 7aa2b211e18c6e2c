"""Two robots on virtual buses in virtual time: where the player's tests take place."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from bridge.gate import RETARGETING, vouch
from bridge.player import PlayerSettings, Verdict, play
from bridge.player.telemetry import read_telemetry
from bridge.servo.clock import VirtualClock
from bridge.servo.sdk_transport import SdkTransport
from bridge.trajectory import JointTrajectory
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualSerial, virtual_bus_for
from robots.files import write_json
from robots.registry import load_robot
from robots.spec import RobotSpec
from sim.report import Metric, Report

ROBOTS = (load_robot("op3"), load_robot("marionette"))
SMALL = tuple(dataclasses.replace(robot, joints=robot.joints[:3]) for robot in ROBOTS)
"""Three joints each: what does not depend on their number is shown sooner."""
STEP = 0.02
BRISK = PlayerSettings(
    rate=50,
    ramp_time=0.5,
    settle_time=0.1,
    end="hold",
    hold_time=0.1,
    soft_time=0.1,
    relax_time=0.1,
    recover_time=0.5,
)
"""Short, so that the whole file runs in seconds."""


def dance(robot: RobotSpec, *, duration: float = 1.0, phase: float = 0.0) -> JointTrajectory:
    """Return a smooth trajectory around the rest pose, well inside all limits."""
    times = np.arange(0.0, duration + 1e-9, 0.02)
    room = np.minimum(robot.upper - robot.rest, robot.rest - robot.lower)
    amplitude = np.minimum(0.3, 0.8 * room)
    wave = np.sin(2 * np.pi * 0.5 * times[:, None] + phase + np.arange(len(room)))
    return JointTrajectory(times, robot.rest + amplitude * wave, robot.joint_names, robot.name)


def dances(robots: Sequence[RobotSpec]) -> tuple[JointTrajectory, JointTrajectory]:
    """Return what two robots dance."""
    return dance(robots[0]), dance(robots[1], phase=1.0)


DANCES = dances(ROBOTS)


FEW = tuple(name for name in ROBOTS[0].joint_names if name in ROBOTS[1].joint_names)[:3]
"""Joints of both that play where only a few shall: ``only`` of a performance by files."""


def write_duet(folder: Path, *, duration: float = 1.0) -> tuple[Path, Path, Path]:
    """Write what ``retarget`` and ``score`` leave; return trajectories of a and b, and report."""
    told = [
        dataclasses.replace(dance(robot, duration=duration), metadata={"motion_sha256": "f00d"})
        for robot in ROBOTS
    ]
    a, b = (folder / f"trajectory-{person}.npz" for person in "ab")
    for path, track in zip((a, b), told, strict=True):
        track.save(path)
    write_json(folder / RETARGETING, {"penetration_max_mm": 0.0, **vouch(told)})
    Report(
        kind="tracked",
        score=100.0,
        metrics=(
            Metric(
                name="mpjpe_global",
                of="simulated",
                person="both",
                value=20.0,
                unit="mm",
                definition="distance from the motion",
                threshold=100.0,
            ),
        ),
        text="they sway",
        licence="CC0-1.0",
        duration=duration,
        input_sha256="f00d",
    ).save(folder / "report.json")
    return a, b, folder / "report.json"


class Stage:
    """Two robots on virtual buses in virtual time, with everything recorded."""

    def __init__(
        self,
        *faults: Fault,
        b_faults: tuple[Fault, ...] = (),
        seed: int = 0,
        robots: Sequence[RobotSpec] = ROBOTS,
    ):
        self.robots = tuple(robots)
        self.clock = VirtualClock(0.0)
        plans = (FaultPlan(faults, seed=seed), FaultPlan(b_faults, seed=seed + 1))
        self.wires: list[VirtualBus] = [
            virtual_bus_for(robot, timing=True, faults=plan)
            for robot, plan in zip(robots, plans, strict=True)
        ]
        self.goals: list[list[tuple[float, np.ndarray]]] = [[], []]
        self.open_ports = 0

    def connect(self, robot: RobotSpec, bus: str, port: str, clock, stack: ExitStack):
        wire = self.wires[self.robots.index(robot)]

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

    def play(self, trajectories=None, **options):
        options.setdefault("gate", Verdict(passed=True))
        options.setdefault("settings", BRISK)
        told = trajectories or dances(self.robots)
        return play(told, self.robots, clock=self.clock, connector=self.connect, **options)

    def torques(self) -> list[int]:
        return [s.memory.get("torque_enable") for wire in self.wires for s in wire.servos]

    def angles(self) -> np.ndarray:
        return np.array([servo.angle for wire in self.wires for servo in wire.servos])


def ticks(path: Path, robot: str = "a", state: str | None = None) -> list[dict]:
    lines = [line for line in read_telemetry(path) if line["kind"] == "tick"]
    return [x for x in lines if x["robot"] == robot and state in (None, x["state"])]


def states(path: Path) -> list[str]:
    return [x["state"] for x in read_telemetry(path) if x.get("event") == "state"]


class _Playing(Exception):
    pass


_STARTS: dict[int, float] = {}


def start_of_play(robots: Sequence[RobotSpec] = ROBOTS) -> float:
    """Return when the dance itself begins, s: virtual time is the same in every run."""
    key = len(robots[0].joints)
    stage = Stage(robots=robots)

    def progress(state: str, share: float) -> None:
        if state == "PLAY":
            _STARTS[key] = stage.clock.now()
            raise _Playing

    if key not in _STARTS:
        with suppress(_Playing):
            stage.play(on_progress=progress)
    return _STARTS[key]


def fault_time(seconds: float, robots: Sequence[RobotSpec] = ROBOTS) -> float:
    """Return a moment of the dance, s of the clock."""
    return start_of_play(robots) + seconds
