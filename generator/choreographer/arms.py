"""Where hands go, and arms that bring them there."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from generator.choreographer.frames import apply, pitch, roll, two_bones, unapply, yaw
from generator.choreographer.pose import Pose
from generator.choreographer.role import Build, Meeting, Reach, Spot, outward
from generator.choreographer.style import SIDES, Side
from generator.choreographer.trunk import hand_swing
from generator.kinematics import unit
from robots.skeleton import FloatArray

LONGEST = 0.93
"""Extension up to which a goal is met exactly, as a share of the straight arm."""
AT_EASE = 0.90
"""Extension beyond which a touch of the partner's body is moved nearer."""
SHORTEST = 0.32
"""Shortest distance from shoulder to knuckle, as a share of the straight arm."""
HANGING = 0.955
"""Extension of an arm at rest."""
ELBOW_BACK = (-1.0, 0.35, 0.0)
"""Where the elbow of a hanging arm points: forward, outward, up."""

Pair = tuple[Pose, Pose]


def pose_arms(pair: Pair) -> None:
    """Bring all four hands to their goals."""
    aims = [_aim(pair, index, side) for index, side in product((0, 1), SIDES)]
    # Only now: shoulders follow their hands, and goals hang on shoulders.
    for (index, side), aim in zip(product((0, 1), SIDES), aims, strict=True):
        _pose_arm(pair[index], side, *aim)


def goal_of(pair: Pair, index: int, reach: Reach) -> FloatArray:
    """Return the goal ``[T, 3]`` m of a reach of person ``index`` (0 first role, 1 second)."""
    goal = reach.goal
    if isinstance(goal, Meeting):
        return meeting_points(pair, goal)[index]
    if goal.anchor == "world":
        return np.broadcast_to(goal.offset, (len(pair[0].points), 3))
    owner = pair[index if goal.anchor == "self" else 1 - index]
    offset = goal.offset * owner.role.build.scale
    return owner.point(goal.point) + apply(_carrier(owner, goal.point), offset)


def meeting_points(pair: Pair, meeting: Meeting) -> tuple[FloatArray, FloatArray]:
    """Return the goals ``[T, 3]`` m of the first role's hand and the second's.

    The place divides the level distance between the two shoulders so that both arms are extended
    by the same share of their length: with ``s`` the first one's part, ``D`` the distance, ``c``
    the other components and ``k`` the squared ratio of arm lengths,

        (s D)^2 + c_1^2 = k ((1 - s)^2 D^2 + c_2^2).
    """
    first, second = pair
    builds = (first.role.build, second.role.build)
    times = first.role.times
    along = second.points[:, 0] - first.points[:, 0]
    along = unit(along * (1.0, 1.0, 0.0))
    left = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(times))])
    shoulders = [p.point(f"{s}_shoulder") for p, s in zip(pair, meeting.sides, strict=True)]
    still = (times >= meeting.still[0]) & (times <= meeting.still[1])
    tops = [float(shoulder[still, 2].mean()) for shoulder in shoulders]
    scale = 0.5 * (builds[0].scale + builds[1].scale)
    height = float(np.mean(tops)) + meeting.height * scale
    height = float(np.clip(height, *_level_reach(tops, builds)))

    def part(vector: NDArray, axis: NDArray) -> FloatArray:
        return np.einsum("ti,ti->t", vector, axis)

    base = part(shoulders[0], along)
    distance = np.maximum(part(shoulders[1], along) - base, 0.05)
    middle = 0.5 * (part(shoulders[0], left) + part(shoulders[1], left))
    across = [
        (part(shoulder, left) - middle) ** 2 + (shoulder[:, 2] - height) ** 2
        for shoulder in shoulders
    ]
    k = (builds[0].arm / builds[1].arm) ** 2
    linear = 2 * k * distance**2
    constant = across[0] - k * across[1] - k * distance**2
    root = np.sqrt(np.maximum(linear**2 - 4 * (1 - k) * distance**2 * constant, 0.0))
    share = np.clip(-2 * constant / (linear + root), 0.05, 0.95)
    axes = np.stack([along, left, np.broadcast_to((0.0, 0.0, 1.0), along.shape)], axis=-1)
    place = (
        along * (base + share * distance)[:, None]
        + left * middle[:, None]
        + np.array([0.0, 0.0, height])
        + apply(axes, meeting.shift * scale)
    )
    half = apply(axes, 0.5 * meeting.apart)
    return place - half, place + half


