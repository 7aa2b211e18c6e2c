"""What one person does, before it becomes a body: a path, a posture and where the hands go."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.choreographer.style import Side
from robots.skeleton import FloatArray, Skeleton, human_skeleton

Anchor = Literal["self", "partner", "world"]


@dataclass(frozen=True, slots=True, eq=False)
class Build:
    """Measures of one person's body, taken from the skeleton once."""

    skeleton: Skeleton
    """Names and rest offsets."""
    scale: float
    """Size compared with the project's own human: mean ratio of leg and arm length."""
    leg: float
    """Thigh plus shank, m."""
    arm: float
    """Shoulder to middle knuckle, arm straight, m."""

    @classmethod
    def of(cls, skeleton: Skeleton) -> Build:
        """Return the measures of a skeleton."""
        leg, arm = _limbs(skeleton)
        own_leg, own_arm = _limbs(human_skeleton())
        return cls(skeleton, 0.5 * (leg / own_leg + arm / own_arm), leg, arm)

    def offset(self, name: str) -> FloatArray:
        """Return the rest offset ``[3]`` m of a keypoint from its parent."""
        return self.skeleton.offsets[self.skeleton.index(name)]


def _limbs(skeleton: Skeleton) -> tuple[float, float]:
    length = dict(zip(skeleton.names, skeleton.bone_lengths, strict=True))
    leg = length["left_knee"] + length["left_ankle"]
    arm = length["left_elbow"] + length["left_wrist"] * (1 + skeleton.hand_per_forearm)
    return leg, arm


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """A place that moves with a body, or stands in the world.

    ``offset`` is in the frame of the anchored keypoint (x forward, y left, z up) and in metres for
    a person of 1.70 m: it grows with the anchored person. In the world it is taken as it is.
    """

    anchor: Anchor
    """Whose frame."""
    offset: FloatArray
    """``[T, 3]`` or ``[3]`` m."""
    point: str = "spine3"
    """Keypoint of the trunk or head that carries the frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """A place between two shoulders at which two hands meet, as far from one arm as the other.

    Its axes: *along* runs level from the person in the first role to the other, *left* is the first
    person's left, *up* is up.
    """

    sides: tuple[Side, Side]
    """Hand of the first role, hand of the second."""
    height: float
    """Above the mean height of the shoulders, m for people of 1.70 m."""
    shift: FloatArray
    """``[T, 3]`` m along, left, up: how the place moves."""
    apart: FloatArray
    """``[3]`` m along, left, up, from the first hand to the second; its length is the gap."""
    still: tuple[float, float]
    """Window of the touch, s: the height is fixed from the shoulders of that time."""


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """A hand's way to a goal and back; later ones lie over earlier ones."""

    side: Side
    """Which hand."""
    goal: Spot | Meeting
    """Where the middle knuckle goes."""
    weight: FloatArray
    """``[T]`` in 0..1: how far it has left what lies below for this goal."""
    elbow: FloatArray
    """``[3]``, where the elbow points: forward, outward, up."""
    exact: tuple[float, float] | None = None
    """Window in which the goal must be met, s; the arm's length decides how near people stand."""


@dataclass(frozen=True, slots=True, eq=False)
class Footfall:
    """One step at a set time; the foot lands where it stands well then."""

    side: Side
    leave: float
    """Toe leaves the floor, s."""
    land: float
    """Foot stands again, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Kick:
    """A leg that leaves the floor, goes somewhere and comes back to where it stood."""

    side: Side
    moments: tuple[float, float, float, float]
    """Toe leaves, arrives, turns back, lands, s."""
    offset: FloatArray
    """``[3]`` m at 1.70 m, forward, outward, up: how far the toe goes."""
    tip: float = 0.0
    """Turning of the foot, toe down, rad; negative pulls the toe up."""


ELBOW_DOWN = (-0.3, 0.45, -1.0)
"""Ordinary direction of the elbow while the hand is in front of the body."""


@dataclass(slots=True, eq=False)
class Role:
    """One person's part while it is being written: tracks over time that interactions fill in."""

    build: Build
    times: FloatArray
    """``[T]`` s."""
    path: FloatArray = field(init=False)
    """``[T, 2]`` m, where the pelvis goes."""
    heading: FloatArray = field(init=False)
    """``[T]`` rad about z; 0 faces +x."""
    lean: FloatArray = field(init=False)
    """``[T]`` rad, bending of the trunk forward, pelvis to upper spine."""
    tilt: FloatArray = field(init=False)
    """``[T]`` rad, bending of the trunk to the right."""
    twist: FloatArray = field(init=False)
    """``[T]`` rad, turning of the upper spine against the pelvis, counterclockwise."""
    crouch: FloatArray = field(init=False)
    """``[T]`` m, how far the pelvis is lowered."""
    gaze: FloatArray = field(init=False)
    """``[T]`` in 0..1: 1 looks at the partner's head, 0 straight ahead."""
    nod: FloatArray = field(init=False)
    """``[T]`` rad, lowering of the head on top of the gaze."""
    shift: FloatArray = field(init=False)
    """``[T, 2]`` m at 1.70 m, forward and left: how far the pelvis leaves its path."""
    stance: float = 0.09
    """Half the distance between the feet, m for a person of 1.70 m."""
    arm_swing: float = 1.0
    """How much the hanging arms swing while walking."""
    first_step: Side = "left"
    """Foot that leaves first."""
    reaches: list[Reach] = field(default_factory=list)
    footing: dict[Side, FloatArray] = field(default_factory=dict)
    """``[T, 3]`` m, m, rad: forward, outward, turned outward from the ordinary stand."""
    heels: dict[Side, FloatArray] = field(default_factory=dict)
    """``[T]`` rad, how far a heel is up while the ball of the foot stands."""
    footfalls: list[Footfall] = field(default_factory=list)
    """Steps in the order of their times. If there are any, no others are taken."""
    kicks: list[Kick] = field(default_factory=list)
    """In the order of their times; no steps are planned while one goes on."""

    def __post_init__(self) -> None:
        """Start at rest at the origin."""
        count = len(self.times)
        self.path = np.zeros((count, 2))
        self.shift = np.zeros((count, 2))
        for name in ("heading", "lean", "tilt", "twist", "crouch", "nod"):
            setattr(self, name, np.zeros(count))
        self.gaze = np.ones(count)

    def reach(
        self,
        side: Side,
        goal: Spot | Meeting,
        weight: NDArray,
        *,
        elbow: ArrayLike = ELBOW_DOWN,
        exact: tuple[float, float] | None = None,
    ) -> None:
        """Send a hand to a goal."""
        pole = np.asarray(elbow, dtype=float)
        self.reaches.append(Reach(side, goal, np.asarray(weight, dtype=float), pole, exact))

    def gesture(
        self,
        side: Side,
        offset: ArrayLike,
        weight: NDArray,
        *,
        point: str = "spine3",
        elbow: ArrayLike = ELBOW_DOWN,
    ) -> None:
        """Send a hand to a place in front of the person's own body.

        Args:
            side: Which hand.
            offset: ``[3]`` or ``[T, 3]`` m: forward, *outward* (away from the body's middle), up.
            weight: ``[T]`` in 0..1.
            point: Own keypoint from which the offset counts.
            elbow: Where the elbow points: forward, outward, up.
        """
        away = np.asarray(offset, dtype=float) * (1.0, outward(side), 1.0)
        self.reach(side, Spot("self", away, point), weight, elbow=elbow)


def outward(side: Side) -> float:
    """Return +1 for the left side and -1 for the right: the sign of *outward* along y."""
    return 1.0 if side == "left" else -1.0
