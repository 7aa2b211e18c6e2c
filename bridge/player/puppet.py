"""One robot on its buses, as a vector of joints."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping

import numpy as np

from bridge.plan import Part
from bridge.player.settings import PlayerSettings
from bridge.servo.bus import ServoBus
from bridge.servo.clock import Clock
from bridge.servo.registers import VOLTAGE_UNIT
from bridge.servo.state import ServoState
from bridge.servo.transport import Transport
from robots.errors import BusError, BusTimeout, ServoFault
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

HEALTH = (
    *("torque_enable", "bus_watchdog", "torque_enable", "present_input_voltage"),
    *("torque_enable", "bus_watchdog", "torque_enable", "present_temperature"),
)
"""Registers read in turn while playing."""


class Puppet:
    """A robot that plays a part; joints are in the order of the robot's file.

    It keeps what is needed to judge a run: since when a servo has not answered or not followed.
    """

    def __init__(self, person: str, part: Part, transports: Mapping[str, Transport]) -> None:
        """Take the transports by bus name.

        Raises:
            SpecError: Servos that share a bus cannot be streamed together.
        """
        self.person = person
        self.part = part
        joints = part.robot.joints
        self.buses: list[ServoBus] = []
        self._columns: list[np.ndarray] = []
        for name, transport in transports.items():
            columns = [i for i, joint in enumerate(joints) if joint.servo.bus == name]
            if columns:
                self.buses.append(ServoBus([joints[i] for i in columns], transport))
                self._columns.append(np.array(columns))
        count = len(joints)
        self.goal = np.full(count, np.nan)
        """``[D]`` rad, the last goals sent."""
        self._silent_since = np.full(count, np.nan)
        self._astray_since = np.full(count, np.nan)
        self._asked = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.part.robot.joint_names

    def discover(self) -> None:
        """Open the ports and make sure that the right servos answer."""
        for bus in self.buses:
            bus.open()
            bus.identify()

    def configure(self) -> None:
        """Torque off; mode, limits, gains and speed ceilings as in the robot's file."""
        for bus in self.buses:
            bus.configure()

    def hold(self, tolerance: float) -> FloatArray:
        """Make the goals the present positions, verified, and return them ``[D]`` rad."""
        for bus, columns in zip(self.buses, self._columns, strict=True):
            self.goal[columns] = bus.hold_present(tolerance)
        return self.goal.copy()

    def torque_on(self) -> None:
        """Torque on."""
        for bus in self.buses:
            bus.torque_on()

    def watchdog(self, timeout: float) -> None:
        """Set the bus watchdogs, s; 0 switches them off."""
        for bus in self.buses:
            bus.watchdog(timeout)

    def forget_watchdog(self) -> None:
        """Switch the bus watchdogs off if the servos still answer."""
        for bus in self.buses:
            try:
                bus.watchdog(0)
            except BusError as error:
                log.warning("the bus watchdog stays set: %s", error)

    def relax(self) -> list[BusError]:
        """Try to switch every servo's torque off; return what failed."""
        errors: list[BusError] = []
        for bus in self.buses:
            errors += bus.torque_off()
        return errors

    def close(self) -> None:
        """Close the ports."""
        for bus in self.buses:
            bus.close()

    def send(self, goal: FloatArray) -> None:
        """Send goals ``[D]`` rad.

        Raises:
            LimitViolation: A goal is outside the limits: nothing is clamped in silence.
        """
        self.part.require_within(goal)
        # The slack of the check above is rounding; a servo's own limit has none.
        goal = np.clip(goal, self.part.robot.lower, self.part.robot.upper)
        for bus, columns in zip(self.buses, self._columns, strict=True):
            bus.write_goals(goal[columns])
        self.goal = goal

    def repeat(self) -> list[BusError]:
        """Send the last goals again; return what failed."""
        errors: list[BusError] = []
        for bus, columns in zip(self.buses, self._columns, strict=True):
            try:
                if np.isfinite(self.goal[columns]).all():
                    bus.write_goals(self.goal[columns])
            except BusError as error:
                errors.append(error)
        return errors

    def begin_read(self) -> None:
        """Ask all servos for their state."""
        for bus in self.buses:
            bus.begin_read()

    def end_read(self, clock: Clock) -> ServoState:
        """Return the state of all servos."""
        count = len(self.names)
        position, velocity, current = (np.full(count, np.nan) for _ in range(3))
        seen, alert = np.zeros(count, bool), np.zeros(count, bool)
        for bus, columns in zip(self.buses, self._columns, strict=True):
            state = bus.end_read(clock.now())
            position[columns], velocity[columns] = state.position, state.velocity
            current[columns], seen[columns] = state.current, state.seen
            alert[columns] = state.alert
        return ServoState(clock.now(), position, velocity, current, seen, alert)

    def judge(self, state: ServoState, settings: PlayerSettings) -> None:
        """Raise for what must end a performance.

        Raises:
            ServoFault: A servo reports a hardware error or does not follow.
            BusTimeout: A servo has been silent for too long.
        """
        for bus, columns in zip(self.buses, self._columns, strict=True):
            for index in np.flatnonzero(state.alert[columns]):
                raise bus.fault_of(int(index))
        self._silent_since = _since(self._silent_since, ~state.seen, state.time)
        self._astray_since = _since(
            self._astray_since, np.abs(state.position - self.goal) > settings.stray, state.time
        )
        silent = np.flatnonzero(state.time - self._silent_since > settings.error_timeout)
        if len(silent):
            raise BusTimeout(
                f"no answer for {settings.error_timeout:.1f} s from {self._list(silent)}",
                where=self.person,
                hint="check power and cable",
            )
        astray = np.flatnonzero(state.time - self._astray_since > settings.stray_time)
        if len(astray):
            raise ServoFault(
                f"more than {math.degrees(settings.stray):.0f} degrees from the goal for"
                f" {settings.stray_time:.1f} s: {self._list(astray)}",
                where=self.person,
                hint="is something in its way, or the supply too weak?",
            )

    def look_after(self) -> dict[str, dict[str, float]]:
        """Read the next of the slow registers and return it by name and joint.

        Raises:
            ServoFault: Torque is off or the bus watchdog has tripped in the middle of a dance.
        """
        register = HEALTH[self._asked % len(HEALTH)]
        self._asked += 1
        values: dict[str, int] = {}
        for bus in self.buses:
            values |= bus.ask(register)
        if register == "torque_enable":
            self._raise_for("has lost its torque", (n for n, v in values.items() if not v))
        elif register == "bus_watchdog":
            self._raise_for("was stopped by its watchdog", (n for n, v in values.items() if v < 0))
        scale = VOLTAGE_UNIT if register == "present_input_voltage" else 1.0
        return {register: {name: round(value * scale, 3) for name, value in values.items()}}

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


def _since(before: FloatArray, bad: np.ndarray, now: float) -> FloatArray:
    """Return since when each joint is bad, s; NaN where it is not."""
    return np.where(bad, np.where(np.isnan(before), now, before), np.nan)
