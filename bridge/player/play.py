"""Performs a duet: two checked trajectories, two robots, one clock.

**The problem.** Metal moves the moment something is wrong. So the order is fixed, and nothing is
skipped::

    CHECKED     trajectories within limits, report passed, ports allowed      nothing is open yet
    DISCOVERED  the right servos answer
    CONFIGURED  torque off; mode, limits, gains, speed ceilings
    ARMED       goal := present, read back; torque on; bus watchdog on; strength grows
    RAMP        minimum jerk from where they stand to the first pose
    PLAY        goals at absolute times t0 + k dt, both robots from one phase
    SETTLE      the last goal is held until the servos have arrived
    REST        minimum jerk to the rest pose, unless the last one shall be held
    RELAX       strength fades, then torque off, on every servo, whatever fails

A stop follows the path with falling speed, then HOLD, then RELAX; a second stop relaxes at once, a
third cuts the torque. A silent servo or a lost port makes both robots wait at one phase (FREEZE)
and go on from it (RESUME) if it comes back. Any fault freezes both robots at their last goals
(FAULT), then relaxes them. A late tick is left out, never caught up. What it promises and what it
cannot is in ``SAFETY.md``.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from bridge.gate import Verdict
from bridge.plan import Part, plan, select
from bridge.player.performer import Performer
from bridge.player.puppet import Puppet
from bridge.player.settings import DEFAULT_RATE, PlayerSettings
from bridge.player.streamer import OnProgress
from bridge.player.telemetry import Performance, Telemetry
from bridge.ports import VIRTUAL, Connect, Ports, connect, ports_of
from bridge.servo.clock import Clock, MonotonicClock
from bridge.setup.budget import budgets
from bridge.stop import StopRequest, relaxed_at_exit
from bridge.trajectory import JointTrajectory
from robots.errors import GateRefused, SpecError
from robots.spec import RobotSpec

log = logging.getLogger(__name__)

PEOPLE = ("a", "b")
BACKUPS = Path("servo-backups")
"""Folder for what servos' EEPROM held before it was written."""
MAX_OVERLAP_MM = 5.0
"""Deepest overlap of the robots that metal gives way to, mm: a touch of hands, no more."""


