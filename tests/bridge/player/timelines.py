"""Random timelines of faults for two robots, and what must hold whatever happens to them.

``python -m tests.bridge.player.timelines 0 500`` plays the timelines 0 to 499 on all cores and says
what came of them; with one number it plays that timeline alone and tells its faults.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import sys
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from bridge.player import StopRequest
from bridge.player.settings import PlayerSettings
from bridge.servo.clock import VirtualClock
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import Fault, VirtualBus
from bridge.virtual.faults import KINDS
from robots.errors import DuetError
from tests.bridge.player.stage import ROBOTS, Stage, dance

SECONDS = 10.0
"""Length of a timeline."""
DANCE = 7.5
"""Length of the dance in it, s: with what comes before and after, all of the timeline is used."""
SETTINGS = PlayerSettings(
    rate=50,
    ramp_time=0.5,
    settle_time=0.1,
    hold_time=0.1,
    soft_time=0.2,
    relax_time=0.2,
    recover_time=1.0,
)
PERIOD = 1 / 50
LONGEST = 60.0
"""s of virtual time after which a performance of 10 s hangs."""
PATIENCE = 200_000
"""How often the clock may be asked without going on."""
TICK = 2 * math.pi / 4096
PERSISTENT = ("echo", "latency", "firmware")
"""Faults that are there from the beginning: properties of an adapter or a servo."""


class Violation(AssertionError):
    """Something happened that must never happen."""


@dataclass
class Timeline:
    """What will happen."""

    seed: int
    faults: tuple[tuple[Fault, ...], tuple[Fault, ...]]
    """Of robot a and b."""
    stops: tuple[float, ...]
    """Moments at which somebody asks to stop, s."""
    stall: tuple[float, float]
    """When the computer pauses, and for how long, s."""

    def __str__(self) -> str:
        """Say what happens, a line for each thing."""
        lines = [f"timeline {self.seed}: stops at {self.stops}, pauses (at, for) {self.stall}"]
        for person, faults in zip("ab", self.faults, strict=True):
            lines += [f"  {person}: {fault}" for fault in faults]
        return "\n".join(lines)


def timeline(seed: int) -> Timeline:
    """Return a random timeline: up to three faults for each robot, stops, a pause."""
    rng = np.random.default_rng(seed)
    faults = tuple(
        tuple(_fault(rng, [joint.servo.id for joint in robot.joints]) for _ in range(count))
        for robot, count in zip(ROBOTS, rng.integers(0, 4, 2), strict=True)
    )
    first = rng.uniform(0, SECONDS)
    stops = tuple(first + 0.3 * k for k in range(rng.integers(1, 4))) if rng.random() < 0.2 else ()
    long = rng.uniform(0.02, 0.8) if rng.random() < 0.2 else 0.0
    return Timeline(seed, faults, stops, (rng.uniform(0, SECONDS), long))  # type: ignore[arg-type]


def _fault(rng: np.random.Generator, ids: list[int]) -> Fault:
    kind = str(rng.choice(list(KINDS)))
    start = 0.0 if kind in PERSISTENT or rng.random() < 0.1 else rng.uniform(0, SECONDS)
    values = {
        "delay": 10 ** rng.uniform(-3, -0.5),
        "latency": rng.choice([0.001, 0.004, 0.016]),
        "clash": rng.uniform(-1, 1),
        "baud": rng.choice([9600, 57600, 115200, 1_000_000]),
        "firmware": rng.choice([30, 37, 38, 44]),
        "hardware": rng.choice([0, 2, 3, 4, 5]),
        "brownout": rng.uniform(0, 12),
        "heat": rng.uniform(25, 2000),
        "load": rng.uniform(-1.2, 1.2),
    }
    return Fault(
        kind,  # type: ignore[arg-type]
        start,
        math.inf if kind in PERSISTENT else start + 10 ** rng.uniform(-2, 0.8),
        probability=10 ** rng.uniform(-2.5, 0),
        servo_id=int(rng.choice(ids)) if rng.random() < 0.7 else None,
        value=float(values.get(kind, math.nan)),
    )


class Witness:
    """Watches one robot's wire, and what its player sends."""

    def __init__(self, stage: Stage, index: int) -> None:
        """Watch robot ``index``."""
        self.stage, self.wire, self.robot = stage, stage.wires[index], stage.robots[index]
        servos = self.wire.servos
        joints = {joint.servo.id: joint for joint in self.robot.joints}
        self.joints = [joints[servo.id] for servo in servos]
        self.names = {servo: joint.name for servo, joint in zip(servos, self.joints, strict=True)}
        self.at = servos[0].table["torque_enable"].address
        self.torque = [servo.memory.cells[self.at] for servo in servos]
        self.found = [bool(torque) for torque in self.torque]  # under torque, as somebody left it
        self.goal_at = servos[0].table["goal_position"].address
        ratio = np.array([joint.servo.ratio for joint in self.joints])
        self.fastest = self.robot.max_velocity * ratio
        ends = [
            sorted(
                j.servo.zero + j.servo.direction * j.servo.ratio * end / TICK
                for end in (j.lower, j.upper)
            )
            for j in self.joints
        ]
        self.low, self.high = np.array(ends).T
        self.sent: np.ndarray | None = None
        self.sent_at = 0.0
        feed = self.wire.feed

        def watched(now: float, data: bytes, *, baud: int | None = None):
            answers = feed(now, data, baud=baud)
            self.look(now)
            return answers

        self.wire.feed = watched  # type: ignore[method-assign]

    def look(self, now: float) -> None:
        """Notice torque that has come on."""
        for index, servo in enumerate(self.wire.servos):
            torque = servo.memory.cells[self.at]
            self.found[index] &= bool(torque)
            if torque and not self.torque[index]:
                self.require_no_lunge(index, now)
            self.torque[index] = torque

    def require_no_lunge(self, index: int, now: float) -> None:
        """A servo under fresh torque stands at its goal and is slow."""
        servo = self.wire.servos[index]
        away = abs(servo.get("goal_position") - servo.get("present_position")) * TICK
        if away > SETTINGS.start_tolerance + 3 * TICK:
            raise Violation(f"{now:.3f}: torque came on {away:.3f} rad off, {self.names[servo]}")

    def take(self, now: float, address: int, ids, data: np.ndarray) -> None:
        """Judge goals that the player sends."""
        if address != self.goal_at or not data.size:
            return
        goals = np.ascontiguousarray(data, np.uint8).view("<i4")[:, 0].astype(float)
        outside = (goals < self.low - 1) | (goals > self.high + 1)
        if outside.any():
            raise Violation(f"{now:.3f}: a goal beyond limits, {self.named(outside)}")
        if self.sent is not None:
            elapsed = min(now - self.sent_at, 2 * PERIOD) + 1e-6
            step = np.abs(goals - self.sent) * TICK
            far = step > self.fastest * elapsed + 1.5 * TICK
            for index in np.flatnonzero(far):
                # The one other goal that may be sent is where the horn is.
                servo = self.wire.servos[index]
                if abs(goals[index] - servo.get("present_position")) * TICK > 0.05:
                    raise Violation(
                        f"{now:.3f}: a leap of {step[index]:.3f} rad, {self.named(far)}"
                    )
        self.sent, self.sent_at = goals, now

    def named(self, which: np.ndarray) -> str:
        """Return the names of joints."""
        return ", ".join(self.joints[int(index)].name for index in np.flatnonzero(which))

    def require_safe_end(self, told: str) -> None:
        """Every servo is limp, or it stands still and what was told names it or its port.

        A player that gave up before it sent anything leaves servos as it found them.
        """
        servos = self.wire.servos
        before = [servo.angle for servo in servos]
        self.wire.advance(self.stage.clock.now() + 1.0)
        moving = {
            servo
            for servo, angle in zip(servos, before, strict=True)
            if servo.memory.cells[self.at] and not servo.load and abs(servo.angle - angle) > 0.1
        }
        for index, servo in enumerate(servos):
            held = servo.memory.cells[self.at] and not (self.found[index] and self.sent is None)
            reported = self.names[servo] in told or "has gone away" in told or "opened" in told
            if held and not reported:
                raise Violation(f"{self.names[servo]} keeps its torque, which nobody was told")
            if servo in moving:
                raise Violation(f"{self.names[servo]} moves after the end")


