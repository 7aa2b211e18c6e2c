"""A virtual servo: the whole register file of a model, with its rules, and a horn that moves.

It knows no packets and no bus: :mod:`bridge.virtual.bus` speaks for it. Time is handed in.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from bridge.servo.bus import WATCHDOG_FIRMWARE
from bridge.servo.packets import (
    ALERT,
    ERROR_ACCESS,
    ERROR_LIMIT,
    ERROR_RANGE,
    ERROR_RESULT,
)
from bridge.servo.registers import (
    EXTENDED_RANGE,
    MODE_POSITION,
    POSITION_UNIT,
    PWM_FULL,
    TICKS_PER_TURN,
    VELOCITY_UNIT,
    VOLTAGE_UNIT,
    WATCHDOG_UNIT,
    ControlTable,
)
from bridge.virtual.drive import (
    REVERSE,
    TIME_BASED,
    TORQUE_BY_GOAL,
    WATCHDOG_TRIPPED,
    Drive,
    DriveSettings,
)
from bridge.virtual.memory import RESET_BY_MODE, Memory
from bridge.virtual.motor import RESISTANCE_DROP, STEP

OVERLOAD_TIME = 2.0
"""s of (nearly) stall current after which the overload bit is set."""
BOOT_TIME = 0.2
"""s without an answer after a reboot."""

SINCE = {"bus_watchdog": WATCHDOG_FIRMWARE}
"""First firmware that has a register, where not all have it."""
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")


class VirtualServo:
    """One servo: registers, rules, motion.

    Positions given to or taken from Python are rad of the horn, 0 at tick 2048 (:attr:`angle`).
    """

    def __init__(
        self,
        table: ControlTable,
        servo_id: int,
        *,
        angle: float = 0.0,
        baud_index: int = 1,
        load: Callable[[float], float] | None = None,
        drive: Drive | None = None,
    ) -> None:
        """Power the servo up.

        Args:
            table: Control table of its model.
            servo_id: Its id.
            angle: Where the horn stands, rad from tick 2048.
            baud_index: Value of its Baud Rate register.
            load: Torque against positive motion as share of stall torque, from the angle in rad.
            drive: What moves the horn, instead of a motor of its own at ``angle``.
        """
        self.table = table
        self.id = servo_id
        """Its id."""
        self.baud_index = baud_index
        """Value of its Baud Rate register."""
        self.memory = Memory(table)
        self.memory.set("id", servo_id)
        self.memory.set("baud_rate", baud_index)
        self.drive = drive or Drive(table, angle)
        self.motor, self.profile = self.drive.motor, self.drive.profile
        self.supply = table.voltage
        """V at the connector; tests may change it."""
        self.load = load
        self.registered: tuple[int, bytes] | None = None
        self.due = 0.0
        """Time before which :meth:`advance` has nothing to do."""
        self.boots_at = 0.0
        """Time before which it does not answer."""
        self._time = 0.0
        self._heard = 0.0
        self._overload = 0.0
        last = table["present_position"].end
        self._fast_block = (last - 10, last)
        self._goal, self._error_at = table["goal_position"], table["hardware_error_status"].address
        self._level_at = table["status_return_level"].address
        self._firmware_at = table["firmware_version"].address
        self._fast_from = table.fast_read_firmware or 256  # which no firmware reaches
        self._delay_at = table["return_delay_time"].address
        self._power_up()

    # -- what the bus asks ------------------------------------------------------------------------

    def answers_to(self, servo_id: int) -> bool:
        """Whether a single-servo instruction for this id is for it (a shadow id counts)."""
        return servo_id == self.id or (servo_id == self._shadow and servo_id <= 252)

    @property
    def alert(self) -> int:
        """The alert bit for the error byte of its status packets."""
        return ALERT if self.memory.cells[self._error_at] else 0

    @property
    def reads_fast(self) -> bool:
        """Whether it takes part in fast reads: by its firmware and Status Return Level."""
        return self.memory.cells[self._firmware_at] >= self._fast_from and self.return_level >= 1

    @property
    def return_level(self) -> int:
        """Its Status Return Level."""
        return self.memory.cells[self._level_at]

    @property
    def return_delay(self) -> int:
        """Its Return Delay Time, counts."""
        return self.memory.cells[self._delay_at]

    def hear(self, now: float) -> None:
        """Note that some packet was on the bus: it feeds the watchdog."""
        self._heard = now

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Return (error, data) of a read."""
        if self._fast_block[0] <= address and address + length <= self._fast_block[1]:
            self._publish_motion()
        else:
            self._publish()
        return self.memory.read(address, length)

    def write(self, address: int, data: bytes) -> int:
        """Write bytes if every rule allows it, else nothing; return the error code."""
        goal = self._goal
        if address == goal.address and len(data) == goal.length:
            # What a player writes all the time: goals that no rule can forbid.
            value = int.from_bytes(data, "little", signed=goal.signed)
            low, high = self._free_goals
            if low <= value <= high:
                self.memory.set("goal_position", value)
                self.drive.aim(self._angle(value))
                return 0
        writes, error = self.memory.plan(address, data)
        if error:
            return error
        torque = bool(self.memory.get("torque_enable"))
        for name, value in writes:
            error = self._check(name, value, torque)
            if error:
                return error
        for name, value in writes:
            self._apply(name, value)
        self._reload()
        return 0

    def register_write(self, address: int, data: bytes) -> int:
        """Keep a write for the next action."""
        _, error = self.memory.plan(address, data)
        if not error:
            self.registered = (address, data)
            self.memory.set("registered_instruction", 1)
        return error

    def action(self) -> int:
        """Carry out the kept write, if any."""
        if self.registered is None:
            return ERROR_RESULT
        address, data = self.registered
        self.registered = None
        self.memory.set("registered_instruction", 0)
        return self.write(address, data)

    def reboot(self, now: float) -> None:
        """Restart: RAM returns to its defaults, latched errors clear, no answers for a moment."""
        self.boots_at = now + BOOT_TIME
        self.memory.reset("ram")
        self._power_up()

    def factory_reset(self, level: int, now: float) -> int:
        """Return the EEPROM to factory values: 0xFF all, 1 all but id, 2 all but id and baud."""
        if level not in (0xFF, 1, 2):
            return ERROR_RANGE
        kept = {"id": self.memory.get("id"), "baud_rate": self.memory.get("baud_rate")}
        self.memory.reset("eeprom")
        if level != 0xFF:
            self.memory.set("id", kept["id"])
        if level == 2:
            self.memory.set("baud_rate", kept["baud_rate"])
        self.reboot(now)
        return 0

    def clear_turns(self) -> int:
        """Bring the present position back into one turn; fails while the horn moves."""
        if abs(self.motor.velocity) > VELOCITY_UNIT:
            return ERROR_RESULT
        self._one_turn()
        self._reload()
        return 0

    # -- what a test or a plant does ------------------------------------------------------------

    @property
    def angle(self) -> float:
        """Where the horn is, rad from tick 2048."""
        return self.motor.angle

    def place(self, angle: float) -> None:
        """Put the horn somewhere by hand, rad from tick 2048."""
        self.motor.angle = angle
        self.motor.brake()
        self.drive.wake()

    def trip(self, bit: int) -> None:
        """Set a bit of Hardware Error Status, and torque off if Shutdown asks for it."""
        status = self.memory.get("hardware_error_status") | 1 << bit
        self.memory.set("hardware_error_status", status)
        if self.memory.get("shutdown") & 1 << bit:
            self.memory.set("torque_enable", 0)
        self._reload()

    def get(self, name: str) -> int:
        """Return a register's value as it would be read."""
        self._publish()
        return self.memory.get(name)

    def advance(self, now: float) -> None:
        """Let time pass until ``now`` s, on a fixed grid of steps."""
        deadline = math.inf
        if self.drive.settings.torque and self._watchdog > 0:
            deadline = self._heard + self._watchdog
            if now > deadline:
                self._run(deadline)
                self._trip_watchdog()
        self._run(now)
        self.due = min(self._time + STEP * (1 - 1e-8), deadline)

    # -- inside -----------------------------------------------------------------------------------

    def _power_up(self) -> None:
        self.memory.set("model_number", self.table.number)
        self.memory.set("firmware_version", self.table.firmware)
        if self.memory.get("operating_mode") == MODE_POSITION:
            self._one_turn()
        self._reload()
        self.memory.set("goal_position", self._ticks(self.motor.angle))
        self.registered = None
        self._overload = 0.0
        self._reload()

    def _one_turn(self) -> None:
        self.motor.angle = (self.motor.angle + math.pi) % (2 * math.pi) - math.pi

    def _ticks(self, angle: float) -> int:
        """Return the position register's count for a horn angle."""
        return round(self._sign * angle / POSITION_UNIT) + self._zero

    def _angle(self, ticks: int) -> float:
        return self._sign * (ticks - self._zero) * POSITION_UNIT

    def _check(self, name: str, value: int, torque: bool) -> int:
        """Return the error that forbids a write, or 0."""
        register = self.memory.register(name)
        if register.access == "r" or (register.area == "eeprom" and torque):
            return ERROR_ACCESS
        if name in GOALS and self.memory.get("bus_watchdog") == WATCHDOG_TRIPPED:
            return ERROR_RANGE
        if name in SINCE and self.memory.cells[self._firmware_at] < SINCE[name]:
            return ERROR_ACCESS
        if register.values is not None:
            return 0 if value in register.values else ERROR_RANGE
        low, high = register.min, register.max
        if name == "goal_position" and self.memory.get("operating_mode") != MODE_POSITION:
            low, high = -EXTENDED_RANGE, EXTENDED_RANGE
        for bound, sign in ((low, -1), (high, 1)):
            if bound is not None and (value - self.memory.bound(bound)) * sign > 0:
                return ERROR_LIMIT if isinstance(bound, str) else ERROR_RANGE
        if name == "torque_enable" and value and self._latched:
            return ERROR_RESULT
        return 0

    @property
    def _latched(self) -> bool:
        memory = self.memory
        return bool(memory.get("hardware_error_status") & memory.get("shutdown"))

    def _apply(self, name: str, value: int) -> None:
        before = self.memory.get(name)
        self.memory.set(name, value)
        if name == "operating_mode" and value != before:
            self.memory.reset_names(RESET_BY_MODE)
            if value == MODE_POSITION:
                self._one_turn()
        elif name == "torque_enable" and value and not before:
            self.profile.start(self.motor.angle)
            self.motor.error_sum = 0.0
        elif name == "goal_position" and self.memory.get("drive_mode") & TORQUE_BY_GOAL:
            if not (self.memory.get("torque_enable") or self._latched):
                self.profile.start(self.motor.angle)
                self.memory.set("torque_enable", 1)
        elif name == "bus_watchdog" and value:
            self._heard = self._time

    def _reload(self) -> None:
        """Decode what the motion needs."""
        memory = self.memory
        get = memory.get
        self.id, self._shadow, self.baud_index = get("id"), get("shadow_id"), get("baud_rate")
        self._voltages = (get("min_voltage_limit"), get("max_voltage_limit"))
        self._hottest = get("temperature_limit")
        self._sign = -1 if get("drive_mode") & REVERSE else 1
        self._zero = TICKS_PER_TURN // 2 + get("homing_offset")
        self._free_goals = self._goals_without_rule()
        self._shown = (math.nan, math.nan, math.nan)
        self.due = 0.0
        self._watchdog = max(0, get("bus_watchdog")) * WATCHDOG_UNIT
        self.drive.use(DriveSettings.of(memory, self._angle(get("goal_position")), self.profile))

    def _goals_without_rule(self) -> tuple[int, int]:
        """Return a range of goals that can be taken as they are; empty if some rule may object."""
        memory = self.memory
        special = memory.get("drive_mode") & (TIME_BASED | TORQUE_BY_GOAL)
        if special or memory.get("bus_watchdog") == WATCHDOG_TRIPPED:
            return 0, -1
        if memory.get("operating_mode") != MODE_POSITION:
            return -EXTENDED_RANGE, EXTENDED_RANGE
        return memory.bound(self._goal.min), memory.bound(self._goal.max)

    def _trip_watchdog(self) -> None:
        """Stop where the horn is, until the watchdog is cleared."""
        self.motor.brake()
        self.memory.set("bus_watchdog", WATCHDOG_TRIPPED)
        self.memory.set("goal_position", self._ticks(self.motor.angle))
        self.memory.set("goal_velocity", 0)
        self.profile.start(self.motor.angle)
        self._reload()

    def _run(self, now: float) -> None:
        """Integrate up to the last grid point not after ``now``."""
        steps = int((now - self._time) / STEP + 1e-9)
        if steps <= 0:
            return
        self.drive.run(steps, self.supply, self.load)
        self._time += steps * STEP
        self._protect(steps * STEP)

    def _protect(self, elapsed: float) -> None:
        """Set hardware errors that the state calls for."""
        volts = self.supply / VOLTAGE_UNIT
        if not self._voltages[0] <= volts <= self._voltages[1]:
            self.trip(0)
        if self.motor.temperature > self._hottest:
            self.trip(2)
        self._overload = self._overload + elapsed if abs(self.motor.current) > 0.9 else 0.0
        if self._overload > OVERLOAD_TIME:
            self.trip(5)

    def _publish(self) -> None:
        """Write the state into the registers that show it."""
        motor, memory = self.motor, self.memory
        self._publish_motion()
        speed, sign = memory.get("present_velocity"), self._sign
        error = memory.get("goal_position") - memory.get("present_position")
        moving = abs(speed) > memory.get("moving_threshold")
        arrived = abs(error) <= 4
        running = self.drive.settings.torque and self.profile.velocity != 0
        memory.set("present_pwm", round(sign * motor.duty * PWM_FULL))
        sag = 1 - RESISTANCE_DROP * min(1.0, abs(motor.current))
        memory.set("present_input_voltage", round(self.supply * sag / VOLTAGE_UNIT))
        memory.set("present_temperature", max(0, min(255, round(motor.temperature))))
        memory.set("moving", int(moving))
        memory.set("moving_status", arrived | running << 1 | (not arrived) << 3)
        memory.set("velocity_trajectory", round(sign * self.profile.velocity / VELOCITY_UNIT))
        memory.set("position_trajectory", self._ticks(self.profile.position))
        memory.set("realtime_tick", int(self._time * 1e3) % 32768)

    def _publish_motion(self) -> None:
        """Write current or load, velocity and position."""
        motor, memory, table, sign = self.motor, self.memory, self.table, self._sign
        state = (motor.angle, motor.velocity, motor.current)
        if state == self._shown:
            return
        self._shown = state
        memory.set("present_position", self._ticks(motor.angle))
        memory.set("present_velocity", round(sign * motor.velocity / VELOCITY_UNIT))
        if table.current_unit is not None:
            counts = sign * motor.current * table.stall_current / table.current_unit
            memory.set("present_current", max(-32768, min(32767, round(counts))))
        else:
            load = sign * motor.current * 1000
            memory.set("present_load", max(-1000, min(1000, round(load))))
