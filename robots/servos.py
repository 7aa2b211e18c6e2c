"""What servo models can do: resolution, speed and torque, by the maker's name.

Sources: ROBOTIS e-manual, "Specifications" of each model, at the voltage named there. Registers and
packets are no concern of this table; they live with the bus.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from robots.errors import SpecError, nearest

RPM = 2 * math.pi / 60
"""One revolution per minute, rad/s."""


@dataclass(frozen=True, slots=True)
class ServoModel:
    """The mechanical side of a servo."""

    name: str
    """The maker's name, as in the control tables."""
    ticks: int
    """Position counts per revolution."""
    no_load_speed: float
    """rad/s at the nominal voltage."""
    stall_torque: float
    """N m at the nominal voltage."""
    mass: float
    """kg."""
    first: int = 0
    """Smallest goal of position mode; the largest is :attr:`last`, one turn above."""

    @property
    def last(self) -> int:
        """Largest goal of position mode."""
        return self.first + self.ticks - 1


_ROWS = (
    # model, ticks/rev, no-load rpm, stall N m, kg: nominal voltage
    ("XL330-M077", 4096, 383, 0.215, 0.018),  # 5.0 V
    ("XL330-M288", 4096, 103, 0.52, 0.018),  # 5.0 V
    ("XC330-M181", 4096, 129, 0.60, 0.023),  # 5.0 V
    ("XC330-M288", 4096, 81, 0.93, 0.023),  # 5.0 V
    ("XC330-T181", 4096, 114, 0.76, 0.023),  # 12 V
    ("XC330-T288", 4096, 71, 0.92, 0.023),  # 12 V
    ("XL430-W250", 4096, 61, 1.5, 0.0572),  # 12 V
    ("XC430-W150", 4096, 106, 1.6, 0.065),  # 12 V
    ("XC430-W240", 4096, 70, 1.9, 0.065),  # 12 V
    ("XM430-W210", 4096, 77, 3.0, 0.082),  # 12 V
    ("XM430-W350", 4096, 46, 4.1, 0.082),  # 12 V
    ("XH430-W210", 4096, 50, 2.5, 0.082),  # 12 V
    ("XH430-W350", 4096, 30, 3.4, 0.082),  # 12 V
    ("XM540-W150", 4096, 53, 7.3, 0.165),  # 12 V
    ("XM540-W270", 4096, 30, 10.6, 0.165),  # 12 V
    ("MX-28", 4096, 55, 2.5, 0.077),  # 12 V
    ("MX-64", 4096, 63, 6.0, 0.135),  # 12 V
    ("MX-106", 4096, 45, 8.4, 0.165),  # 12 V
)
_ROWS_AROUND_ZERO = (
    # The P series at 24 V counts from the middle of its turn. Its maker gives no stall torque: this
    # is the continuous one.
    ("PH42-020-S300", 607500, 32.7, 5.1, 0.340),
    ("PH54-100-S500", 1003846, 33.3, 25.3, 0.740),
    ("PH54-200-S500", 1003846, 33.1, 44.7, 0.855),
    ("PM42-010-S260", 526374, 28.0, 1.7, 0.270),
    ("PM54-040-S250", 502834, 28.4, 3.9, 0.710),
    ("PM54-060-S250", 502834, 33.1, 10.1, 0.855),
)

SERVO_MODELS: dict[str, ServoModel] = {
    name: ServoModel(name, ticks, rpm * RPM, torque, mass)
    for name, ticks, rpm, torque, mass in _ROWS
} | {
    name: ServoModel(name, ticks, rpm * RPM, torque, mass, -(ticks // 2))
    for name, ticks, rpm, torque, mass in _ROWS_AROUND_ZERO
}
"""Servo models by name."""


def servo_model(name: str, *, where: str = "") -> ServoModel:
    """Return a servo model by the maker's name.

    Raises:
        SpecError: The model is not known.
    """
    try:
        return SERVO_MODELS[name]
    except KeyError:
        raise SpecError(
            f"unknown servo model '{name}'",
            where=where,
            allowed=", ".join(SERVO_MODELS),
            hint=nearest(name, SERVO_MODELS),
        ) from None
