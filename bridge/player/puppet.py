"""One robot on its buses, as a vector of joints."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from bridge.plan import Part
from bridge.player.governor import Governor
from bridge.player.health import Finding, Level
from bridge.player.link import Eeprom, Link
from bridge.player.settings import PlayerSettings
from bridge.servo.bus import ServoBus
from bridge.servo.clock import Clock
from bridge.servo.registers import VOLTAGE_UNIT
from bridge.servo.state import ServoState
from bridge.servo.transport import Transport
from robots.errors import BusCorrupt, BusError, BusTimeout, ServoFault
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

HEALTH = (
    *("present_temperature", "torque_enable", "goal_position", "bus_watchdog", "torque_enable"),
    *("present_input_voltage", "torque_enable", "goal_position", "bus_watchdog", "torque_enable"),
)
"""Registers read in turn while playing."""
LOST_GOALS = 3
"""Looks in a row at which a servo may hold another goal than the one that was just sent."""
GOAL_SLACK = math.radians(0.2)
"""How far a goal that is read back may be from the one sent, rad: more than two ticks."""
STALE = 0.2
"""Age of a position from which on it bounds no goal any more, s."""


class Puppet:
    """A robot that plays a part; joints are in the order of the part's robot.

    It keeps what is needed to judge a run: since when a servo has not answered or not followed.
    """

    def __init__(
        self,
        person: str,
        part: Part,
        transports: Mapping[str, Transport],
        settings: PlayerSettings,
        *,
        period: float,
    ) -> None:
        """Take the transports by bus name, and the time between two ticks in s.

        Raises:
            SpecError: Servos that share a bus cannot be streamed together.
        """
        self.person = person
        self.part = part
        self.settings = settings
        joints = part.robot.joints
        self.links: list[Link] = []
        for name, transport in transports.items():
            columns = [i for i, joint in enumerate(joints) if joint.servo.bus == name]
            if columns:
                bus = ServoBus([joints[i] for i in columns], transport)
                self.links.append(Link(bus, np.array(columns)))
        self.governor = Governor(
            part.robot,
            period=period,
            acceleration_time=settings.acceleration_time,
            reach=settings.reach,
        )
        count = len(joints)
        self.goal = np.full(count, np.nan)
        """``[D]`` rad, the last goals sent."""
        self.asked = np.full(count, np.nan)
        """``[D]`` rad, the last goals that were asked for."""
        self._sent = math.nan
        self._present, self._present_at = np.full(count, np.nan), np.full(count, -math.inf)
        self._missed = np.zeros(count, int)
        self._astray_since = np.full(count, np.nan)
        self._judged = math.nan
        self._lost_goals = np.zeros(count, int)
        self._looks = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.part.robot.joint_names

    # -- from the first packet to torque ----------------------------------------------------------

    def discover(self) -> None:
        """Open the ports and make sure that the right servos answer."""
        for link in self.links:
            link.bus.open()
            link.bus.identify()

    def configure(self, eeprom: Eeprom, backups: Path) -> None:
        """Torque off; mode, limits, gains and speed ceilings as in the robot's file."""
        for link in self.links:
            if self.settings.dry_run:
                link.inspect()
                for line in link.differences():
                    log.warning("would be written: %s", line)
            else:
                link.configure(eeprom, backups)

    def hold(self) -> None:
        """Make the goals the present positions, verified; torque must be off."""
        for link in self.links:
            bus = link.bus
            take = bus.standing if self.settings.dry_run else bus.hold_present
            try:
                self.goal[link.columns] = take(self.settings.start_tolerance)
            except BusCorrupt as error:
                raise BusCorrupt(
                    error.what,
                    where=error.where,
                    hint="do two servos share this id? 'pasdedeux scan' tells; or check the cable",
                ) from error
        self._rest_at_goal()

    def torque_on(self) -> None:
        """Torque on, softly if the servos' strength can be set."""
        if self.settings.dry_run:
            return
        self.exert(self.settings.soft_share)
        for link in self.links:
            link.bus.torque_on()

    def watchdog(self) -> None:
        """Set the bus watchdogs."""
        if not self.settings.dry_run:
            for link in self.links:
                link.bus.watchdog(self.settings.watchdog)

    def _rest_at_goal(self) -> None:
        self.asked = self.goal.copy()
        self.governor.start(self.goal)
        self._sent = math.nan

    # -- streaming --------------------------------------------------------------------------------

    def send(self, asked: FloatArray, now: float) -> None:
        """Send goals ``[D]`` rad at ``now`` s, as far as the governor lets them.

        Raises:
            LimitViolation: A goal is outside the limits: nothing is clamped in silence.
        """
        self.part.require_within(asked)
        self.asked = asked
        elapsed = 0.0 if math.isnan(self._sent) else now - self._sent
        self._sent = now
        fresh = (now - self._present_at < STALE) & (not self.settings.dry_run)
        present = np.where(fresh, self._present, np.nan)
        self.goal = self.governor.bound(asked, present, elapsed)
        self.repeat()

    def repeat(self) -> None:
        """Send the last goals again, where the port works."""
        if self.settings.dry_run:
            return
        for link in self.links:
            goal = self.goal[link.columns]
            if np.isfinite(goal).all():
                link.attempt(lambda link=link, goal=goal: link.bus.write_goals(goal))

    def exert(self, share: float) -> None:
        """Set the strength of all servos, as a share."""
        if not self.settings.dry_run:
            for link in self.links:
                link.attempt(lambda link=link: link.exert(share))

    @property
    def yields(self) -> bool:
        """Whether the strength of any servo can be set."""
        return any(link.yields for link in self.links)

    def begin_read(self) -> None:
        """Ask all servos for their state."""
        for link in self.links:
            link.attempt(link.bus.begin_read)

    def end_read(self, clock: Clock) -> ServoState:
        """Return the state of all servos."""
        count = len(self.names)
        position, velocity, current = (np.full(count, np.nan) for _ in range(3))
        seen, alert = np.zeros(count, bool), np.zeros(count, bool)
        for link in self.links:
            state = link.attempt(lambda link=link: link.bus.end_read(clock.now()))
            if state is not None:
                columns = link.columns
                position[columns], velocity[columns] = state.position, state.velocity
                current[columns], seen[columns] = state.current, state.seen
                alert[columns] = state.alert
        now = clock.now()
        self._present = np.where(seen, position, self._present)
        self._present_at = np.where(seen, now, self._present_at)
        self._missed = np.where(seen, 0, self._missed + 1)
        return ServoState(now, position, velocity, current, seen, alert)

    # -- judging ----------------------------------------------------------------------------------

    def judge(self, state: ServoState) -> list[Finding]:
        """Return what is worth saying about the servos; raise for what must end a performance.

        Raises:
            ServoFault: A servo reports a hardware error or does not follow.
        """
        for link in self.links:
            for index in np.flatnonzero(state.alert[link.columns]):
                raise link.bus.fault_of(int(index))
        settings = self.settings
        elapsed = 0.0 if math.isnan(self._judged) else state.time - self._judged
        self._judged = state.time
        findings: list[Finding] = []
        for link in self.links:
            if link.health is not None:
                findings += link.health.feel(state.current[link.columns], elapsed)
        if settings.dry_run:
            return findings
        self._astray_since = _since(
            self._astray_since, np.abs(state.position - self.asked) > settings.stray, state.time
        )
        astray = np.flatnonzero(state.time - self._astray_since > settings.stray_time)
        if len(astray):
            raise ServoFault(
                f"more than {math.degrees(settings.stray):.0f} degrees from the goal for"
                f" {settings.stray_time:.1f} s: {self._list(astray)}",
                where=self.person,
                hint="is something in its way, or the supply too weak?",
            )
        return findings

    def trouble(self) -> BusError | None:
        """Return why this robot cannot be led on at the moment, if it cannot."""
        for link in self.links:
            if link.lost is not None:
                return link.lost
        silent = np.flatnonzero(self._missed > self.settings.lost_reads)
        if not len(silent):
            return None
        return BusTimeout(
            f"no answer any more from {self._list(silent)}",
            where=self.person,
            hint="check power and cable",
        )

    def look_after(self) -> tuple[str, dict[str, float], list[Finding]]:
        """Read the next of the slow registers; return its name, values by joint, and findings.

        Raises:
            ServoFault: Torque is off or the bus watchdog has tripped in the middle of a dance, or a
                servo does not take its goals.
        """
        register = HEALTH[self._looks % len(HEALTH)]
        self._looks += 1
        every: dict[str, float] = {}
        findings: list[Finding] = []
        for link in self.links:
            raw = link.attempt(lambda link=link: link.bus.ask(register)) or {}
            values = _in_units(link.bus, register, raw)
            every |= values
            if link.health is not None:
                findings += link.health.look(register, values)
        if self.settings.dry_run:
            return register, every, findings
        if register == "torque_enable":
            self._raise_for("has lost its torque", (n for n, v in every.items() if not v))
        elif register == "bus_watchdog":
            self._raise_for("was stopped by its watchdog", (n for n, v in every.items() if v < 0))
        elif register == "goal_position":
            findings += self._compare_goals(every)
        return register, every, findings

    def _compare_goals(self, held: Mapping[str, float]) -> list[Finding]:
        """Judge goals that were read back; nobody answers the packets that carry them.

        Raises:
            ServoFault: A servo has held another goal in too many looks.
        """
        findings: list[Finding] = []
        for name, goal in held.items():
            index = self.names.index(name)
            off = abs(goal - self.goal[index])
            if off <= GOAL_SLACK:
                self._lost_goals[index] = 0
                continue
            self._lost_goals[index] += 1
            if self._lost_goals[index] >= LOST_GOALS:
                raise ServoFault(
                    f"does not take its goals: it holds one {math.degrees(off):.1f} degrees off",
                    where=self._list(np.array([index])),
                    hint="check its position limits and the cable",
                )
            if self._lost_goals[index] == 1:
                findings.append(Finding(Level.WARN, name, "did not get its last goal"))
        if self._lost_goals.any():
            self._looks -= 1  # the same once more, soon: was it chance?
        return findings

    # -- coming back and letting go ---------------------------------------------------------------

    def reopen(self, now: float) -> None:
        """Try to open what was lost."""
        for link in self.links:
            link.reopen(now)

    def revive(self) -> None:
        """Make sure that all servos hold after an absence; goals become what they hold."""
        if self.settings.dry_run:
            return
        self.goal = self.goal.copy()  # others keep the last one
        for link in self.links:
            goal = link.revive(self.settings.start_tolerance, self.settings.watchdog)
            if goal is not None:
                self.goal[link.columns] = goal
        self._rest_at_goal()

    def cut(self) -> None:
        """Broadcast torque off on all buses."""
        if not self.settings.dry_run:
            for link in self.links:
                link.cut()

    def relax(self) -> list[BusError]:
        """Try to switch every servo's torque off; return what failed."""
        if self.settings.dry_run:
            return []
        return [error for link in self.links for error in link.relax()]

    def close(self) -> None:
        """Close the ports."""
        for link in self.links:
            link.bus.close()

    def _raise_for(self, what: str, names: Iterable[str]) -> None:
        for name in names:
            servo = self.part.robot.joint(name).servo
            raise ServoFault(
                what,
                where=f"{name} (id {servo.id})",
                hint="check the supply: a servo that restarts comes back limp",
            )

    def _list(self, indices: np.ndarray) -> str:
        joints = [self.part.robot.joints[int(index)] for index in indices]
        return ", ".join(f"{joint.name} (id {joint.servo.id})" for joint in joints)


def _in_units(bus: ServoBus, register: str, raw: Mapping[str, int]) -> dict[str, float]:
    """Return values by joint in V and rad where they are voltages and positions."""
    if register == "goal_position":
        ticks = np.array([raw.get(name, 0) for name in bus.joint_names])
        angles = bus.scale.from_ticks(ticks)
        every = zip(bus.joint_names, angles, strict=True)
        return {name: round(float(angle), 5) for name, angle in every if name in raw}
    scale = VOLTAGE_UNIT if register == "present_input_voltage" else 1.0
    return {name: round(value * scale, 3) for name, value in raw.items()}


def _since(before: FloatArray, bad: np.ndarray, now: float) -> FloatArray:
    """Return since when each joint is bad, s; NaN where it is not."""
    return np.where(bad, np.where(np.isnan(before), now, before), np.nan)
