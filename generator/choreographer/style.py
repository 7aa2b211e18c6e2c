"""How an interaction is performed, as a few numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal

from robots.errors import SpecError

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
FACING: tuple[tuple[Side, Side], ...] = (("left", "right"), ("right", "left"))
"""Hands that lie opposite each other when two people face each other."""

_RANGES = {
    "speed": (0.6, 1.4),
    "energy": (0.5, 1.5),
    "amplitude": (0.5, 1.5),
    "distance": (0.7, 1.4),
    "lag": (0.0, 0.6),
}


@dataclass(frozen=True, slots=True)
class Style:
    """The manner of a performance; 1 is the ordinary one.

    Raises:
        SpecError: A number lies outside its range.
    """

    speed: float = 1.0
    """Tempo, 0.6 to 1.4: durations are divided by it."""
    energy: float = 1.0
    """Vigour, 0.5 to 1.5: height of steps, arm swing, depth of reactions, strength of rhythm."""
    amplitude: float = 1.0
    """Size of gestures, 0.5 to 1.5."""
    distance: float = 1.0
    """Room between the two, 0.7 to 1.4; where hands meet, only as far as arms allow."""
    handedness: Side = "right"
    """The hand that leads; ``left`` plays the whole scene as in a mirror."""
    swap: bool = False
    """Whether person b takes the first (leading) role instead of person a."""
    lag: float = 0.0
    """Extra delay of the second role where it answers the first, 0 to 0.6 s."""

    def __post_init__(self) -> None:
        """Validate."""
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise SpecError(f"{value} is out of range", where=name, allowed=f"{low} to {high}")
        if self.handedness not in ("left", "right"):
            raise SpecError(
                f"'{self.handedness}' is no hand", where="handedness", allowed="left, right"
            )


def style_ranges() -> dict[str, tuple[float, float]]:
    """Return the range of each numeric field of :class:`Style`."""
    return {field.name: _RANGES[field.name] for field in fields(Style) if field.name in _RANGES}
