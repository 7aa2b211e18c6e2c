"""One servo model: its registers, what their counts stand for, and since which firmware.

The numbers are data, ``bridge/servo/models/*.toml``; :mod:`bridge.servo.registers` reads them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from robots.errors import SpecError, nearest

Access = Literal["r", "rw"]
Area = Literal["eeprom", "ram"]
Bound = int | str | None


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of a control table.

    Raises:
        SpecError: The entry contradicts itself.
    """

    name: str
    """As in ``bridge/servo/models``: the maker's data name in snake case."""
    address: int
    """First byte."""
    length: int
    """Bytes: 1, 2 or 4, little endian."""
    access: Access = "rw"
    """``r`` or ``rw``."""
    area: Area = "ram"
    """``eeprom`` survives power-off and is locked while torque is on."""
    signed: bool = False
    """Whether the value is two's complement."""
    default: Bound = 0
    """Factory value, or the name of the register whose value it starts with."""
    min: Bound = None
    """Smallest value; a register's name (with ``-`` for its negative) if that is the bound."""
    max: Bound = None
    """Largest value, likewise."""
    values: tuple[int, ...] | None = None
    """The only values, where a range does not say it."""
    unit: str = ""
    """What one count is."""

    def __post_init__(self) -> None:
        """Validate."""
        where = f"register {self.name}"
        if self.length not in (1, 2, 4) or not 0 <= self.address <= 1023:
            raise SpecError(f"{self.length} bytes at {self.address}", where=where)
        if self.access not in ("r", "rw") or self.area not in ("eeprom", "ram"):
            raise SpecError(f"access {self.access!r}, area {self.area!r}", where=where)

    @property
    def end(self) -> int:
        """First byte after it."""
        return self.address + self.length

    def encode(self, value: int) -> bytes:
        """Return the bytes of a value.

        Raises:
            OverflowError: The value does not fit into the bytes.
        """
        return int(value).to_bytes(self.length, "little", signed=self.signed)

    def decode(self, data: bytes | bytearray | memoryview) -> int:
        """Return the value of the bytes.

        Raises:
            ValueError: Not exactly :attr:`length` bytes.
        """
        if len(data) != self.length:
            raise ValueError(f"{self.name} has {self.length} bytes, not {len(data)}")
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True, slots=True)
class IndirectBlock:
    """Pointers through which scattered registers can be reached in one piece."""

    address: int
    """First of the two-byte pointers."""
    data: int
    """First of the bytes they make appear."""
    count: int
    """How many."""
    min: int = 64
    """Smallest address they may point to."""
    max: int = 661
    """Largest address they may point to."""
    area: Area = "ram"
    """Where the pointers live."""


@dataclass(frozen=True, slots=True)
class Units:
    """What one count of a register stands for.

    Raises:
        SpecError: A unit is not positive.
    """

    position: float
    """rad of the horn."""
    center: int
    """Count of the horn's angle 0."""
    multi_turn: tuple[int, int]
    """Lowest and highest goal position of the modes that turn more than once, counts."""
    velocity: float
    """rad/s."""
    acceleration: float
    """rad/s^2."""
    pwm: int
    """Count that means 100 % duty."""
    p_divisor: float
    """Divides the position P gain, from position counts to PWM counts."""
    i_divisor: float
    """Divides the position I gain, likewise, for a sum over periods of 1 ms."""

    def __post_init__(self) -> None:
        """Validate."""
        for name in ("position", "velocity", "acceleration", "pwm", "p_divisor", "i_divisor"):
            if not getattr(self, name) > 0:
                raise SpecError(f"{name} {getattr(self, name)}", where="units", allowed="above 0")

    @property
    def ticks_per_turn(self) -> float:
        """Position counts per revolution."""
        return 2 * math.pi / self.position


@dataclass(frozen=True, slots=True, eq=False)
class ControlTable:
    """The registers of one servo model and the electrical facts that its registers depend on."""

    name: str
    """The maker's name, for example ``XM430-W350``."""
    number: int
    """Model number: register 0, and the answer to a ping."""
    registers: Mapping[str, Register]
    """By name."""
    indirect: tuple[IndirectBlock, ...]
    """Blocks of indirect addressing."""
    units: Units
    """What counts stand for."""
    bauds: Mapping[int, int]
    """bit/s by value of the Baud Rate register."""
    errors: Mapping[int, str]
    """Bits of Hardware Error Status (Protocol 1.0: of the error byte) and Shutdown."""
    since: Mapping[str, int]
    """First firmware that has a register or a feature, where it was not there from the start."""
    no_load_speed: float
    """rad/s at :attr:`voltage`."""
    voltage: float
    """V, nominal."""
    stall_current: float
    """A at :attr:`voltage`."""
    current_unit: float | None
    """A per count of the current registers; ``None`` if the model measures no current."""
    firmware: int
    """Firmware version that the table describes."""
    protocol: int = 2
    """Protocol that it speaks as it leaves the factory: 1 or 2."""
    spans: tuple[Register, ...] = field(default=())
    """The registers ordered by address."""

    def __post_init__(self) -> None:
        """Order, and refuse overlaps."""
        ordered = sorted(self.registers.values(), key=lambda register: register.address)
        for before, after in itertools.pairwise(ordered):
            if after.address < before.end:
                raise SpecError(f"{after.name} overlaps {before.name}", where=self.name)
        object.__setattr__(self, "spans", tuple(ordered))

    def __getitem__(self, name: str) -> Register:
        """Return a register by name.

        Raises:
            SpecError: This model has no such register.
        """
        try:
            return self.registers[name]
        except KeyError:
            raise SpecError(
                f"{self.name} has no register '{name}'", hint=nearest(name, self.registers)
            ) from None

    def __contains__(self, name: str) -> bool:
        """Whether this model has the register."""
        return name in self.registers

    def has(self, feature: str, firmware: int) -> bool:
        """Whether a firmware has a feature that came with some firmware, or never."""
        first = self.since.get(feature)
        return first is not None and firmware >= first

    def lowest(self, name: str) -> int:
        """Return the smallest value that a register with a fixed range takes."""
        bound = self[name].min
        return bound if isinstance(bound, int) else 0

    def highest(self, name: str) -> int:
        """Return the largest value that a register with a fixed range takes."""
        bound = self[name].max
        return bound if isinstance(bound, int) else 256 ** self[name].length - 1

    @property
    def fast_read_firmware(self) -> int | None:
        """First firmware that takes part in a Fast Sync Read; ``None`` if none does."""
        return self.since.get("fast_read")

    def error_bit(self, meaning: str) -> int | None:
        """Return the bit of Hardware Error Status with a meaning; ``None`` if there is none."""
        return next((bit for bit, name in self.errors.items() if name == meaning), None)
