"""The registers of AX, MX (Protocol 1.0) and XL-320 servos.

Here the mode is not a register of its own (but for the XL-320): both angle limits 0 mean wheel,
both 4095 mean several turns (MX). Speeds and loads carry their sign in bit 10. An error takes the
power away by Torque Limit 0, and writing another limit gives it back. The compliance of the AX is
the slope around the goal on which the torque grows; here one slope, the softer of its two sides,
serves both. Punch and D gain are kept but do not act.

Source: ROBOTIS e-manual, AX-12A, MX-28, MX-64, XL-320.
"""

from __future__ import annotations

import math

from bridge.servo.registers import (
    MODE_CURRENT,
    MODE_EXTENDED_POSITION,
    MODE_POSITION,
    MODE_PWM,
    MODE_VELOCITY,
)
from bridge.servo.table import Bound
from bridge.virtual.drive import REVERSE, SLAVE, Drive, DriveSettings
from bridge.virtual.maps import RegisterMap
from bridge.virtual.memory import Memory
from bridge.virtual.motor import CONTROL_PERIOD, Profile

CLOCKWISE = 0x400
"""Bit of speeds and loads that means the negative direction."""
LARGEST = 0x3FF
"""Largest magnitude of a speed, load or torque."""
NO_CURRENT = 2048
"""Count of the current registers at rest."""
WHEEL = 1
"""Control Mode of a turning XL-320."""


