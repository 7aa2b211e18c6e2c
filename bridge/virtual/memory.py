"""The bytes of a virtual servo: a control table filled with values, and indirect addressing.

**The problem.** A write names an address and bytes; the servo must know which registers that is.
Bytes of an indirect data block stand for bytes elsewhere, by pointers that are registers
themselves, so one write can scatter over the table. :meth:`Memory.plan` resolves a write into whole
registers first and reports what does not fit, so that a refused write changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from struct import Struct

from bridge.servo.packets import ERROR_ACCESS, ERROR_LENGTH
from bridge.servo.table import Area, Bound, ControlTable, Register

SIZE = 1024
_FORMATS = {1: "<b", 2: "<h", 4: "<i"}
"""Of signed registers by length; unsigned ones have the capital letter."""
RESET_BY_MODE = (
    *("position_p_gain", "position_i_gain", "position_d_gain"),
    *("velocity_p_gain", "velocity_i_gain", "feedforward_1st_gain", "feedforward_2nd_gain"),
    *("profile_acceleration", "profile_velocity", "goal_pwm", "goal_current"),
)
"""Registers that return to their defaults when the operating mode changes."""

BACKED_UP = (
    *("velocity_p_gain", "velocity_i_gain"),
    *("position_p_gain", "position_i_gain", "position_d_gain"),
    *("feedforward_1st_gain", "feedforward_2nd_gain", "profile_acceleration", "profile_velocity"),
)
"""Registers of the RAM that a Control Table Backup keeps beside all of the EEPROM, and pointers."""


class Memory:
    """Register values of one servo."""

    def __init__(self, table: ControlTable) -> None:
        """Fill with factory values."""
        self.table = table
        self._registers, self._starts, self._data, self._codecs = _layout(table)
        self._insides = {
            address
            for register in self._registers.values()
            for address in range(register.address + 1, register.end)
        }
        self._first_data = min(self._data, default=SIZE)
        self.cells = bytearray(SIZE)
        """The bytes themselves."""
        self.backup: dict[str, int] = {}
        """What :meth:`store` kept; no reset touches it."""
        self.reset("eeprom")
        self.reset("ram")

    def register(self, name: str) -> Register:
        """Return a register or an indirect pointer by name."""
        return self._registers[name]

    def get(self, name: str) -> int:
        """Return a register's value."""
        codec, start = self._codecs[name]
        return codec.unpack_from(self.cells, start)[0]

    def value(self, name: str, default: int) -> int:
        """Return a register's value, or a default if this model has no such register."""
        return self.get(name) if name in self._codecs else default

    def set(self, name: str, value: int) -> None:
        """Set a register without asking any rule."""
        codec, start = self._codecs[name]
        codec.pack_into(self.cells, start, value)

    def bound(self, bound: Bound) -> int:
        """Return the value of a bound: a number, a register's value or the negative of one."""
        if isinstance(bound, str):
            return -self.get(bound[1:]) if bound.startswith("-") else self.get(bound)
        return bound or 0

    def reset(self, area: Area) -> None:
        """Return all writable registers of an area, and what else lives there, to defaults."""
        self.reset_names(
            name for name, register in self._registers.items() if register.area == area
        )

    def reset_names(self, names: Iterable[str]) -> None:
        """Return registers to their defaults; names this model lacks are passed over."""
        for name in names:
            if name in self._registers:
                self.set(name, self.bound(self._registers[name].default))

    def store(self) -> None:
        """Keep what a Control Table Backup keeps."""
        self.backup = {
            name: self.get(name)
            for name, register in self._registers.items()
            if register.access == "rw" and _is_backed_up(name, register)
        }

    def restore(self, area: Area) -> None:
        """Bring back what was kept of an area."""
        for name, value in self.backup.items():
            if self._registers[name].area == area:
                self.set(name, value)

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Return (error, bytes); undefined addresses read as zero."""
        if length < 1 or address + length > SIZE:
            return ERROR_ACCESS, b""
        end = address + length
        if end <= self._first_data or self._data.keys().isdisjoint(range(address, end)):
            return 0, bytes(self.cells[address:end])
        return 0, bytes(self.cells[self._target(at)] for at in range(address, end))

    def plan(self, address: int, data: bytes) -> tuple[list[tuple[str, int]], int]:
        """Return the register writes that bytes at an address mean, and an error code.

        A write must cover whole registers and may not begin where there is none.
        """
        if not data:
            return [], ERROR_LENGTH
        if address + len(data) > SIZE:
            return [], ERROR_ACCESS
        pointed = self._data
        targets = [
            self._target(at) if at in pointed else at for at in range(address, address + len(data))
        ]
        writes: list[tuple[str, int]] = []
        at = 0
        while at < len(data):
            register = self._starts.get(targets[at])
            if register is None:
                if targets[at] in self._insides:
                    return [], ERROR_LENGTH
                if at == 0:
                    return [], ERROR_ACCESS
                at += 1
                continue
            span = targets[at : at + register.length]
            if span != list(range(register.address, register.end)):
                return [], ERROR_LENGTH
            writes.append((register.name, register.decode(data[at : at + register.length])))
            at += register.length
        return writes, 0

    def _target(self, address: int) -> int:
        """Return the address that a byte stands for: its own, or what its pointer says."""
        pointer = self._data.get(address)
        if pointer is None:
            return address
        target = int.from_bytes(self.cells[pointer : pointer + 2], "little")
        return target if target < SIZE else address


@cache
def _layout(
    table: ControlTable,
) -> tuple[dict[str, Register], dict[int, Register], dict[int, int], dict[str, tuple[Struct, int]]]:
    """Return registers by name and by first byte, pointers, and how to pack each register.

    The pointers are those of the indirect data bytes, by the address of the byte. An indirect data
    byte that points to itself (the default) is a byte of free memory.
    """
    registers = dict(table.registers)
    data: dict[int, int] = {}
    number = 1
    for block in table.indirect:
        for index in range(block.count):
            pointer, byte = block.address + 2 * index, block.data + index
            registers[f"indirect_address_{number}"] = Register(
                f"indirect_address_{number}",
                pointer,
                2,
                area=block.area,
                default=byte,
                min=block.min,
                max=block.max,
            )
            registers[f"indirect_data_{number}"] = Register(f"indirect_data_{number}", byte, 1)
            data[byte] = pointer
            number += 1
    starts = {register.address: register for register in registers.values()}
    codecs = {
        name: (Struct(_format(register)), register.address) for name, register in registers.items()
    }
    return registers, starts, data, codecs


def _is_backed_up(name: str, register: Register) -> bool:
    if name.startswith("indirect_address"):
        return register.area == "ram"  # where the pointers live in the EEPROM they are left out
    return register.area == "eeprom" or name in BACKED_UP


def _format(register: Register) -> str:
    code = _FORMATS[register.length]
    return code if register.signed else code.upper()
