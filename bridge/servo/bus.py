"""The servos of a robot on one bus: joint names and radians in, nothing else out.

Everything that goes wrong is a :class:`~robots.errors.BusError` that names joint, id and port.
Ticks never leave :mod:`bridge.servo.registers`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from bridge.servo.access import RegisterAccess
from bridge.servo.registers import (
    OPERATING_MODES,
    WATCHDOG_UNIT,
    TickScale,
    describe_model,
    velocity_counts,
)
from bridge.servo.state import ServoState
from bridge.servo.transport import Transport
from robots.errors import BusError, BusTimeout, PortLost, ServoFault
from robots.skeleton import FloatArray
from robots.spec import JointSpec

log = logging.getLogger(__name__)

FAST_FAILURES = 10
"""Incomplete fast reads, without a complete one between, after which there are no more."""
STREAM_OFFSET, STREAM_LENGTH = -6, 10
"""The block read in every tick, from Present Position: current or load (2 bytes), velocity (4),
position (4)."""
STREAM_BLOCK = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
"""The same, as numpy reads it."""


class ServoBus:
    """Servos behind one port."""

    def __init__(
        self, joints: Sequence[JointSpec], transport: Transport, *, fast: bool = True
    ) -> None:
        """Take the joints whose servos hang on this port.

        Args:
            joints: Who is who.
            transport: The wire.
            fast: Whether Fast Sync Read may be used where all servos know it.

        Raises:
            SpecError: A servo has no control table, or the tables keep the streamed registers at
                different places.
        """
        self.registers = RegisterAccess(joints, transport)
        self.joints = tuple(joints)
        self.transport = transport
        self.ids = self.registers.ids
        self.joint_names = self.registers.joint_names
        self.tables = self.registers.tables
        self.scale = TickScale.of_servos([joint.servo for joint in joints])
        self._watchdog = [True] * len(joints)
        self._ceiling: dict[int, int] = {}
        self._may_read_fast = fast
        self._reads_fast = False  # until the firmware of all is known
        self._asks_fast = False
        self._fast_failures = 0
        self._goal_address = self.tables[0]["goal_position"].address
        self._state_address = self.tables[0]["present_position"].address + STREAM_OFFSET
        self._velocity_unit = self.scale.velocity_scale
        self._farthest = np.array([table.units.multi_turn for table in self.tables])
        self._current_unit = np.array([table.current_unit or math.nan for table in self.tables])

    @property
    def port(self) -> str:
        """Name of the port."""
        return self.transport.port

    # -- finding and setting up -------------------------------------------------------------------

    def open(self) -> None:
        """Open the port."""
        self.transport.open()

    def close(self) -> None:
        """Close the port."""
        self.transport.close()

    def identify(self) -> None:
        """Make sure that the servos of the robot, and the right models, answer.

        Raises:
            BusTimeout: Servos are missing; all of them are named.
            ServoFault: Servos are of another model; all of them are named.
        """
        missing: list[str] = []
        wrong: list[str] = []
        fast = self._may_read_fast
        for index, (joint, table) in enumerate(zip(self.joints, self.tables, strict=True)):
            try:
                number = self.registers.retry(
                    index, lambda i=index: self.transport.ping(self.ids[i])
                )
            except BusTimeout:
                missing.append(f"{joint.name} (id {joint.servo.id})")
                continue
            if number != table.number:
                wrong.append(
                    f"{joint.name} (id {joint.servo.id}) is {describe_model(number)},"
                    f" not {describe_model(table.number)}"
                )
                continue
            firmware = self.registers.read(index, "firmware_version")
            self._watchdog[index] = firmware >= table.since.get("bus_watchdog", 0)
            first = table.fast_read_firmware
            fast = fast and first is not None and firmware >= first
        if missing:
            also = f"; also {', '.join(wrong)}" if wrong else ""
            raise BusTimeout(
                f"no answer from {', '.join(missing)}{also}",
                where=self.port,
                hint="check power, cable, ids and baud",
            )
        if wrong:
            raise ServoFault(
                "; ".join(wrong), where=self.port, hint="correct robot.toml or the ids"
            )
        self._reads_fast = self._asks_fast = fast

    def configure(self) -> None:
        """Torque off, then mode, limits, gains and the speed ceiling; EEPROM only where it differs.

        Raises:
            ServoFault: A servo reports a latched error, or carries an offset or reversal of its
                own, which belong into the robot's file.
        """
        self.registers.write_all("status_return_level", [2] * len(self.ids))
        errors = self.torque_off()
        if errors:
            raise errors[0]
        for index in range(len(self.ids)):
            self.require_plain(index)
            self._configure_one(index)

    def require_plain(self, index: int) -> None:
        """Make sure that a servo has no latched error and no offset or reversal of its own.

        Raises:
            ServoFault: It has.
        """
        status = self.registers.read(index, "hardware_error_status")
        if status:
            raise self.registers.hardware_fault(index, status)
        for name in ("homing_offset", "drive_mode"):
            value = self.registers.read(index, name)
            if value:
                raise ServoFault(
                    f"{name} is {value}",
                    where=self.registers.who(index),
                    allowed="0",
                    hint="set it to 0 and put zero and direction into robot.toml",
                )

    def permanent(self, index: int) -> dict[str, int]:
        """Return what the EEPROM of a servo must hold to play the robot's part, by register."""
        servo = self.joints[index].servo
        wanted = {"return_delay_time": 0, "operating_mode": OPERATING_MODES[servo.mode]}
        if servo.mode == "position":
            low, high = sorted(int(tick) for tick in self._limits_in_ticks(index))
            table = self.tables[index]
            wanted["min_position_limit"] = max(table.lowest("min_position_limit"), low)
            wanted["max_position_limit"] = min(table.highest("max_position_limit"), high)
        return wanted

    def _configure_one(self, index: int) -> None:
        joint, servo = self.joints[index], self.joints[index].servo
        for name, value in self.permanent(index).items():
            self.registers.settle(index, name, value)
        for gain in ("p", "i", "d"):
            value = getattr(servo, gain)
            if value is not None:
                self.registers.settle(index, f"position_{gain}_gain", value)
        self.registers.settle(index, "bus_watchdog", 0)
        self.registers.settle(index, "profile_acceleration", 0)
        speed = velocity_counts(joint.max_velocity * servo.ratio, self.tables[index])
        self._ceiling[index] = self.registers.capped(index, speed)
        self.registers.settle(index, "profile_velocity", self._ceiling[index])
        self.registers.settle(index, "goal_pwm", self.registers.read(index, "pwm_limit"))

    def _limits_in_ticks(self, index: int) -> tuple[int, int]:
        joint = self.joints[index]
        scale = TickScale.of_servos([joint.servo])
        return int(scale.to_ticks(joint.lower)[0]), int(scale.to_ticks(joint.upper)[0])

    # -- torque -----------------------------------------------------------------------------------

    def standing(self, tolerance: float) -> FloatArray:
        """Return where the joints stand ``[D]`` rad; the limit for one slightly outside.

        Args:
            tolerance: How far outside a joint may stand, rad.

        Raises:
            ServoFault: A joint stands outside its limits.
        """
        present = self.positions()
        lower = np.array([joint.lower for joint in self.joints])
        upper = np.array([joint.upper for joint in self.joints])
        outside = np.maximum(lower - present, present - upper)
        for index in np.flatnonzero(outside > tolerance):
            raise ServoFault(
                f"stands at {present[index]:.3f} rad",
                where=self.registers.who(int(index)),
                allowed=f"{lower[index]:.3f} to {upper[index]:.3f} rad",
                hint="move it inside by hand, or correct zero in robot.toml",
            )
        return np.clip(present, lower, upper)

    def hold_present(self, tolerance: float) -> FloatArray:
        """Make every goal the present position and return it ``[D]`` rad.

        Torque must be off, or on without anything moving.

        Args:
            tolerance: As for :meth:`standing`.

        Raises:
            ServoFault: A joint stands outside its limits, or a goal reads back differently: torque
                on would make it jump.
        """
        goal = self.standing(tolerance)
        written = self.scale.from_ticks(
            self.registers.ensure("goal_position", self.scale.to_ticks(goal))
        )
        now = self.positions()
        slack = 2 * self.scale.resolution
        for index in range(len(self.ids)):
            if abs(written[index] - goal[index]) > slack[index]:
                raise ServoFault(
                    f"its goal stays at {written[index]:.3f} rad instead of {goal[index]:.3f}:"
                    " torque would make it jump",
                    where=self.registers.who(index),
                )
            if abs(now[index] - written[index]) > tolerance + slack[index]:
                raise ServoFault(
                    "is being moved while torque is about to come on",
                    where=self.registers.who(index),
                )
        return goal

    def torque_on(self) -> None:
        """Torque on for all; call :meth:`hold_present` right before.

        Raises:
            ServoFault: A servo has restarted since it was configured, so that nothing limits its
                speed; or it stays limp, and its latched error is named if it has one.
        """
        for index, ceiling in self._ceiling.items():
            if self.registers.read(index, "profile_velocity") != ceiling:
                raise ServoFault(
                    "has forgotten its speed ceiling",
                    where=self.registers.who(index),
                    hint="check the supply: it has restarted since it was configured",
                )
        for index, value in enumerate(self.registers.ensure("torque_enable", [1] * len(self.ids))):
            if value != 1:
                self.require_plain(index)
                raise ServoFault("torque did not come on", where=self.registers.who(index))

    def torque_off(self) -> list[BusError]:
        """Try to switch every servo's torque off, whatever fails, and return what failed."""
        errors: list[BusError] = []
        try:
            self.registers.write_all("torque_enable", [0] * len(self.ids))
        except BusError as error:
            errors.append(error)
            if isinstance(error, PortLost):
                return errors
        for index in range(len(self.ids)):
            try:
                if self.registers.read(index, "torque_enable"):
                    self.registers.write(index, "torque_enable", 0)
                    if self.registers.read(index, "torque_enable"):
                        raise ServoFault("torque stays on", where=self.registers.who(index))
            except BusError as error:
                errors.append(error)
                if isinstance(error, PortLost):
                    break
        return errors

    def watchdog(self, timeout: float) -> None:
        """Let servos stop by themselves after ``timeout`` s without a packet; 0 switches it off.

        Firmware too old for it is passed over with a warning.
        """
        count = min(127, math.ceil(timeout / WATCHDOG_UNIT - 1e-9)) if timeout > 0 else 0
        able = zip(self.joint_names, self._watchdog, strict=True)
        old = [name for name, has_one in able if not has_one]
        if old and count:
            log.warning("%s: no bus watchdog in %s", self.port, ", ".join(old))
        wanted = [count if has_one else 0 for has_one in self._watchdog]
        for index, value in enumerate(self.registers.ensure("bus_watchdog", wanted)):
            if value != wanted[index] and self._watchdog[index]:
                raise ServoFault("the bus watchdog cannot be set", where=self.registers.who(index))

    # -- streaming --------------------------------------------------------------------------------

    def write_goals(self, position: ArrayLike) -> None:
        """Send goals ``[D]`` rad to all servos with one packet.

        Raises:
            ServoFault: A goal is not finite or beyond what the servo can be sent to.
        """
        ticks = np.rint(self.scale.zero + np.asarray(position, float) * self.scale.factor)
        possible = (self._farthest[:, 0] <= ticks) & (ticks <= self._farthest[:, 1])  # not for NaN
        if not possible.all():
            index = int(np.flatnonzero(~possible)[0])
            reason = "out of reach" if math.isfinite(ticks[index]) else "not finite"
            raise ServoFault(f"goal is {reason}", where=self.registers.who(index))
        data = ticks.astype("<i4").view(np.uint8).reshape(-1, 4)
        self.transport.sync_write(self._goal_address, self.ids, data)

    def begin_read(self) -> None:
        """Ask all servos for their state; :meth:`end_read` takes the answers."""
        self.transport.sync_read_begin(
            self._state_address, STREAM_LENGTH, self.ids, fast=self._asks_fast
        )

    def end_read(self, now: float) -> ServoState:
        """Return the state of the servos that answered; ``now`` becomes its time."""
        answer = self.transport.sync_read_end()
        complete = bool(answer.seen.all())
        self._choose_read(complete=complete)
        raw = answer.data.view(STREAM_BLOCK)[:, 0]
        position = self.scale.from_ticks(raw["position"])
        velocity = raw["velocity"] * self._velocity_unit
        current = raw["current"] * self._current_unit
        if not complete:
            for values in (position, velocity, current):
                values[~answer.seen] = math.nan
        return ServoState(now, position, velocity, current, answer.seen, answer.alert)

    @property
    def reads_fast(self) -> bool:
        """Whether states are read with Fast Sync Read."""
        return self._reads_fast

    def _choose_read(self, *, complete: bool) -> None:
        """Choose how the next state is read.

        A servo that is missing in a fast read hides those behind it: after such a read it is asked
        the plain way, until all are there again. Where that goes on, it stays at the plain way.
        """
        if self._asks_fast:
            self._fast_failures = 0 if complete else self._fast_failures + 1
            if self._fast_failures >= FAST_FAILURES:
                self._reads_fast = False
                log.warning("%s: fast reads keep failing; plain ones from now on", self.port)
        self._asks_fast = self._reads_fast and complete

    def positions(self) -> FloatArray:
        """Return all present positions ``[D]`` rad.

        Raises:
            BusTimeout: A servo did not answer.
        """
        return self.scale.from_ticks(self.registers.read_all("present_position"))

    def fault_of(self, index: int) -> ServoFault:
        """Return the error that a servo with the alert bit reports."""
        try:
            status = self.registers.read(index, "hardware_error_status")
        except BusError as error:
            return ServoFault(
                f"reports a hardware error ({error})", where=self.registers.who(index)
            )
        return self.registers.hardware_fault(index, status)

    def ask(self, name: str) -> dict[str, int]:
        """Return one register of all servos by joint name; those that do not answer are missing."""
        return {self.joint_names[index]: value for index, value in self.registers.ask(name).items()}
