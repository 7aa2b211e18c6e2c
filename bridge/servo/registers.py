"""Control tables of the servos, and the only place where ticks exist.

**The problem.** A servo is a table of bytes: addresses with a length, a sign, a range, a unit and
rules about who may write what and when. The tables differ between models in a few lines. They are
data (``bridge/servo/models/*.toml``: one base table, and per family what differs); this module
reads them and converts between register values and SI units. Everything outside works in rad,
rad/s, A, V and degC.

Worked example, an XM430-W350 with ``zero`` 2048, ``direction`` -1, ``ratio`` 1::

    goal 0.5 rad  ->  2048 - 0.5 * 4096 / (2 pi) = 1722.05  ->  1722 ticks
    1722 ticks    ->  -(1722 - 2048) * 2 pi / 4096 = 0.50007 rad

Radian to tick rounds half to even, so that no direction is favoured.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robots.errors import SpecError, nearest
from robots.skeleton import FloatArray

TICKS_PER_TURN = 4096
"""Position counts per revolution of the X series: 0.087890625 degrees each."""

POSITION_UNIT = 2 * math.pi / TICKS_PER_TURN
"""rad of the servo's horn per tick."""
RPM = 2 * math.pi / 60
VELOCITY_UNIT = 0.229 * RPM
"""rad/s per count of every velocity register (0.229 rpm)."""
ACCELERATION_UNIT = 214.577 * RPM / 60
"""rad/s^2 per count of Profile Acceleration (214.577 rev/min^2)."""
WATCHDOG_UNIT = 0.020
"""s per count of Bus Watchdog."""
RETURN_DELAY_UNIT = 2e-6
"""s per count of Return Delay Time."""
VOLTAGE_UNIT = 0.1
"""V per count."""
PWM_FULL = 885
"""Count of PWM Limit that means 100 % duty."""

BAUD_RATES = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""bit/s by value of the Baud Rate register."""

MODE_CURRENT, MODE_VELOCITY, MODE_POSITION = 0, 1, 3
MODE_EXTENDED_POSITION, MODE_CURRENT_POSITION, MODE_PWM = 4, 5, 16
OPERATING_MODES = {
    "current": MODE_CURRENT,
    "velocity": MODE_VELOCITY,
    "position": MODE_POSITION,
    "extended_position": MODE_EXTENDED_POSITION,
    "current_based_position": MODE_CURRENT_POSITION,
    "pwm": MODE_PWM,
}
"""Values of Operating Mode by the names a robot's file uses."""

EXTENDED_RANGE = 1_048_575
"""Largest goal position, in ticks either way, of the modes that turn more than once."""

HARDWARE_ERRORS = {
    0: "input voltage",
    2: "overheating",
    3: "encoder",
    4: "electrical shock",
    5: "overload",
}
"""Meaning of the bits of Hardware Error Status and Shutdown."""

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
    fast_read_firmware: int | None = None
    """First firmware that takes part in a Fast Sync Read; ``None`` if none does."""
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


@cache
def _tables() -> dict[str, ControlTable]:
    folder = resources.files("bridge.servo") / "models"
    families = {
        file.name.removesuffix(".toml"): tomllib.loads(file.read_text("utf-8"))
        for file in sorted(folder.iterdir(), key=lambda file: file.name)
        if file.name.endswith(".toml")
    }
    tables: dict[str, ControlTable] = {}
    for family in families:
        registers, indirect = _family(family, families)
        for name, model in families[family].get("models", {}).items():
            tables[name] = _table(name, model, registers, indirect)
    return tables


def _family(name: str, families: Mapping[str, Any]) -> tuple[dict[str, dict], list[dict]]:
    """Return the raw register rows and indirect blocks of a family, its base included."""
    data = families[name]
    registers: dict[str, dict] = {}
    indirect: list[dict] = []
    if "base" in data:
        base, indirect = _family(data["base"], families)
        registers = {key: dict(row) for key, row in base.items()}
    _amend(registers, data)
    return registers, data.get("indirect", indirect)


def _amend(registers: dict[str, dict], data: Mapping[str, Any]) -> None:
    for key in data.get("remove", ()):
        del registers[key]
    for key, row in data.get("registers", {}).items():
        registers[key] = dict(row)
    for key, row in data.get("overrides", {}).items():
        registers[key] = {**registers[key], **row}


