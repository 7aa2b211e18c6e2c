"""Control tables of the servos by model, and the only place where ticks exist.

**The problem.** A servo is a table of bytes: addresses with a length, a sign, a range, a unit and
rules about who may write what and when. The tables differ between models in a few lines. They are
data (``bridge/servo/models/*.toml``: base tables, and per family what differs); this module
reads them and converts between register values and SI units. Everything outside works in rad,
rad/s, A, V and degC.

Worked example, an XM430-W350 with ``zero`` 2048, ``direction`` -1, ``ratio`` 1::

    goal 0.5 rad  ->  2048 - 0.5 * 4096 / (2 pi) = 1722.05  ->  1722 ticks
    1722 ticks    ->  -(1722 - 2048) * 2 pi / 4096 = 0.50007 rad

Radian to tick rounds half to even, so that no direction is favoured.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.servo.table import ControlTable as ControlTable
from bridge.servo.table import IndirectBlock, Units
from bridge.servo.table import Register as Register
from robots.errors import SpecError, nearest
from robots.skeleton import FloatArray
from robots.spec import ServoSpec

RPM = 2 * math.pi / 60
"""One revolution per minute, rad/s."""
WATCHDOG_UNIT = 0.020
"""s per count of Bus Watchdog."""
RETURN_DELAY_UNIT = 2e-6
"""s per count of Return Delay Time."""
VOLTAGE_UNIT = 0.1
"""V per count."""

BAUD_RATES = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""bit/s of the Protocol 2.0 servos by value of their Baud Rate register."""

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

HARDWARE_ERRORS = {
    0: "input voltage",
    1: "motor hall sensor",
    2: "overheating",
    3: "encoder",
    4: "electrical shock",
    5: "overload",
}
"""Meaning of the bits of Hardware Error Status and Shutdown of the X and P series."""


_WHOLE = ("indirect", "bauds", "errors", "protocol")
"""Parts of a table that a family or model replaces as a whole."""


@cache
def _tables() -> dict[str, ControlTable]:
    folder = resources.files("bridge.servo") / "models"
    families = {
        file.name.removesuffix(".toml"): tomllib.loads(file.read_text("utf-8"))
        for file in sorted(folder.iterdir(), key=lambda file: file.name)
        if file.name.endswith(".toml")
    }
    return {
        name: _table(name, model, _family(family, families))
        for family in families
        for name, model in families[family].get("models", {}).items()
    }


def _family(name: str, families: Mapping[str, Any]) -> dict[str, Any]:
    """Return the raw tables of a family, its base included."""
    data = families[name]
    base = _family(data["base"], families) if "base" in data else {"registers": {}}
    return _amended(base, data)


def _amended(base: Mapping[str, Any], data: Mapping[str, Any]) -> dict[str, Any]:
    """Return raw tables with what a family or model says differently."""
    registers = {key: dict(row) for key, row in base["registers"].items()}
    for key in data.get("remove", ()):
        del registers[key]
    for key, row in data.get("registers", {}).items():
        registers[key] = dict(row)
    for key, row in data.get("overrides", {}).items():
        registers[key] = {**registers[key], **row}
    merged = {key: {**base.get(key, {}), **data.get(key, {})} for key in ("units", "since")}
    for key in data.get("lacks", ()):
        del merged["since"][key]
    whole = {key: data.get(key, base.get(key)) for key in _WHOLE}
    return {"registers": registers, **merged, **whole}


def _table(name: str, model: Mapping[str, Any], family: Mapping[str, Any]) -> ControlTable:
    raw = _amended(family, model)
    for row in raw["registers"].values():
        if "values" in row:
            row["values"] = tuple(row["values"])
    return ControlTable(
        name=name,
        number=model["number"],
        registers={key: Register(key, **row) for key, row in raw["registers"].items()},
        indirect=tuple(IndirectBlock(**block) for block in raw["indirect"] or ()),
        units=_units(raw["units"]),
        bauds={int(key): rate for key, rate in raw["bauds"].items()},
        errors={int(key): text for key, text in raw["errors"].items()},
        since=raw["since"],
        no_load_speed=model["no_load_rpm"] * RPM,
        voltage=model["voltage"],
        stall_current=model["stall_current"],
        current_unit=model.get("current_unit"),
        firmware=model["firmware"],
        protocol=raw["protocol"] or 2,
    )


def _units(raw: Mapping[str, Any]) -> Units:
    """Return units in SI; the files have the maker's, named by their keys."""
    low, high = raw["multi_turn"]
    return Units(
        position=2 * math.pi / raw["ticks_per_turn"],
        center=raw["center"],
        multi_turn=(low, high),
        velocity=raw["velocity_rpm"] * RPM,
        acceleration=raw["acceleration_rpm_per_min"] * RPM / 60,
        pwm=raw["pwm"],
        p_divisor=raw["p_divisor"],
        i_divisor=raw["i_divisor"],
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

    ``tick = zero + direction * ratio * angle * ticks per turn / 2 pi``.
    """

    zero: NDArray[np.int64]
    """``[D]`` tick at joint angle 0."""
    factor: FloatArray
    """``[D]`` ticks per rad of the joint, signed."""
    velocity_scale: FloatArray
    """``[D]`` rad/s of the joint per count of a velocity register, signed."""

    @classmethod
    def of(
        cls,
        zero: ArrayLike,
        direction: ArrayLike,
        ratio: ArrayLike,
        tables: Sequence[ControlTable],
    ) -> TickScale:
        """Return the scale of servos with these ``[D]`` zeros, directions (+-1), ratios, tables."""
        gear = np.atleast_1d(np.asarray(direction, float) * np.asarray(ratio, float))
        return cls(
            np.atleast_1d(np.asarray(zero, np.int64)),
            gear / [table.units.position for table in tables],
            np.array([table.units.velocity for table in tables]) / gear,
        )

    @classmethod
    def of_servos(cls, servos: Sequence[ServoSpec]) -> TickScale:
        """Return the scale of the servos of some joints."""
        return cls.of(
            [servo.zero for servo in servos],
            [servo.direction for servo in servos],
            [servo.ratio for servo in servos],
            [control_table(servo.model) for servo in servos],
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
    def resolution(self) -> FloatArray:
        """``[D]`` rad of the joint per tick."""
        return 1 / np.abs(self.factor)


def describe_model(number: int) -> str:
    """Return a model number with its name, for messages."""
    return f"{model_name(number)} ({number})"


def velocity_counts(velocity: float, table: ControlTable) -> int:
    """Return the velocity count (at least 1: 0 would mean unlimited) for a servo's rad/s."""
    return max(1, round(velocity / table.units.velocity))


def hardware_error_names(
    status: int, errors: Mapping[int, str] = HARDWARE_ERRORS
) -> tuple[str, ...]:
    """Return the names of the bits set in Hardware Error Status."""
    return tuple(errors.get(bit, f"bit {bit}") for bit in range(8) if status & (1 << bit))