def _level_reach(tops: list[float], builds: tuple[Build, Build]) -> tuple[float, float]:
    """Return the lowest and the highest meeting that neither arm has to strain for, m."""
    low = max(top - 0.72 * build.arm for top, build in zip(tops, builds, strict=True))
    high = min(top + 0.55 * build.arm for top, build in zip(tops, builds, strict=True))
    middle = 0.5 * (low + high)
    return (low, high) if low <= high else (middle, middle)


def slide_into_reach(pair: Pair) -> None:
    """Move touches of the partner's body that are out of reach to where the arm reaches at ease.

    The hand keeps its distance from the touched keypoint, so the labelled gap stays: the offset
    turns towards the shoulder of the arm, no farther than needed. A short arm that does not get
    round to the back so comes to lie on the flank.
    """
    for index, pose in enumerate(pair):
        for order, reach in enumerate(pose.role.reaches):
            goal = reach.goal
            if reach.exact is None or not isinstance(goal, Spot) or goal.offset.ndim > 1:
                continue
            owner = pair[index if goal.anchor == "self" else 1 - index]
            to_shoulder = pose.point(f"{reach.side}_shoulder") - owner.point(goal.point)
            inside = _inside(pose, reach.exact)
            way = unapply(_carrier(owner, goal.point), to_shoulder)[inside].mean(axis=0)
            for share in np.linspace(0.0, 1.0, 21):
                turned = replace(goal, offset=_turned(goal.offset, way, float(share)))
                pose.role.reaches[order] = replace(reach, goal=turned)
                if _extension(pair, index, pose.role.reaches[order]) <= AT_EASE:
                    break


def _turned(vector: NDArray, toward: NDArray, share: float) -> FloatArray:
    """Return a vector turned towards another by a share of the angle between them."""
    length = float(np.linalg.norm(vector))
    start, end = vector / length, toward / float(np.linalg.norm(toward))
    angle = float(np.arccos(np.clip(start @ end, -1.0, 1.0)))
    if angle < 1e-6 or angle > np.pi - 1e-6:
        return vector
    mix = np.sin((1 - share) * angle) * start + np.sin(share * angle) * end
    return length * mix / np.sin(angle)


def _inside(pose: Pose, span: tuple[float, float]) -> NDArray[np.bool_]:
    return (pose.role.times >= span[0]) & (pose.role.times <= span[1])


def _carrier(owner: Pose, point: str) -> FloatArray:
    """Return the frame in which offsets from a point count; collars follow the hand, spines not."""
    return owner.frame("spine3" if point.endswith("collar") else point)


def _extension(pair: Pair, index: int, reach: Reach) -> float:
    """Return the longest span of a reach within its exact window, as a share of the arm."""
    pose = pair[index]
    span = goal_of(pair, index, reach) - pose.point(f"{reach.side}_shoulder")
    inside = _inside(pose, reach.exact or (0.0, 0.0))
    return float(np.linalg.norm(span[inside], axis=1).max()) / pose.role.build.arm


def extension(pair: Pair) -> float:
    """Return the longest reach within the windows that must be met, as a share of the arm.

    Uses the shoulders as they are before they follow the hand. 0 if nothing must be met.
    """
    return max(
        (
            _extension(pair, index, reach)
            for index, pose in enumerate(pair)
            for reach in pose.role.reaches
            if reach.exact is not None
        ),
        default=0.0,
    )


