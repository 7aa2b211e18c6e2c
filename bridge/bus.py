"""The servos of a robot on one bus: joint names and radians in, nothing else out.

Everything that goes wrong is a :class:`~robots.errors.BusError` that names joint, id and port.
Ticks never leave :mod:`bridge.registers`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.registers import (
    EXTENDED_RANGE,
    OPERATING_MODES,
    TICKS_PER_TURN,
    WATCHDOG_UNIT,
    TickScale,
    control_table,
    hardware_error_names,
    velocity_counts,
)
from bridge.state import ServoState
from bridge.transport import Transport, describe_model
from robots.errors import BusCorrupt, BusError, BusTimeout, PortLost, ServoFault, SpecError
from robots.skeleton import FloatArray
from robots.spec import JointSpec

log = logging.getLogger(__name__)

ATTEMPTS = 3
"""How often an instruction is sent before its failure counts."""
WATCHDOG_FIRMWARE = 38
"""First firmware with a bus watchdog."""
STREAM_OFFSET, STREAM_LENGTH = -6, 10
"""The block read in every tick, from Present Position: current or load (2 bytes), velocity (4),
position (4)."""

T = TypeVar("T")


class ServoBus:
    """Servos behind one port."""

    def __init__(self, joints: Sequence[JointSpec], transport: Transport) -> None:
        """Take the joints whose servos hang on this port.

        Raises:
            SpecError: A servo has no control table, or the tables keep the streamed registers at
                different places.
        """
        if not joints:
            raise SpecError("a bus without servos", where=transport.port)
        self.joints = tuple(joints)
        self.transport = transport
        self.ids = tuple(joint.servo.id for joint in joints)
        self.joint_names = tuple(joint.name for joint in joints)
        self.tables = tuple(control_table(joint.servo.model) for joint in joints)
        self.scale = TickScale.of(
            [joint.servo.zero for joint in joints],
            [joint.servo.direction for joint in joints],
            [joint.servo.ratio for joint in joints],
        )
        self._index = {servo_id: index for index, servo_id in enumerate(self.ids)}
        self._first = self.tables[0]
        self._watchdog = [True] * len(joints)
        start = self._first["present_position"].address + STREAM_OFFSET
        for table in self.tables:
            for name in ("goal_position", "present_position", "torque_enable", "bus_watchdog"):
                if table[name].address != self._first[name].address:
                    raise SpecError(
                        f"{table.name} and {self._first.name} cannot share a bus: their"
                        f" '{name}' lie at different addresses",
                        where=transport.port,
                    )
        self._block = (start, STREAM_LENGTH)
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
        for index, (joint, table) in enumerate(zip(self.joints, self.tables, strict=True)):
            try:
                number = self._retry(index, lambda i=index: self.transport.ping(self.ids[i]))
            except BusTimeout:
                missing.append(f"{joint.name} (id {joint.servo.id})")
                continue
            if number != table.number:
                wrong.append(
                    f"{joint.name} (id {joint.servo.id}) is {describe_model(number)},"
                    f" not {describe_model(table.number)}"
                )
                continue
            self._watchdog[index] = self._read(index, "firmware_version") >= WATCHDOG_FIRMWARE
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

    def configure(self) -> None:
        """Torque off, then mode, limits, gains and the speed ceiling; EEPROM only where it differs.

        Raises:
            ServoFault: A servo reports a latched error, or carries an offset or reversal of its
                own, which belong into the robot's file.
        """
        self._all("status_return_level", [2] * len(self.ids))
        errors = self.torque_off()
        if errors:
            raise errors[0]
        for index in range(len(self.ids)):
            self._require_plain(index)
            self._configure_one(index)

    def _require_plain(self, index: int) -> None:
        status = self._read(index, "hardware_error_status")
        if status:
            raise self._hardware_fault(index, status)
        for name in ("homing_offset", "drive_mode"):
            value = self._read(index, name)
            if value:
                raise ServoFault(
                    f"{name} is {value}",
                    where=self._who(index),
                    allowed="0",
                    hint="set it to 0 and put zero and direction into robot.toml",
                )

    def _configure_one(self, index: int) -> None:
        joint, servo = self.joints[index], self.joints[index].servo
        self._settle(index, "return_delay_time", 0)
        mode = OPERATING_MODES[servo.mode]
        self._settle(index, "operating_mode", mode)
        if servo.mode == "position":
            low, high = sorted(int(tick) for tick in self._limits_in_ticks(index))
            self._settle(index, "min_position_limit", max(0, low))
            self._settle(index, "max_position_limit", min(TICKS_PER_TURN - 1, high))
        for gain in ("p", "i", "d"):
            value = getattr(servo, gain)
            if value is not None:
                self._settle(index, f"position_{gain}_gain", value)
        self._settle(index, "bus_watchdog", 0)
        self._settle(index, "profile_acceleration", 0)
        speed = velocity_counts(joint.max_velocity * servo.ratio)
        self._settle(index, "profile_velocity", speed)
        self._settle(index, "goal_pwm", self._read(index, "pwm_limit"))

    def _limits_in_ticks(self, index: int) -> tuple[int, int]:
        joint = self.joints[index]
        scale = TickScale(self.scale.zero[index : index + 1], self.scale.factor[index : index + 1])
        return int(scale.to_ticks(joint.lower)[0]), int(scale.to_ticks(joint.upper)[0])

    # -- torque -----------------------------------------------------------------------------------

    def hold_present(self, tolerance: float) -> FloatArray:
        """Make every goal the present position and return it ``[D]`` rad; torque must be off.

        A joint that stands slightly outside its limits gets the limit as goal.

        Args:
            tolerance: How far outside a joint may stand, rad.

        Raises:
            ServoFault: A joint stands outside its limits, or a goal reads back differently: torque
                on would make it jump.
        """
        present = self.positions()
        lower = np.array([joint.lower for joint in self.joints])
        upper = np.array([joint.upper for joint in self.joints])
        outside = np.maximum(lower - present, present - upper)
        for index in np.flatnonzero(outside > tolerance):
            raise ServoFault(
                f"stands at {present[index]:.3f} rad",
                where=self._who(int(index)),
                allowed=f"{lower[index]:.3f} to {upper[index]:.3f} rad",
                hint="move it inside by hand, or correct zero in robot.toml",
            )
        goal = np.clip(present, lower, upper)
        written = self.scale.from_ticks(self._ensure("goal_position", self.scale.to_ticks(goal)))
        now = self.positions()
        slack = 2 * self.scale.resolution
        for index in range(len(self.ids)):
            if abs(written[index] - goal[index]) > slack[index]:
                raise ServoFault(
                    f"its goal stays at {written[index]:.3f} rad instead of {goal[index]:.3f}:"
                    " torque would make it jump",
                    where=self._who(index),
                )
            if abs(now[index] - written[index]) > tolerance + slack[index]:
                raise ServoFault(
                    "is being moved while torque is about to come on", where=self._who(index)
                )
        return goal

    def torque_on(self) -> None:
        """Torque on for all; call :meth:`hold_present` right before.

        Raises:
            ServoFault: A servo stays limp; its latched error is named if it has one.
        """
        for index, value in enumerate(self._ensure("torque_enable", [1] * len(self.ids))):
            if value != 1:
                self._require_plain(index)
                raise ServoFault("torque did not come on", where=self._who(index))

    def torque_off(self) -> list[BusError]:
        """Try to switch every servo's torque off, whatever fails, and return what failed."""
        errors: list[BusError] = []
        try:
            self._all("torque_enable", [0] * len(self.ids))
        except BusError as error:
            errors.append(error)
            if isinstance(error, PortLost):
                return errors
        for index in range(len(self.ids)):
            try:
                if self._read(index, "torque_enable"):
                    self._write(index, "torque_enable", 0)
                    if self._read(index, "torque_enable"):
                        raise ServoFault("torque stays on", where=self._who(index))
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
        for index, value in enumerate(self._ensure("bus_watchdog", wanted)):
            if value != wanted[index] and self._watchdog[index]:
                raise ServoFault("the bus watchdog cannot be set", where=self._who(index))

    # -- streaming --------------------------------------------------------------------------------

    def write_goals(self, position: ArrayLike) -> None:
        """Send goals ``[D]`` rad to all servos with one packet.

        Raises:
            ServoFault: A goal is not finite or beyond what the servo can be sent to.
        """
        position = np.asarray(position, float)
        if not np.isfinite(position).all():
            index = int(np.flatnonzero(~np.isfinite(position))[0])
            raise ServoFault("goal is not finite", where=self._who(index))
        ticks = self.scale.to_ticks(position)
        beyond = np.flatnonzero(np.abs(ticks) > EXTENDED_RANGE)
        if len(beyond):
            raise ServoFault("goal is out of reach", where=self._who(int(beyond[0])))
        self._all("goal_position", ticks)

    def begin_read(self) -> None:
        """Ask all servos for their state; :meth:`end_read` takes the answers."""
        self.transport.sync_read_begin(*self._block, self.ids)

    def end_read(self, now: float) -> ServoState:
        """Return the state of the servos that answered; ``now`` becomes its time."""
        answers = self.transport.sync_read_end()
        raw = np.full((len(self.ids), 3), np.nan)
        alert = np.zeros(len(self.ids), bool)
        for servo_id, (bit, data) in answers.items():
            index = self._index[servo_id]
            alert[index] = bool(bit)
            raw[index] = (
                int.from_bytes(data[0:2], "little", signed=True),
                int.from_bytes(data[2:6], "little", signed=True),
                int.from_bytes(data[6:10], "little", signed=True),
            )
        return ServoState(
            time=now,
            position=self.scale.from_ticks(raw[:, 2]),
            velocity=self.scale.velocity(raw[:, 1]),
            current=raw[:, 0] * self._current_unit,
            seen=~np.isnan(raw[:, 2]),
            alert=alert,
        )

    def positions(self) -> FloatArray:
        """Return all present positions ``[D]`` rad.

        Raises:
            BusTimeout: A servo did not answer.
        """
        return self.scale.from_ticks(self._read_all("present_position"))

    def fault_of(self, index: int) -> ServoFault:
        """Return the error that a servo with the alert bit reports."""
        try:
            status = self._read(index, "hardware_error_status")
        except BusError as error:
            return ServoFault(f"reports a hardware error ({error})", where=self._who(index))
        return self._hardware_fault(index, status)

    def ask(self, name: str) -> dict[str, int]:
        """Return one register of all servos by joint name; those that do not answer are missing."""
        return {self.joint_names[index]: value for index, value in self._ask(name).items()}

    # -- inside -----------------------------------------------------------------------------------

    def _who(self, index: int) -> str:
        return f"{self.joint_names[index]} (id {self.ids[index]}, {self.port})"

    def _hardware_fault(self, index: int, status: int) -> ServoFault:
        names = ", ".join(hardware_error_names(status)) or "cleared meanwhile"
        return ServoFault(
            f"hardware error: {names}",
            where=self._who(index),
            hint="let it cool, remove the load or check the supply, then power-cycle it",
        )

    def _retry(self, index: int, call: Callable[[], T]) -> T:
        """Call up to :data:`ATTEMPTS` times; name the joint in what is raised at last."""
        left = ATTEMPTS
        while True:
            left -= 1
            try:
                return call()
            except (BusTimeout, BusCorrupt) as error:
                if not left:
                    raise type(error)(
                        error.what, where=self._who(index), hint=error.hint
                    ) from error
            except ServoFault as error:
                raise ServoFault(error.what, where=self._who(index), hint=error.hint) from error

    def _read(self, index: int, name: str) -> int:
        register = self.tables[index][name]
        _, data = self._retry(
            index,
            lambda: self.transport.read(self.ids[index], register.address, register.length),
        )
        return register.decode(data)

    def _write(self, index: int, name: str, value: int) -> None:
        register = self.tables[index][name]
        self._retry(
            index,
            lambda: self.transport.write(self.ids[index], register.address, register.encode(value)),
        )

    def _settle(self, index: int, name: str, value: int) -> None:
        """Make a register hold a value: written only if it differs, then read back."""
        if self._read(index, name) == value:
            return
        self._write(index, name, value)
        found = self._read(index, name)
        if found != value:
            raise ServoFault(f"{name} stays {found} instead of {value}", where=self._who(index))

    def _all(self, name: str, values: ArrayLike) -> None:
        """Write one register of all servos with one packet."""
        register = self._first[name]
        data = {
            servo_id: register.encode(int(value))
            for servo_id, value in zip(self.ids, np.asarray(values), strict=True)
        }
        self.transport.sync_write(register.address, data)

    def _ensure(self, name: str, values: ArrayLike) -> NDArray[np.int64]:
        """Write one register of all servos until it reads back, a few times; return what does."""
        wanted = np.asarray(values, np.int64)
        found = wanted
        for _ in range(ATTEMPTS):
            self._all(name, wanted)
            found = self._read_all(name)
            if np.array_equal(found, wanted):
                break
        return found

    def _ask(self, name: str) -> dict[int, int]:
        """Read one register of all servos; return the values by index of those that answered."""
        register = self._first[name]
        self.transport.sync_read_begin(register.address, register.length, self.ids)
        answers = self.transport.sync_read_end()
        return {self._index[servo]: register.decode(data) for servo, (_, data) in answers.items()}

    def _read_all(self, name: str) -> NDArray[np.int64]:
        """Read one register of all servos; ask those that did not answer again, one by one."""
        found = self._ask(name)
        for index in range(len(self.ids)):
            if index not in found:
                found[index] = self._read(index, name)
        return np.array([found[index] for index in range(len(self.ids))], np.int64)