class PatientClock(VirtualClock):
    """Virtual time that notices when it does not go on."""

    def __init__(self) -> None:
        """Start at 0."""
        super().__init__(0.0)
        self.asked = 0

    def now(self) -> float:
        """Return the time, s."""
        self.asked += 1
        if self.asked > PATIENCE:
            raise Violation(f"time stands still at {self._now:.3f}")
        return self._now

    def sleep_until(self, deadline: float) -> None:
        """Let the time be ``deadline`` s."""
        if deadline > self._now:
            self.asked = 0
            if deadline > LONGEST:
                raise Violation(f"still not at an end after {LONGEST:.0f} s")
        super().sleep_until(deadline)


class WatchedStage(Stage):
    """A stage with a witness for each robot."""

    def __init__(self, plan: Timeline) -> None:
        """Place the robots somewhere near their rest poses, with goals left by somebody else."""
        super().__init__(*plan.faults[0], b_faults=plan.faults[1], seed=plan.seed)
        self.clock = PatientClock()
        rng = np.random.default_rng([plan.seed, 1])
        for robot, wire in zip(self.robots, self.wires, strict=True):
            _disarrange(robot.joints, wire, rng)
        self.witnesses = [Witness(self, index) for index in range(2)]

    def connect(self, robot, bus, port, clock, stack):
        """Let the witness see what is sent."""
        transport = super().connect(robot, bus, port, clock, stack)
        assert isinstance(transport, SdkTransport)
        witness = self.witnesses[self.robots.index(robot)]
        write = transport.sync_write

        def watched(address: int, ids, data: np.ndarray) -> None:
            witness.take(self.clock.now(), address, ids, data)
            write(address, ids, data)

        transport.sync_write = watched  # type: ignore[method-assign]
        return transport