def _aim(pair: Pair, index: int, side: Side) -> tuple[FloatArray, FloatArray]:
    """Return where a hand goes and where its elbow points (forward, outward, up), ``[T, 3]``."""
    pose = pair[index]
    target = pose.point(f"{side}_shoulder") + _hanging(pose, side)
    elbow = np.tile(np.array(ELBOW_BACK), (len(target), 1))
    for reach in pose.role.reaches:
        if reach.side == side:
            weight = reach.weight[:, None]
            way = goal_of(pair, index, reach) - target
            target = target + weight * way + _arc(pose, side, way, reach.weight)
            elbow = elbow + weight * (reach.elbow - elbow)
    return target, elbow


def _arc(pose: Pose, side: Side, way: NDArray, weight: NDArray) -> FloatArray:
    """Return a bulge ``[T, 3]`` m, forward and outward, by which a hand clears the own body."""
    far = np.linalg.norm(way, axis=1)
    far = far / (1.0 + far / pose.role.build.arm)
    halfway = np.maximum(weight * (1.0 - weight), 0.0)  # weights pass 1 by a rounding now and then
    bulge = 0.35 * far * 4.0 * halfway**1.5
    direction = pose.frame("spine3") @ np.array([0.9, 0.45 * outward(side), 0.0])
    return bulge[:, None] * direction


def _pose_arm(pose: Pose, side: Side, target: NDArray, elbow: NDArray) -> None:
    build = pose.role.build
    sign = np.array([1.0, outward(side), 1.0])
    _pose_collar(pose, side, target)
    shoulder = pose.point(f"{side}_shoulder")
    upper, lower = two_bones(
        shoulder,
        shoulder + within_reach(target - shoulder, build.arm),
        apply(pose.frame("spine3"), elbow * sign),
        (build.offset(f"{side}_elbow"), build.offset(f"{side}_wrist")),
        (0.0, 0.0, -outward(side)),
        tip=1.0 + build.skeleton.hand_per_forearm,
    )
    pose.turn(f"{side}_shoulder", upper)
    pose.turn(f"{side}_elbow", lower)
    pose.turn(f"{side}_wrist", lower)


def _hanging(pose: Pose, side: Side) -> FloatArray:
    """Return where a hanging hand is, from the shoulder, ``[T, 3]`` m in the world."""
    role = pose.role
    swing = hand_swing(role, pose.feet, side) / role.build.arm
    direction = np.column_stack(
        [0.07 + swing, np.full(len(swing), 0.17 * outward(side)), np.full(len(swing), -1.0)]
    )
    frame = yaw(role.heading + 0.5 * role.twist) @ pitch(0.6 * role.lean)
    return apply(frame, unit(direction) * HANGING * role.build.arm)


def _pose_collar(pose: Pose, side: Side, target: NDArray) -> None:
    """Let the shoulder follow the hand: up when it rises, forward when it reaches out."""
    chest = pose.frame("spine3")
    aim = unapply(chest, unit(target - pose.point(f"{side}_shoulder")))
    lift = 0.30 * (0.5 + 0.5 * aim[:, 2]) ** 2
    forward = 0.15 * np.maximum(aim[:, 0], 0.0) ** 3
    pose.turn(f"{side}_collar", chest @ yaw(-outward(side) * forward) @ roll(outward(side) * lift))


def within_reach(span: NDArray, arm: float) -> FloatArray:
    """Return spans ``[T, 3]`` m shortened or stretched to what the arm can do.

    Nothing changes between :data:`SHORTEST` plus a margin and :data:`LONGEST`; beyond, the length
    approaches its limit smoothly.
    """
    length = np.linalg.norm(span, axis=1) / arm
    margin = 0.05
    over = LONGEST + margin * np.tanh((length - LONGEST) / margin)
    knee = SHORTEST + margin
    under = knee - margin * np.tanh((knee - length) / margin)
    bounded = np.where(length > LONGEST, over, np.where(length < knee, under, length))
    return span * (bounded / np.maximum(length, 1e-9))[:, None]
