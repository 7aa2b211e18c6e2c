"""How to play: times, tolerances and bounds of a performance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from robots.errors import SpecError, nearest

End = Literal["rest", "hold"]
"""Where robots end after the dance, before they relax: in their rest pose, or in its last one."""
ENDS: tuple[End, ...] = get_args(End)

DEFAULT_RATE = 60.0
"""Ticks per second that two cores keep up even with two virtual buses beside; twice the frame rate
of the motions."""


@dataclass(frozen=True, slots=True)
class PlayerSettings:
    """How to play.

    Raises:
        SpecError: A value is out of its range.
    """

    rate: float | None = None
    """Ticks per second; ``None`` for :data:`DEFAULT_RATE` or the slower robot's own cycle."""
    speed: float = 1.0
    """Speed of the dance; below 1 is slower."""
    ramp_time: float = 2.0
    """Shortest time to the first pose, s."""
    ramp_speed: float = 0.2
    """Share of a joint's no-load speed that the ramp may reach."""
    settle_time: float = 0.5
    """How long the last pose is held, s."""
    end: End = "rest"
    """Where the robots end: a raised arm that is let go of falls. After a stop they are always let
    go of where it left them: whoever stops a robot does not want it to move on."""
    stop_time: float = 0.5
    """Time in which a stop slows down, s."""
    hold_time: float = 0.5
    """How long the pose is held after a stop or a fault before torque goes off, s."""
    lost_reads: int = 3
    """How many answers of a servo in a row may be missing before both robots wait for it."""
    recover_time: float = 2.0
    """How long they wait for it or for a lost port, s; 0 for not at all."""
    recoveries: int = 3
    """How often in one performance."""
    soft_time: float = 1.0
    """Time in which servos get their strength after torque has come on, s."""
    soft_share: float = 0.2
    """Share of it that they begin with."""
    relax_time: float = 1.0
    """Time in which they lose it before torque goes off, s."""
    watchdog: float = 0.5
    """Silence after which servos stop by themselves, s; 0 for never."""
    max_stall: float = 0.4
    """How late a tick may be before the performance is given up, s."""
    start_tolerance: float = math.radians(5)
    """How far outside its limits a joint may stand at the start, rad."""
    acceleration_time: float = 0.1
    """In which a joint may be told to reach its no-load speed, s."""
    reach: float = 0.6
    """How far a goal that is sent may be from where the joint is, rad: more than the servos of the
    robots here need for their full torque, and less than :attr:`stray`."""
    dry_run: bool = False
    """Everything but torque, goals and settings: servos are looked at, nothing is written."""
    stray: float = 0.8
    """How far from its goal a joint may be, rad ..."""
    stray_time: float = 0.5
    """... and for how long, s."""
    health_period: float = 0.1
    """Time between two looks at the slow registers, s."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.end not in ENDS:
            raise SpecError(
                f"end '{self.end}'", allowed=", ".join(ENDS), hint=nearest(str(self.end), ENDS)
            )
        ranges = {
            "rate": (1, 1000),
            "speed": (0.01, 4),
            "ramp_time": (0.1, 60),
            "ramp_speed": (0.01, 1),
            "settle_time": (0, 60),
            "stop_time": (0.05, 10),
            "hold_time": (0, 60),
            "lost_reads": (0, 1000),
            "recover_time": (0, 600),
            "recoveries": (0, 1000),
            "soft_time": (0, 10),
            "soft_share": (0, 1),
            "relax_time": (0, 10),
            "acceleration_time": (0.01, 10),
            "reach": (0.05, 10),
            "watchdog": (0, 2.54),
            "max_stall": (0.02, 10),
            "start_tolerance": (0, 0.5),
            "stray": (0.05, 10),
            "stray_time": (0.05, 10),
            "health_period": (0.05, 60),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise SpecError(f"{name} is {value}", allowed=f"{low} to {high}")