def _disarrange(joints, wire: VirtualBus, rng: np.random.Generator) -> None:
    held = rng.random() < 0.2  # by a player that died
    for joint, servo in zip(joints, wire.servos, strict=True):
        near = np.clip(joint.rest + rng.uniform(-0.4, 0.4), joint.lower, joint.upper)
        tick = joint.servo.zero + joint.servo.direction * joint.servo.ratio * near / TICK
        servo.place((round(tick) - 2048) * TICK)
        table = servo.table
        goal = servo.get("present_position") if held else int(rng.integers(0, 4096))
        servo.write(table["goal_position"].address, table["goal_position"].encode(goal))
        servo.write(table["torque_enable"].address, bytes([held]))


@dataclass
class Outcome:
    """How a timeline ended."""

    seed: int
    ending: str
    """``completed``, ``stopped``, or the name of the error."""
    told: str
    """What the player said, notes included."""
    ended: float
    """s of virtual time."""
    cpu: float
    """s."""
    violation: str = ""
    """What must not have happened, if it did."""
    kinds: tuple[str, ...] = field(default=())
    """Of the faults."""


def perform(plan: Timeline, duration: float = DANCE) -> Outcome:
    """Play a duet of ``duration`` s through a timeline.

    Raises:
        Violation: Something happened that must not.
    """
    begin = time.process_time()
    stage = WatchedStage(plan)
    stop, asked, stalled = StopRequest(), 0, False

    def progress(state: str, share: float) -> None:
        nonlocal asked, stalled
        now = stage.clock.now()
        if asked < len(plan.stops) and now >= plan.stops[asked]:
            asked += 1
            stop.set()
        if plan.stall[1] and not stalled and now >= plan.stall[0]:
            stalled = True
            stage.clock.sleep_until(now + plan.stall[1])

    dances = [dance(robot, duration=duration, phase=k) for k, robot in enumerate(ROBOTS)]
    try:
        ending = stage.play(dances, settings=SETTINGS, stop=stop, on_progress=progress).outcome
        told = ""
    except DuetError as error:
        ending = type(error).__name__
        told = "\n".join([str(error), *getattr(error, "__notes__", ())])
    ended = stage.clock.now()
    for witness in stage.witnesses:
        witness.require_safe_end(told)
    if stage.open_ports:
        raise Violation(f"{stage.open_ports} ports stay open")
    kinds = tuple(fault.kind for faults in plan.faults for fault in faults)
    return Outcome(plan.seed, ending, told, ended, time.process_time() - begin, kinds=kinds)


def play_one(seed: int) -> Outcome:
    """Play one timeline; whatever it raises becomes part of the outcome."""
    try:
        return perform(timeline(seed))
    except Exception as error:
        return Outcome(seed, "violation", "", 0.0, 0.0, f"{type(error).__name__}: {error}")


def main() -> int:
    """Play the timelines named on the command line; 1 if something must not have happened."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("first", type=int, help="seed of the first timeline")
    parser.add_argument("end", type=int, nargs="?", help="seed behind the last")
    parser.add_argument("--jobs", type=int, default=multiprocessing.cpu_count())
    args = parser.parse_args()
    out = sys.stdout.write
    if args.end is None:
        plan = timeline(args.first)
        out(f"{plan}\n{perform(plan)}\n")
        return 0
    with multiprocessing.get_context("spawn").Pool(args.jobs) as pool:
        outcomes = list(pool.imap(play_one, range(args.first, args.end)))
    wrong = [outcome for outcome in outcomes if outcome.violation]
    for outcome in wrong:
        out(f"{outcome.seed}: {outcome.violation}\n")
    for ending, count in Counter(outcome.ending for outcome in outcomes).most_common():
        out(f"{count:5d} {ending}\n")
    seconds = [outcome.cpu for outcome in outcomes if not outcome.violation]
    out(f"CPU s each: mean {np.mean(seconds):.2f}, longest {max(seconds):.2f}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
