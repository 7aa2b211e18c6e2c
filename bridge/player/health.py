"""How servos fare, by their own limits: when to say so, when to slow down, when to stop.

**The problem.** A servo that trips lets its limb drop in the middle of the dance. Heat, a weak
supply and a steady load announce themselves earlier, so each is judged at three levels: a warning,
half the speed for both robots, and a stop along the path while there is still torque to hold with.
Temperature and voltage are compared with the limits stored in the servo itself, because that is
where it trips. Its sensor lies away from the winding, so the current is judged too: its mean over
:data:`LOAD_TIME` as a share of stall current.

Margins follow common practice (pypot's and ROBOTIS' advice): 15, 10 and 5 degC below the limit;
10, 5 and 0 % above the lowest voltage.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from bridge.servo.bus import ServoBus
from bridge.servo.registers import VOLTAGE_UNIT
from robots.skeleton import FloatArray

HEAT_MARGINS = (15.0, 10.0, 5.0)
"""degC below the limit at which a servo is warm, hot, too hot."""
VOLTAGE_MARGINS = (1.10, 1.05, 1.0)
"""Shares of the lowest voltage below which it is low, very low, too low."""
LOADS = (0.5, 0.65, 0.8)
"""Mean shares of stall current that are much, very much, too much."""
LOAD_TIME = 2.0
"""Time constant of the mean, s."""
DERATE = 0.5
"""Share of the speed at which both go on."""


class Level(IntEnum):
    """What a value calls for."""

    FINE = 0
    WARN = 1
    DERATE = 2
    STOP = 3


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about a servo that is worth saying."""

    level: Level
    joint: str
    what: str


class Health:
    """Judges the servos of one bus by the limits they carry."""

    def __init__(self, bus: ServoBus) -> None:
        """Read the limits; the bus must be open.

        Raises:
            BusError: A servo does not say.
        """
        count = range(len(bus.ids))
        read = bus.registers.read
        self._joints = bus.joint_names
        self._hottest = {bus.joint_names[i]: read(i, "temperature_limit") for i in count}
        self._lowest = {
            bus.joint_names[i]: read(i, "min_voltage_limit") * VOLTAGE_UNIT for i in count
        }
        self._stall = np.array([table.stall_current for table in bus.tables])
        self._load = np.zeros(len(bus.ids))
        self._said: dict[tuple[str, str], Level] = {}

    def look(self, register: str, values: dict[str, float]) -> list[Finding]:
        """Judge temperatures (degC) or voltages (V) by joint name; other registers pass."""
        found: list[Finding] = []
        for joint, value in values.items():
            if register == "present_temperature":
                limit = self._hottest[joint]
                level = sum(value >= limit - margin for margin in HEAT_MARGINS)
                text = f"is {value:.0f} degC warm; it switches off at {limit:.0f}"
            elif register == "present_input_voltage":
                limit = self._lowest[joint]
                level = sum(value < limit * margin for margin in VOLTAGE_MARGINS)
                text = f"gets {value:.1f} V; it needs {limit:.1f}"
            else:
                return []
            found += self._news(register, Level(level), joint, text)
        return found

    def feel(self, current: FloatArray, elapsed: float) -> list[Finding]:
        """Take currents ``[D]`` A, NaN where not measured, after s; judge their mean."""
        share = np.abs(current) / self._stall
        known = np.isfinite(share)
        weight = min(elapsed / LOAD_TIME, 1.0)
        self._load[known] += weight * (share[known] - self._load[known])
        found: list[Finding] = []
        for index in np.flatnonzero(self._load >= LOADS[0]):
            load = float(self._load[index])
            level = sum(load >= bound for bound in LOADS)
            text = f"has worked at {100 * load:.0f} % of its stall current"
            found += self._news("load", Level(level), self._joints[index], text)
        return found

    def _news(self, kind: str, level: Level, joint: str, what: str) -> list[Finding]:
        """Return a finding if it is worse than what has been said."""
        if level <= self._said.get((kind, joint), Level.FINE):
            return []
        self._said[kind, joint] = level
        return [Finding(level, joint, what)]