def _table(
    name: str, model: Mapping[str, Any], family: Mapping[str, dict], indirect: list[dict]
) -> ControlTable:
    rows = {key: dict(row) for key, row in family.items()}
    _amend(rows, model)
    for row in rows.values():
        if "values" in row:
            row["values"] = tuple(row["values"])
    return ControlTable(
        name=name,
        number=model["number"],
        registers={key: Register(key, **row) for key, row in rows.items()},
        indirect=tuple(IndirectBlock(**block) for block in indirect),
        no_load_speed=model["no_load_rpm"] * RPM,
        voltage=model["voltage"],
        stall_current=model["stall_current"],
        current_unit=model.get("current_unit"),
        firmware=model["firmware"],
        fast_read_firmware=model.get("fast_read_firmware"),
    )


def model_names() -> tuple[str, ...]:
    """Return the names of all servo models with a control table."""
    return tuple(sorted(_tables()))


def control_table(model: str) -> ControlTable:
    """Return the control table of a model by the maker's name.

    Raises:
        SpecError: No table is known for it.
    """
    tables = _tables()
    try:
        return tables[model]
    except KeyError:
        raise SpecError(
            f"no control table for servo model '{model}'",
            allowed=", ".join(sorted(tables)),
            hint=nearest(model, tables),
        ) from None


def model_name(number: int) -> str:
    """Return the maker's name of a model number, or ``model <number>`` if it is not known."""
    for table in _tables().values():
        if table.number == number:
            return table.name
    return f"model {number}"


@dataclass(frozen=True, slots=True)
class TickScale:
    """How the ticks of some servos relate to the angles of their joints (arrays of one length).

    ``tick = zero + direction * ratio * angle * 4096 / 2 pi``.
    """

    zero: NDArray[np.int64]
    """``[D]`` tick at joint angle 0."""
    factor: FloatArray
    """``[D]`` ticks per rad of the joint, signed."""

    @classmethod
    def of(cls, zero: ArrayLike, direction: ArrayLike, ratio: ArrayLike) -> TickScale:
        """Return the scale of servos with these ``[D]`` zeros, directions (+-1) and ratios."""
        factor = np.asarray(direction, float) * np.asarray(ratio, float)
        return cls(
            np.atleast_1d(np.asarray(zero, np.int64)),
            np.atleast_1d(factor * TICKS_PER_TURN / (2 * math.pi)),
        )

    def to_ticks(self, position: ArrayLike) -> NDArray[np.int64]:
        """Return ticks ``[..., D]`` for joint angles rad; halves round to even.

        Raises:
            ValueError: An angle is not finite.
        """
        ticks = self.zero + np.asarray(position, float) * self.factor
        if not np.isfinite(ticks).all():
            raise ValueError("a joint angle is not finite")
        return np.rint(ticks).astype(np.int64)

    def from_ticks(self, ticks: ArrayLike) -> FloatArray:
        """Return joint angles ``[..., D]`` rad for ticks."""
        return (np.asarray(ticks, float) - self.zero) / self.factor

    def velocity(self, counts: ArrayLike) -> FloatArray:
        """Return joint velocities ``[..., D]`` rad/s for counts of a velocity register."""
        return np.asarray(counts, float) * self.velocity_scale

    @property
    def velocity_scale(self) -> FloatArray:
        """``[D]`` rad/s of the joint per count of a velocity register, signed."""
        return VELOCITY_UNIT * TICKS_PER_TURN / (2 * math.pi) / self.factor

    @property
    def resolution(self) -> FloatArray:
        """``[D]`` rad of the joint per tick."""
        return 1 / np.abs(self.factor)


def describe_model(number: int) -> str:
    """Return a model number with its name, for messages."""
    return f"{model_name(number)} ({number})"


def velocity_counts(velocity: float) -> int:
    """Return the velocity count (at least 1: 0 would mean unlimited) for a servo's rad/s."""
    return max(1, round(velocity / VELOCITY_UNIT))


def hardware_error_names(status: int) -> tuple[str, ...]:
    """Return the names of the bits set in Hardware Error Status."""
    return tuple(HARDWARE_ERRORS.get(bit, f"bit {bit}") for bit in range(8) if status & (1 << bit))
