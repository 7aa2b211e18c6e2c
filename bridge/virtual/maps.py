"""What the registers of a virtual servo mean for its motion, and how the motion shows in them.

Two families of control tables hang on the same servo: the maps of the X and P series here, the
older ones of AX, MX (1.0) and XL-320 in :mod:`bridge.virtual.classic`. Register values become a
:class:`~bridge.virtual.drive.DriveSettings`, and the state of a drive becomes register values.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

from bridge.servo.registers import MODE_POSITION, MODE_PWM, VOLTAGE_UNIT
from bridge.servo.table import Bound
from bridge.virtual.drive import (
    REVERSE,
    SLAVE,
    TIME_BASED,
    TORQUE_BY_GOAL,
    WATCHDOG_TRIPPED,
    Drive,
    DriveSettings,
)
from bridge.virtual.memory import Memory
from bridge.virtual.motor import CONTROL_PERIOD, RESISTANCE_DROP, Profile

ARRIVED = 4
"""Ticks within which a goal counts as reached."""


class RegisterMap(ABC):
    """The registers of one servo, read and written as motion."""

    stream: tuple[int, int] = (1, 0)
    """First address and end of the block that :meth:`show_motion` keeps up to date by itself."""

    def __init__(self, memory: Memory) -> None:
        """Speak for these registers."""
        self.memory = memory
        self.table = memory.table
        self.units = memory.table.units
        self.sign, self.zero, self.unit = 1, self.units.center, self.units.position
        self._shown = (math.nan, math.nan, math.nan)

    def ticks(self, angle: float) -> int:
        """Return the position register's count for a horn angle, rad."""
        return round(self.sign * angle / self.unit) + self.zero

    def angle(self, ticks: int) -> float:
        """Return the horn angle, rad, of a position count."""
        return self.sign * (ticks - self.zero) * self.unit

    def reload(self) -> None:
        """Note that registers have changed."""
        self._shown = (math.nan, math.nan, math.nan)
        self.rescale()

    def show_motion(self, drive: Drive) -> None:
        """Write current or load, velocity and position, if they have changed."""
        state = (drive.motor.angle, drive.motor.velocity, drive.motor.current)
        if state != self._shown:
            self._shown = state
            self._show_motion(drive)

    def _show_supply(self, name: str, drive: Drive, supply: float) -> None:
        sag = 1 - RESISTANCE_DROP * min(1.0, abs(drive.motor.current))
        self.memory.set(name, min(255, round(supply * sag / VOLTAGE_UNIT)))
        self.memory.set("present_temperature", max(0, min(255, round(drive.motor.temperature))))

    @abstractmethod
    def rescale(self) -> None:
        """Work out sign, zero and unit of the positions."""

    @property
    @abstractmethod
    def mode(self) -> int:
        """Operating mode, as the X series counts them."""

    @property
    @abstractmethod
    def locked(self) -> bool:
        """Whether the EEPROM may not be written now."""

    @property
    @abstractmethod
    def errors(self) -> int:
        """Hardware errors, by the table's bits."""

    @property
    @abstractmethod
    def latched(self) -> bool:
        """Whether an error forbids torque."""

    @abstractmethod
    def trip(self, bit: int) -> None:
        """Note a hardware error and do what Shutdown asks for."""

    @abstractmethod
    def recover(self, bit: int) -> None:
        """Note that the cause of an error is gone."""

    @abstractmethod
    def written(self, name: str, value: int) -> None:
        """Do what a write does beside changing the register."""

    @abstractmethod
    def forbids(self, name: str, value: int) -> bool:
        """Whether a value has bits that this model or firmware does not know."""

    @abstractmethod
    def goal_bounds(self) -> tuple[Bound, Bound]:
        """Return the smallest and largest goal position."""

    @abstractmethod
    def free_goals(self) -> tuple[int, int]:
        """Return a range of goals that no rule forbids; empty if some rule may object."""

    @abstractmethod
    def settings(self, profile: Profile) -> DriveSettings:
        """Return what the motion needs."""

    @abstractmethod
    def _show_motion(self, drive: Drive) -> None:
        """Write current or load, velocity and position."""

    @abstractmethod
    def show(self, drive: Drive, supply: float, time: float) -> None:
        """Write everything that shows the state; ``supply`` in V, ``time`` in s."""