def play(
    trajectories: Sequence[JointTrajectory],
    robots: Sequence[RobotSpec],
    *,
    gate: Verdict,
    ports: Sequence[Ports] = (VIRTUAL, VIRTUAL),
    settings: PlayerSettings | None = None,
    arm: bool = False,
    force: bool = False,
    only: Sequence[str] | None = None,
    without: Sequence[str] = (),
    write_eeprom: bool = False,
    backups: Path = BACKUPS,
    telemetry: str | Path | None = None,
    on_progress: OnProgress | None = None,
    stop: threading.Event | None = None,
    clock: Clock | None = None,
    connector: Connect = connect,
) -> Performance:
    """Perform a duet and return how it went; a stop is no error.

    Args:
        trajectories: Of person a and b, on one clock.
        robots: Who plays a and b.
        gate: What the report says.
        ports: Per robot ``"virtual"``, a device file, or a device file per bus name.
        settings: How to play.
        arm: Real servos may only be moved if this is set.
        force: Perform even if the gate did not pass; on virtual ports or as a dry run alone.
        only: Joints that play; the others are not even spoken to. All, if not given.
        without: Joints that do not play, likewise.
        write_eeprom: EEPROM of real servos that differs from the robot's file is backed up and
            written; otherwise it is refused. Virtual servos are always written.
        backups: Folder for what EEPROM held before.
        telemetry: File for what happens, one JSON line per tick and robot.
        on_progress: Told about the state and how much of it is done.
        stop: Set to stop; a :class:`StopRequest` set twice relaxes at once, and can pause.
        clock: Gives the time and waits.
        connector: Makes transports; tests put theirs here.

    Raises:
        LimitViolation: A trajectory does not fit its robot; nothing was opened.
        GateRefused: The report did not pass, or real ports are not armed; nothing was opened.
        SpecError: Ports or joints are not as they should be, or no wire carries as many ticks;
            nothing was opened.
        BusError: Hardware failed; both robots were frozen and relaxed as far as that was possible.
    """
    settings = settings or PlayerSettings()
    clock = clock or MonotonicClock()
    if not len(trajectories) == len(robots) == len(ports) == len(PEOPLE):
        raise SpecError("a duet has two trajectories, two robots and two ports")
    parts = select(plan(trajectories, robots, speed=settings.speed), only=only, without=without)
    wires = [ports_of(robot, port) for robot, port in zip(robots, ports, strict=True)]
    _require_allowed(gate, wires, moves=not settings.dry_run, arm=arm, force=force)
    rate = settings.rate or min(DEFAULT_RATE, 1000 / max(robot.cycle_ms for robot in robots))
    _require_budget(parts, rate)
    stop = stop or StopRequest()
    with ExitStack() as stack:
        file = stack.enter_context(Telemetry(telemetry))
        puppets, eeprom = [], []
        for person, part, robot, wire in zip(PEOPLE, parts, robots, wires, strict=True):
            used = {joint.servo.bus for joint in part.robot.joints}
            transports = {
                bus: connector(robot, bus, port, clock, stack)
                for bus, port in wire.items()
                if bus in used
            }
            puppet = Puppet(person, part, transports, settings, period=1 / rate)
            stack.callback(puppet.close)
            puppets.append(puppet)
            virtual = set(wire.values()) == {VIRTUAL}
            eeprom.append("free" if virtual else "write" if write_eeprom else "keep")
        performer = Performer(
            puppets,
            settings,
            period=1 / rate,
            clock=clock,
            file=file,
            on_progress=on_progress,
            stop=stop,
            eeprom=eeprom,
            backups=backups,
        )
        stack.enter_context(relaxed_at_exit(stop))
        return performer.run()


def _require_budget(parts: Sequence[Part], rate: float) -> None:
    """Refuse a rate that the bytes of a tick alone make impossible.

    Raises:
        SpecError: Naming robot, bus and what its bit rate allows.
    """
    for part in parts:
        for budget in budgets(part.robot):
            where = f"{part.robot.name}: bus.{budget.bus}"
            if rate > budget.best:
                raise SpecError(
                    f"{rate:g} ticks a second to {budget.servos} servos at {budget.baud} bit/s",
                    where=where,
                    allowed=f"at most {budget.best:.0f}",
                    hint="play at a lower --rate, or give the servos a higher bit rate",
                )
            if rate > budget.plain:
                log.warning(
                    "%s: %g ticks a second need Fast Sync Read; without, %.0f are possible",
                    where,
                    rate,
                    budget.plain,
                )


def _require_allowed(
    gate: Verdict, wires: Sequence[dict[str, str]], *, moves: bool, arm: bool, force: bool
) -> None:
    real = sorted({port for wire in wires for port in wire.values() if port != VIRTUAL})
    every = [port for wire in wires for port in wire.values() if port != VIRTUAL]
    if len(real) < len(every):
        raise SpecError("one port cannot serve two buses", where=", ".join(real))
    if not moves:
        real = []  # nothing that a report or a clear stage would be needed for
    if not gate.passed and not (force and not real):
        raise GateRefused(
            "the plausibility report did not pass",
            allowed="a motion that passes; force works on virtual ports alone",
            hint="see the report for the worst frames, or generate with another seed",
        )
    if real and not gate.overlap_mm <= MAX_OVERLAP_MM:
        raise GateRefused(
            f"the two robots would be {gate.overlap_mm:.0f} mm deep in each other",
            allowed=f"at most {MAX_OVERLAP_MM:.0f} mm on real ports",
            hint="choose a motion with more room between the dancers",
        )
    if real and not arm:
        raise GateRefused(
            f"{', '.join(real)} would move real servos",
            hint="read SAFETY.md, clear the stage, then allow it with --arm",
        )
