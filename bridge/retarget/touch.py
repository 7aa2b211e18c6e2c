"""Touches between two people, and what they ask of two robots.

The motion may label its touches; where it does not, hands that come near each other are taken to
touch, with hysteresis, so that a handshake is one window and not twenty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.motion import Contact, DuetMotion
from robots.skeleton import FloatArray
from robots.spec import RobotSpec

NEAR = 0.10
"""Hands (middle knuckles) closer than this begin to touch, m."""
APART = 0.13
"""Hands that touch stay in touch up to this distance, m."""
SHORTEST = 0.1
"""Touches shorter than this are passing by, s."""
EASE = 0.35
"""Time over which a touch pulls the hands together before, and lets go after, s."""

_LANDMARK = {
    "left_wrist": "left_hand",
    "right_wrist": "right_hand",
    **dict.fromkeys(("spine1", "spine2", "spine3", "neck", "left_collar", "right_collar"), "chest"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """A touch as two robots should do it."""

    a: str
    """Landmark of robot a."""
    b: str
    """Landmark of robot b."""
    active: NDArray[np.bool_]
    """``[T]``, when they touch."""
    weight: FloatArray
    """``[T]`` 0 to 1: eases in before and out after."""
    gap: float
    """Intended distance between the two landmarks, m."""

    @property
    def of_hands(self) -> bool:
        """Whether both points are hands, which can go anywhere; chests cannot."""
        return self.a.endswith("_hand") and self.b.endswith("_hand")


def touches(
    motion: DuetMotion, robots: tuple[RobotSpec, RobotSpec], arm_scale: float
) -> list[Touch]:
    """Return the touches of a motion, for robots whose arms are scaled by ``arm_scale``."""
    out = []
    for contact in motion.contacts or _near_hands(motion):
        names = [_LANDMARK.get(point, point) for point in (contact.a, contact.b)]
        if any(name not in robot.landmarks for name, robot in zip(names, robots, strict=True)):
            continue
        radii = sum(r.landmarks[n].radius for n, r in zip(names, robots, strict=True))
        times = motion.a.times
        active = (times >= contact.start - 1e-9) & (times <= contact.end + 1e-9)
        early = (times - contact.start + EASE) / EASE
        late = (contact.end + EASE - times) / EASE
        u = np.clip(np.minimum(early, late), 0.0, 1.0)
        gap = max(radii, arm_scale * contact.gap)
        out.append(Touch(names[0], names[1], active, u * u * u * (10 - 15 * u + 6 * u * u), gap))
    return out


def _near_hands(motion: DuetMotion) -> list[Contact]:
    """Return windows in which a hand of a is near a hand of b."""
    found = []
    for a in ("left_hand", "right_hand"):
        for b in ("left_hand", "right_hand"):
            distance = motion.gap(Contact(a, b, 0.0, 0.0))
            for start, end in _windows(distance):
                if (end - start) / motion.fps >= SHORTEST:
                    gap = float(np.median(distance[start : end + 1]))
                    found.append(Contact(a, b, start / motion.fps, end / motion.fps, gap))
    return found


def _windows(distance: NDArray) -> list[tuple[int, int]]:
    """Return first and last frame of every touch, with hysteresis."""
    windows: list[tuple[int, int]] = []
    start = None
    last = 0
    for t, d in enumerate(distance):
        if d < NEAR:
            start, last = (t if start is None else start), t
        elif d > APART and start is not None:
            windows.append((start, last))
            start = None
    if start is not None:
        windows.append((start, last))
    return windows