class ModernMap(RegisterMap):
    """The map of the X and P series."""

    def __init__(self, memory: Memory) -> None:
        """Speak for these registers."""
        super().__init__(memory)
        last = self.table["present_position"].end
        self.stream = (last - 10, last)

    def rescale(self) -> None:
        """Work out sign and zero of the positions."""
        self.sign = -1 if self.memory.get("drive_mode") & REVERSE else 1
        self.zero = self.units.center + self.memory.get("homing_offset")

    @property
    def mode(self) -> int:
        """Operating mode."""
        return self.memory.get("operating_mode")

    @property
    def locked(self) -> bool:
        """Torque locks the EEPROM."""
        return bool(self.memory.get("torque_enable"))

    @property
    def errors(self) -> int:
        """Hardware Error Status."""
        return self.memory.get("hardware_error_status")

    @property
    def latched(self) -> bool:
        """Until a reboot."""
        return bool(self.errors & self.memory.get("shutdown"))

    def trip(self, bit: int) -> None:
        """Set a bit of Hardware Error Status, and torque off if Shutdown asks for it."""
        self.memory.set("hardware_error_status", self.errors | 1 << bit)
        if self.memory.get("shutdown") & 1 << bit:
            self.memory.set("torque_enable", 0)

    def recover(self, bit: int) -> None:
        """Keep the bit: only a reboot clears it."""

    def written(self, name: str, value: int) -> None:
        """Nothing follows that the servo does not do itself."""

    def forbids(self, name: str, value: int) -> bool:
        """Drive Mode has the bits that the firmware knows."""
        if name != "drive_mode":
            return False
        known = REVERSE
        version = self.memory.get("firmware_version")
        for feature, bit in (
            ("slave_mode", SLAVE),
            ("time_based_profile", TIME_BASED),
            ("torque_by_goal", TORQUE_BY_GOAL),
        ):
            known |= bit if self.table.has(feature, version) else 0
        return bool(value & ~known)

    def goal_bounds(self) -> tuple[Bound, Bound]:
        """Position mode keeps the configured limits, the others turn many times."""
        if self.mode != MODE_POSITION:
            return self.units.multi_turn
        register = self.table["goal_position"]
        return register.min, register.max

    def free_goals(self) -> tuple[int, int]:
        """Return the bounds, unless a goal does more than move or may not be set at all."""
        memory = self.memory
        special = memory.get("drive_mode") & (TIME_BASED | TORQUE_BY_GOAL)
        if special or memory.get("bus_watchdog") == WATCHDOG_TRIPPED:
            return 0, -1
        low, high = self.goal_bounds()
        return memory.bound(low), memory.bound(high)

    def settings(self, profile: Profile) -> DriveSettings:
        """Return what the motion needs."""
        get, table, units = self.memory.get, self.table, self.units
        goal = self.angle(get("goal_position"))
        speed = get("profile_velocity") * units.velocity
        acceleration = get("profile_acceleration") * units.acceleration
        if get("drive_mode") & TIME_BASED:  # duration and ramp in ms instead
            duration, ramp = get("profile_velocity") / 1e3, get("profile_acceleration") / 1e3
            ramp = min(ramp, duration / 2)
            distance = abs(goal - profile.position)
            speed = distance / (duration - ramp) if duration > 0 else 0.0
            acceleration = speed / ramp if ramp > 0 else 0.0
        if get("bus_watchdog") == WATCHDOG_TRIPPED:
            speed = acceleration = 0.0
        mode, limit, duty = self.mode, get("pwm_limit"), get("goal_pwm")
        current = 1.0
        if "goal_current" in table and table.current_unit:
            current = get("goal_current") * table.current_unit / table.stall_current
        per_count = 1 / (units.pwm * units.position)
        return DriveSettings(
            torque=bool(get("torque_enable")),
            mode=mode,
            goal=goal,
            speed=speed,
            acceleration=acceleration,
            p=get("position_p_gain") / units.p_divisor * per_count,
            i=get("position_i_gain") / units.i_divisor * per_count / CONTROL_PERIOD,
            limit=(limit if mode == MODE_PWM else min(abs(duty), limit)) / units.pwm,
            duty=duty / units.pwm,
            goal_current=current,
            goal_velocity=get("goal_velocity") * units.velocity,
        )

    def _show_motion(self, drive: Drive) -> None:
        motor, memory, table = drive.motor, self.memory, self.table
        memory.set("present_position", wrapped(self.ticks(motor.angle)))
        memory.set("present_velocity", round(self.sign * motor.velocity / self.units.velocity))
        if table.current_unit is not None:
            counts = self.sign * motor.current * table.stall_current / table.current_unit
            memory.set("present_current", max(-32768, min(32767, round(counts))))
        else:
            load = self.sign * motor.current * 1000
            memory.set("present_load", max(-1000, min(1000, round(load))))

    def show(self, drive: Drive, supply: float, time: float) -> None:
        """Write everything that shows the state."""
        memory, profile = self.memory, drive.profile
        self.show_motion(drive)
        speed = memory.get("present_velocity")
        error = memory.get("goal_position") - memory.get("present_position")
        arrived = abs(error) <= ARRIVED
        running = drive.settings.torque and profile.velocity != 0
        memory.set("present_pwm", round(self.sign * drive.motor.duty * self.units.pwm))
        sag = 1 - RESISTANCE_DROP * min(1.0, abs(drive.motor.current))
        memory.set("present_input_voltage", round(supply * sag / VOLTAGE_UNIT))
        memory.set("present_temperature", max(0, min(255, round(drive.motor.temperature))))
        memory.set("moving", int(abs(speed) > memory.get("moving_threshold")))
        memory.set("moving_status", arrived | running << 1 | (not arrived) << 3)
        trajectory = round(self.sign * profile.velocity / self.units.velocity)
        memory.set("velocity_trajectory", trajectory)
        memory.set("position_trajectory", wrapped(self.ticks(profile.position)))
        memory.set("realtime_tick", int(time * 1e3) % 32768)


def wrapped(count: int) -> int:
    """Return a count as four bytes keep it: a servo that turns long enough starts over."""
    return (count + 2**31) % 2**32 - 2**31