class ClassicMap(RegisterMap):
    """The map of the servos from before the X series."""

    def __init__(self, memory: Memory) -> None:
        """Speak for these registers."""
        super().__init__(memory)
        self._errors = 0
        self._has_status = "hardware_error_status" in self.table

    def rescale(self) -> None:
        """Work out sign, zero and unit of the positions."""
        memory = self.memory
        self.sign = -1 if memory.value("drive_mode", 0) & REVERSE else 1
        self.zero, self.unit = self.units.center, self.units.position
        if self.mode == MODE_EXTENDED_POSITION:
            self.zero += memory.get("multi_turn_offset")
            self.unit *= memory.get("resolution_divider")

    @property
    def mode(self) -> int:
        """Operating mode: of the XL-320 by its register, of the others by the angle limits."""
        memory = self.memory
        if memory.value("torque_ctrl_mode_enable", 0):
            return MODE_CURRENT
        if "control_mode" in self.table:
            return MODE_PWM if memory.get("control_mode") == WHEEL else MODE_POSITION
        limits = {memory.get("cw_angle_limit"), memory.get("ccw_angle_limit")}
        if limits == {0}:
            return MODE_VELOCITY if "p_gain" in self.table else MODE_PWM
        if limits == {4095}:
            return MODE_EXTENDED_POSITION
        return MODE_POSITION

    @property
    def locked(self) -> bool:
        """The Lock register, where there is one, else torque locks the EEPROM."""
        lock = "lock" if "lock" in self.table else "torque_enable"
        return bool(self.memory.get(lock))

    @property
    def errors(self) -> int:
        """Hardware errors, by the table's bits."""
        return self.memory.get("hardware_error_status") if self._has_status else self._errors

    @property
    def latched(self) -> bool:
        """Torque Enable is never refused: without Torque Limit it moves nothing."""
        return False

    def _note(self, errors: int) -> None:
        self._errors = errors
        if self._has_status:
            self.memory.set("hardware_error_status", errors)

    def trip(self, bit: int) -> None:
        """Note an error; Torque Limit 0 if Shutdown asks for it."""
        self._note(self.errors | 1 << bit)
        if self.memory.get("shutdown") & 1 << bit:
            self.memory.set("torque_limit", 0)

    def recover(self, bit: int) -> None:
        """Take an error back; Torque Limit stays."""
        self._note(self.errors & ~(1 << bit))

    def written(self, name: str, value: int) -> None:
        """A new Torque Limit ends an overload."""
        if name == "torque_limit" and value:
            self._note(0)

    def forbids(self, name: str, value: int) -> bool:
        """The lock opens only without power; the MX-106 can be reversed and led."""
        if name == "lock":
            return not value and bool(self.memory.get("lock"))
        return name == "drive_mode" and bool(value & ~(REVERSE | SLAVE))

    def goal_bounds(self) -> tuple[Bound, Bound]:
        """Angle limits bind goals in joint mode only."""
        mode, register = self.mode, self.table["goal_position"]
        if mode == MODE_POSITION:
            return register.min, register.max
        if mode == MODE_EXTENDED_POSITION:
            return self.units.multi_turn
        return 0, self.table.highest("ccw_angle_limit")

    def free_goals(self) -> tuple[int, int]:
        """Return the bounds."""
        low, high = self.goal_bounds()
        return self.memory.bound(low), self.memory.bound(high)

    def settings(self, profile: Profile) -> DriveSettings:
        """Return what the motion needs."""
        del profile
        get, value, units = self.memory.get, self.memory.value, self.units
        mode, moving = self.mode, get("moving_speed")
        turning = mode in (MODE_PWM, MODE_VELOCITY)
        p, i, dead_band = self._gains()
        current = 1.0
        if self.table.current_unit and mode == MODE_CURRENT:
            current = _signed(get("goal_torque")) * self.table.current_unit
            current *= self.sign / self.table.stall_current
        return DriveSettings(
            torque=bool(get("torque_enable")),
            mode=mode,
            goal=self.angle(get("goal_position")),
            speed=0.0 if turning else min(moving, LARGEST) * units.velocity,
            acceleration=value("goal_acceleration", 0) * units.acceleration,
            p=p,
            i=i,
            limit=min(get("torque_limit"), LARGEST) / LARGEST,
            duty=self.sign * _signed(moving) / LARGEST,
            goal_current=current,
            goal_velocity=self.sign * _signed(moving) * units.velocity,
            dead_band=dead_band,
        )

    def _gains(self) -> tuple[float, float, float]:
        """Return duty per rad, duty per rad s, and the rad around the goal without torque."""
        get, units = self.memory.get, self.units
        if "p_gain" in self.table:
            per_count = 1 / (units.pwm * units.position)
            p = get("p_gain") / units.p_divisor * per_count
            return p, get("i_gain") / units.i_divisor * per_count / CONTROL_PERIOD, 0.0
        slope = max(get("cw_compliance_slope"), get("ccw_compliance_slope"))
        margin = min(get("cw_compliance_margin"), get("ccw_compliance_margin"))
        # The slope acts in seven steps, named by their powers of two.
        step = max(2, 1 << slope.bit_length() - 1) if slope else 2
        return 1 / (step * units.position), 0.0, margin * units.position

    def _show_motion(self, drive: Drive) -> None:
        motor, memory, table = drive.motor, self.memory, self.table
        ticks = self.ticks(motor.angle)
        if self.mode != MODE_EXTENDED_POSITION:  # the sensor knows one turn, or 300 degrees of it
            within = (motor.angle + math.pi) % (2 * math.pi) - math.pi
            ticks = max(0, min(table.highest("ccw_angle_limit"), self.ticks(within)))
        memory.set("present_position", max(-32768, min(32767, ticks)))
        speed = self.sign * motor.velocity
        if self.mode == MODE_PWM:  # in wheel mode a share of the largest torque
            memory.set("present_speed", _magnitude(self.sign * motor.duty * LARGEST))
        else:
            memory.set("present_speed", _magnitude(speed / self.units.velocity))
        memory.set("present_load", _magnitude(self.sign * motor.current * 1000))
        if "current" in table and table.current_unit:
            counts = self.sign * motor.current * table.stall_current / table.current_unit
            memory.set("current", max(0, min(4095, NO_CURRENT + round(counts))))

    def show(self, drive: Drive, supply: float, time: float) -> None:
        """Write everything that shows the state."""
        self.show_motion(drive)
        self._show_supply("present_voltage", drive, supply)
        self.memory.set("moving", int(abs(drive.motor.velocity) > self.units.velocity))
        if "realtime_tick" in self.table:
            self.memory.set("realtime_tick", int(time * 1e3) % 32768)


def _signed(count: int) -> int:
    """Return a speed or torque with its direction bit as a number."""
    return -(count & LARGEST) if count & CLOCKWISE else count & LARGEST


def _magnitude(value: float) -> int:
    """Return a number as magnitude with direction bit."""
    count = min(LARGEST, round(abs(value)))
    return count | CLOCKWISE if value < 0 and count else count
