"""Whether two bodies could dance a choreographed duet: reach, room, floor, speed, feet.

The style and the bodies may be drawn from their whole ranges, and not every combination goes well
with every interaction. These are the bounds beyond which a draw is thrown away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from generator.choreographer.clearance import ARMS, LEGS, TRUNK, clearances
from generator.choreographer.exchange import is_exchange
from generator.choreographer.interaction import lookup
from generator.choreographer.role import Build
from generator.motion import CONTACT_POINTS, DuetMotion, Motion
from robots.errors import MotionError
from robots.skeleton import FloatArray

REACH = 0.01
"""Largest error of a contact's gap, m."""
OVERLAP = 0.01
"""Deepest sinking of two bodies, m; an interaction that presses bodies together says its own."""
OWN_OVERLAP = 0.02
"""Deepest sinking of a forearm into the own trunk or legs, m."""
FLOOR = 0.01
"""Deepest keypoint below the floor, m."""
HAND_SPEED = 4.0
"""Fastest hand, m/s."""
ACCELERATION = 80.0
"""Greatest acceleration of a keypoint, m/s²."""
SKATE = 0.01
"""Fastest standing ankle or toe, m/s."""
LEAN = 0.26
"""Farthest that the trunk's middle is from that of standing feet, m for a person of 1.70 m."""


@dataclass(frozen=True, slots=True)
class Examination:
    """What was measured on a duet; each number is the worst over time and both people."""

    reach: float
    """Error of a contact's gap, m; 0 without contacts."""
    overlap: float
    """Sinking of the two bodies into each other, m; negative is room."""
    own_overlap: float
    """Sinking of a forearm into the own trunk or legs, m."""
    floor: float
    """Depth of a keypoint below the floor, m."""
    hand_speed: float
    """m/s."""
    acceleration: float
    """m/s²."""
    skate: float
    """Speed of a standing ankle or toe, m/s."""
    lean: float
    """Level distance of the trunk's middle from that of standing feet, m at 1.70 m."""
    allowed_overlap: float = OVERLAP
    """Sinking that the interaction allows, m."""

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the numbers that are out of bounds."""
        bounds = {
            "reach": REACH,
            "overlap": self.allowed_overlap,
            "own_overlap": OWN_OVERLAP,
            "floor": FLOOR,
            "hand_speed": HAND_SPEED,
            "acceleration": ACCELERATION,
            "skate": SKATE,
            "lean": LEAN,
        }
        return tuple(name for name, bound in bounds.items() if getattr(self, name) > bound)


def examine(duet: DuetMotion) -> Examination:
    """Return the worst of everything that a duet of the repertoire is judged by.

    Raises:
        MotionError: The duet has no labels of standing feet.
        PromptError: It is not of the repertoire.
    """
    people, name = duet.people, duet.interaction
    return Examination(
        reach=_reach(duet),
        overlap=_overlap(duet),
        own_overlap=max(_own_overlap(motion) for motion in people),
        floor=-min(float(motion.keypoints[..., 2].min()) for motion in people),
        hand_speed=max(_hand_speed(motion) for motion in people),
        acceleration=max(_acceleration(motion) for motion in people),
        skate=max(_skate(motion) for motion in people),
        lean=max(_lean(motion) for motion in people),
        allowed_overlap=OVERLAP if is_exchange(name) else lookup(name).overlap,
    )


def _reach(duet: DuetMotion) -> float:
    worst = 0.0
    for contact in duet.contacts:
        inside = (duet.a.times >= contact.start) & (duet.a.times <= contact.end)
        if not inside.any():
            return float("inf")
        worst = max(worst, float(np.abs(duet.gap(contact)[inside] - contact.gap).max()))
    return worst


def _body(motion: Motion, every: int = 2) -> tuple:
    return motion.skeleton, motion.keypoints[::every], Build.of(motion.skeleton).scale


def _overlap(duet: DuetMotion) -> float:
    gaps = clearances((_body(duet.a), _body(duet.b)))
    return -min(float(gap.min()) for gap in gaps.values())


def _own_overlap(motion: Motion) -> float:
    forearms = tuple(capsule for capsule in ARMS if "forearm" in capsule.name)
    others = {capsule.name for capsule in TRUNK + LEGS}
    body = _body(motion)
    gaps = clearances((body, body), forearms + TRUNK + LEGS)
    arms = {capsule.name for capsule in forearms}
    return -min(
        float(gap.min()) for (arm, part), gap in gaps.items() if arm in arms and part in others
    )


def _hand_speed(motion: Motion) -> float:
    return max(
        float(np.linalg.norm(np.diff(motion.point(hand), axis=0), axis=1).max() * motion.fps)
        for hand in ("left_hand", "right_hand")
    )


def _acceleration(motion: Motion) -> float:
    bend = np.diff(motion.keypoints, 2, axis=0) * motion.fps**2
    return float(np.linalg.norm(bend, axis=2).max())


def standing(motion: Motion) -> np.ndarray:
    """Return the labels ``[T, 4]`` of standing feet.

    Raises:
        MotionError: There are none.
    """
    if motion.foot_contacts is None:
        raise MotionError("the motion has no labels of standing feet")
    return motion.foot_contacts


def _skate(motion: Motion) -> float:
    down, worst = standing(motion), 0.0
    for column, point in enumerate(CONTACT_POINTS):
        stays = down[1:, column] & down[:-1, column]
        speed = np.linalg.norm(np.diff(motion.point(point), axis=0), axis=1) * motion.fps
        worst = max(worst, float(speed[stays].max(initial=0.0)))
    return worst


def _lean(motion: Motion) -> float:
    still = standing(motion).all(axis=1)
    away: FloatArray = np.linalg.norm(
        _middle(motion, ("pelvis", "spine2", "neck")) - _middle(motion, CONTACT_POINTS), axis=1
    )
    return float(away[still].max(initial=0.0)) / Build.of(motion.skeleton).scale


def _middle(motion: Motion, names: tuple[str, ...]) -> FloatArray:
    """Return the level middle ``[T, 2]`` m of some keypoints."""
    return motion.keypoints[:, [motion.skeleton.index(n) for n in names], :2].mean(axis=1)
