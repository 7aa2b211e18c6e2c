"""A virtual servo: the whole register file of a model, with its rules, and a horn that moves.

It knows no packets and no bus: :mod:`bridge.virtual.bus` speaks for it. Time is handed in.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from bridge.servo.packets import (
    ALERT,
    ERROR_ACCESS,
    ERROR_INSTRUCTION,
    ERROR_LIMIT,
    ERROR_RANGE,
    ERROR_RESULT,
)
from bridge.servo.registers import MODE_POSITION, VOLTAGE_UNIT, WATCHDOG_UNIT
from bridge.servo.table import ControlTable
from bridge.virtual.classic import ClassicMap
from bridge.virtual.drive import TORQUE_BY_GOAL, WATCHDOG_TRIPPED, Drive
from bridge.virtual.maps import ModernMap, RegisterMap
from bridge.virtual.memory import RESET_BY_MODE, Memory
from bridge.virtual.motor import STEP

OVERLOAD_TIME = 2.0
"""s of (nearly) stall current after which the overload bit is set."""
BOOT_TIME = 0.2
"""s without an answer after a reboot."""

STORE, RESTORE = 1, 2
"""What a Control Table Backup is asked for."""
TORQUE_AT_BOOT, RESTORE_RAM = 0x01, 0x02
"""Bits of Startup Configuration."""
JUDGED = ("input voltage", "overheating", "overload")
"""Errors that follow from its state."""
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")


class VirtualServo:
    """One servo: registers, rules, motion.

    Positions given to or taken from Python are rad of the horn (:attr:`angle`), 0 in the middle of
    the position register's range: at tick 2048 of an X servo, 0 of a P, 512 of an AX.
    """

    def __init__(
        self,
        table: ControlTable,
        servo_id: int,
        *,
        angle: float = 0.0,
        baud_index: int | None = None,
        load: Callable[[float], float] | None = None,
        drive: Drive | None = None,
    ) -> None:
        """Power the servo up.

        Args:
            table: Control table of its model.
            servo_id: Its id.
            angle: Where the horn stands, rad from the middle.
            baud_index: Value of its Baud Rate register; ``None`` for the factory's.
            load: Torque against positive motion as share of stall torque, from the angle in rad.
            drive: What moves the horn, instead of a motor of its own at ``angle``.
        """
        self.table = table
        self.memory = Memory(table)
        self.memory.set("id", servo_id)
        if baud_index is not None:
            self.memory.set("baud_rate", baud_index)
        kind = ClassicMap if "moving_speed" in table else ModernMap
        self._map: RegisterMap = kind(self.memory)
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
        self._time = self._heard = 0.0
        self._overload = 0.0
        self._goal = table["goal_position"]
        self._level_at = table["status_return_level"].address
        self._firmware_at = table["firmware_version"].address
        self._fast_from = table.since.get("fast_read", 256)  # which no firmware reaches
        self._delay_at = table["return_delay_time"].address
        self._bits = {name: table.error_bit(name) for name in JUDGED}
        self._power_up()

    # -- what the bus asks ------------------------------------------------------------------------

    def answers_to(self, servo_id: int) -> bool:
        """Whether a single-servo instruction for this id is for it (a shadow id counts)."""
        return servo_id == self.id or (servo_id == self._shadow and servo_id <= 252)

    @property
    def alert(self) -> int:
        """The alert bit for the error byte of its status packets."""
        return ALERT if self._map.errors else 0

    @property
    def errors(self) -> int:
        """Its hardware errors, by the bits of its table."""
        return self._map.errors

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
        first, end = self._map.stream
        if first <= address and address + length <= end:
            self._map.show_motion(self.drive)
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
                self.drive.aim(self._map.angle(value))
                return 0
        writes, error = self.memory.plan(address, data)
        if error:
            return error
        for name, value in writes:
            error = self._check(name, value)
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

    def factory_reset(self, level: int, now: float, *, everybody: bool = False) -> int:
        """Return the EEPROM to factory values.

        Args:
            level: 0xFF for all, 1 for all but the id, 2 for all but id and bit rate.
            now: s.
            everybody: Whether all servos are asked, which later firmware refuses at level 0xFF.
        """
        if level not in (0xFF, 1, 2):
            return ERROR_RANGE
        if everybody and level == 0xFF and self.has("guarded_reset"):
            return ERROR_RESULT
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
        if not self.has("clear"):
            return ERROR_INSTRUCTION
        if abs(self.motor.velocity) > self.table.units.velocity:
            return ERROR_RESULT
        self._one_turn()
        self._reload()
        return 0

    def back_up(self, task: int, now: float) -> int:
        """Keep the control table (:data:`STORE`), or bring its EEPROM back and reboot."""
        if not self.has("backup"):
            return ERROR_INSTRUCTION
        if task not in (STORE, RESTORE):
            return ERROR_RANGE
        if self.memory.get("torque_enable") or (task == RESTORE and not self.memory.backup):
            return ERROR_RESULT
        if task == STORE:
            self.memory.store()
            self.memory.set("backup_ready", 1)
        else:
            self.memory.restore("eeprom")
            self.reboot(now)
        return 0

    # -- what a test or a plant does ------------------------------------------------------------

    @property
    def angle(self) -> float:
        """Where the horn is, rad from the middle."""
        return self.motor.angle

    def place(self, angle: float) -> None:
        """Put the horn somewhere by hand, rad from the middle."""
        self.motor.angle = angle
        self.motor.brake()
        self.drive.wake()

    def trip(self, bit: int) -> None:
        """Set a bit of Hardware Error Status, and torque off if Shutdown asks for it."""
        self._map.trip(bit)
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

    def has(self, feature: str) -> bool:
        """Whether its firmware has a feature that not every one has."""
        return self.table.has(feature, self.memory.cells[self._firmware_at])

    def _power_up(self) -> None:
        memory = self.memory
        memory.set("model_number", self.table.number)
        memory.set("firmware_version", self.table.firmware)
        startup = 0
        if self.has("startup_configuration"):
            startup = memory.get("startup_configuration")
            memory.set("backup_ready", int(bool(memory.backup)))
            if startup & RESTORE_RAM:
                memory.restore("ram")
        if self._map.mode == MODE_POSITION:
            self._one_turn()
        self._reload()
        memory.set("goal_position", self._here())
        if startup & TORQUE_AT_BOOT:
            memory.set("torque_enable", 1)
            self._rest()
        self.registered = None
        self._overload = 0.0
        self._reload()

    def _one_turn(self) -> None:
        self.motor.angle = (self.motor.angle + math.pi) % (2 * math.pi) - math.pi

    def _here(self) -> int:
        """Return the goal position that means where the horn is, as far as goals reach."""
        low, high = self.table.units.multi_turn
        return max(low, min(high, self._map.ticks(self.motor.angle)))

    def _rest(self) -> None:
        """Begin to control where the horn is."""
        self.profile.start(self.motor.angle)
        self.motor.error_sum = 0.0

    def _check(self, name: str, value: int) -> int:
        """Return the error that forbids a write, or 0."""
        register = self.memory.register(name)
        if register.access == "r" or (register.area == "eeprom" and self._map.locked):
            return ERROR_ACCESS
        if self.memory.cells[self._firmware_at] < self.table.since.get(name, 0):
            return ERROR_ACCESS
        if name in GOALS and self.memory.value("bus_watchdog", 0) == WATCHDOG_TRIPPED:
            return ERROR_RANGE
        if self._map.forbids(name, value):
            return ERROR_RANGE
        if register.values is not None:
            return 0 if value in register.values else ERROR_RANGE
        low, high = register.min, register.max
        if name == "goal_position":
            low, high = self._map.goal_bounds()
        for bound, sign in ((low, -1), (high, 1)):
            if bound is not None and (value - self.memory.bound(bound)) * sign > 0:
                return ERROR_LIMIT if isinstance(bound, str) else ERROR_RANGE
        if name == "torque_enable" and value and self._map.latched:
            return ERROR_RESULT
        return 0

    def _apply(self, name: str, value: int) -> None:
        before, mode = self.memory.get(name), self._map.mode
        self.memory.set(name, value)
        self._map.written(name, value)
        if self._map.mode != mode:
            self.memory.reset_names(RESET_BY_MODE)
            if self._map.mode == MODE_POSITION:
                self._one_turn()
        elif name == "torque_enable" and value and not before:
            self._rest()
        elif name == "goal_position" and self.memory.value("drive_mode", 0) & TORQUE_BY_GOAL:
            if not (self.memory.get("torque_enable") or self._map.latched):
                self._rest()
                self.memory.set("torque_enable", 1)
        elif name == "bus_watchdog" and value:
            self._heard = self._time

    def _reload(self) -> None:
        """Decode what the motion needs."""
        get, value, table = self.memory.get, self.memory.value, self.table
        self.id, self._shadow = get("id"), value("shadow_id", 255)
        self.baud_index = get("baud_rate")
        """Value of its Baud Rate register."""
        self.baud = table.bauds.get(self.baud_index, 0)
        """bit/s at which it speaks."""
        self.protocol = 1 if value("protocol_type", table.protocol) == 1 else 2
        """Protocol that it speaks."""
        self._voltages = (get("min_voltage_limit"), get("max_voltage_limit"))
        self._hottest = get("temperature_limit")
        self._watchdog = max(0, value("bus_watchdog", 0)) * WATCHDOG_UNIT
        self._map.reload()
        self._free_goals = self._map.free_goals()
        self.due = 0.0
        self.drive.use(self._map.settings(self.profile))

    def _trip_watchdog(self) -> None:
        """Stop where the horn is, until the watchdog is cleared."""
        self.motor.brake()
        self.memory.set("bus_watchdog", WATCHDOG_TRIPPED)
        self.memory.set("goal_position", self._here())
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
        """Set hardware errors that the state calls for, and take back what may be."""
        volts, (low, high) = self.supply / VOLTAGE_UNIT, self._voltages
        self._overload = self._overload + elapsed if abs(self.motor.current) > 0.9 else 0.0
        self._judge("input voltage", not low <= volts <= high)
        self._judge("overheating", self.motor.temperature > self._hottest)
        if self._overload > OVERLOAD_TIME:
            self._judge("overload", True)

    def _judge(self, meaning: str, wrong: bool) -> None:
        bit = self._bits[meaning]
        if bit is not None and wrong:
            self.trip(bit)
        elif bit is not None and self._map.errors & 1 << bit:
            self._map.recover(bit)

    def _publish(self) -> None:
        """Write the state into the registers that show it."""
        self._map.show(self.drive, self.supply, self._time)
