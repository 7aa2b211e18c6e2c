"""From a role to pelvis, legs, spine and head.

**The problem.** The pelvis must never be farther from a standing ankle than the leg is long, or the
knee snaps straight and the foot slides; yet a pelvis that is simply kept low walks in a crouch.
Each frame gives, per leg, the greatest height at which the leg still has a little bend. The pelvis
follows the lower envelope of the two: a running minimum, smoothed by a window no wider than that of
the minimum, so that the result stays below every limit and is smooth. It rises over the standing
leg and sinks between steps by itself, as in walking people.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from generator.choreographer.footsteps import Foot, foot_path, plan_steps
from generator.choreographer.frames import apply, pitch, roll, two_bones, unapply, yaw
from generator.choreographer.pose import Pose
from generator.choreographer.role import Role
from generator.choreographer.style import SIDES, Side
from generator.kinematics import unit
from robots.skeleton import FloatArray

STRAIGHTEST = 0.994
"""Longest leg, hip to ankle, as a share of thigh plus shank: a knee bent by 13 degrees."""
LEAN_SHARE = {"pelvis": 0.35, "spine1": 0.25, "spine2": 0.25, "spine3": 0.15}
"""How the bending of the trunk is spread over its keypoints."""
TWIST_SHARE = {"pelvis": 0.0, "spine1": 0.3, "spine2": 0.3, "spine3": 0.4}
COUNTERWEIGHT = 0.17
"""How far the pelvis moves back for a trunk bent level, m: keeps the mass above the feet."""


def pose_trunk(role: Role, energy: float = 1.0) -> Pose:
    """Return a pose with feet, legs and trunk; head and arms still hang from the upper spine."""
    steps = plan_steps(role)
    feet: dict[Side, Foot] = {s: foot_path(role, steps, s, lift=energy) for s in SIDES}
    pose = Pose(role, feet)
    ahead = _foot_ahead(role, feet)
    pelvis = (
        yaw(role.heading - 0.15 * ahead)
        @ pitch(LEAN_SHARE["pelvis"] * role.lean)
        @ roll(LEAN_SHARE["pelvis"] * role.tilt)
    )
    place = _pelvis_place(role, feet)
    pose.points[:, 0] = np.column_stack([place, _pelvis_height(role, feet, place, pelvis)])
    pose.turn("pelvis", pelvis)
    counter = {"spine1": 0.3 * ahead}  # the shoulders turn against the hips
    parent = pelvis
    for name in ("spine1", "spine2", "spine3"):
        parent = (
            parent
            @ yaw(TWIST_SHARE[name] * role.twist + counter.get(name, 0.0))
            @ pitch(LEAN_SHARE[name] * role.lean)
            @ roll(LEAN_SHARE[name] * role.tilt)
        )
        pose.turn(name, parent)
    for name in ("neck", "head", "left_collar", "right_collar"):
        pose.turn(name, parent)
    for side in SIDES:
        _pose_leg(pose, side)
    return pose


def _foot_ahead(role: Role, feet: dict[Side, Foot]) -> FloatArray:
    """Return how far the left foot is ahead of the right ``[T]``, m."""
    between = (feet["left"].ankle - feet["right"].ankle)[:, :2]
    return np.einsum("ti,ti->t", between, _forward(role))


def _forward(role: Role) -> FloatArray:
    return np.column_stack([np.cos(role.heading), np.sin(role.heading)])


def _pelvis_place(role: Role, feet: dict[Side, Foot]) -> FloatArray:
    """Return the pelvis ``[T, 2]`` m: along the path, over the standing foot, back when leaning."""
    forward = _forward(role)
    left = np.column_stack([-forward[:, 1], forward[:, 0]])
    load = np.column_stack([feet[side].toe_down for side in SIDES]).astype(float)
    load = gaussian_filter1d(load, 4.0, axis=0, mode="nearest") + 1e-6
    load /= load.sum(axis=1, keepdims=True)
    support = sum(load[:, [i]] * feet[side].ankle[:, :2] for i, side in enumerate(SIDES))
    aside = np.einsum("ti,ti->t", support - role.path, left)
    back = COUNTERWEIGHT * role.build.scale * np.sin(0.8 * role.lean)
    tilt = 0.10 * role.build.scale * np.sin(role.tilt)
    place = role.path + (0.3 * aside + tilt)[:, None] * left - back[:, None] * forward
    shift = role.shift * role.build.scale
    return place + shift[:, [0]] * forward + shift[:, [1]] * left


def _pelvis_height(
    role: Role, feet: dict[Side, Foot], place: NDArray, pelvis: NDArray
) -> FloatArray:
    """Return the height ``[T]`` m of the pelvis; see the top of this file."""
    limits = []
    for side in SIDES:
        hip = apply(pelvis, role.build.offset(f"{side}_hip"))
        level = np.linalg.norm(feet[side].ankle[:, :2] - place - hip[:, :2], axis=1)
        longest = STRAIGHTEST * role.build.leg
        drop = np.sqrt(np.maximum(longest**2 - level**2, (0.3 * longest) ** 2))
        limits.append(feet[side].ankle[:, 2] + drop - hip[:, 2])
    lowest = np.minimum(*limits) - role.crouch
    lowest = minimum_filter1d(lowest, 7, mode="nearest")
    return gaussian_filter1d(lowest, 1.5, radius=3, mode="nearest")


def _pose_leg(pose: Pose, side: Side) -> None:
    build, foot = pose.role.build, pose.feet[side]
    toward = 0.5 * (pose.role.heading + foot.direction)
    # The knee of a leg that is kicked up points up, since the leg itself points forward.
    forward = np.column_stack([np.cos(toward), np.sin(toward), 0.15 + 1.5 * foot.kicked])
    thigh, shank = two_bones(
        pose.point(f"{side}_hip"),
        foot.ankle,
        forward,
        (build.offset(f"{side}_knee"), build.offset(f"{side}_ankle")),
        (0.0, 1.0, 0.0),
    )
    pose.turn(f"{side}_hip", thigh)
    pose.turn(f"{side}_knee", shank)
    pose.turn(f"{side}_ankle", foot.rotation)
    pose.turn(f"{side}_foot", foot.rotation)


def pose_head(pose: Pose, partner: Pose) -> None:
    """Turn neck and head to the partner's head or straight ahead, as far as a neck turns."""
    role = pose.role
    chest = pose.frame("spine3")
    level = np.column_stack([_forward(role), np.zeros(len(role.times))])
    ahead = unit(level + chest[:, :, 0])
    seen = unit(partner.point("head") - pose.point("head"))
    direction = unapply(chest, unit(ahead + role.gaze[:, None] * (seen - ahead)))
    side = np.arctan2(direction[:, 1], np.maximum(direction[:, 0], 0.05))
    side = 1.1 * np.tanh(side / 1.1)
    down = -0.6 * np.tanh(np.arcsin(np.clip(direction[:, 2], -1, 1)) / 0.6) + role.nod
    side, down = (gaussian_filter1d(angle, 4.0, mode="nearest") for angle in (side, down))
    frame = chest
    for name, share in (("neck", 0.4), ("head", 0.6)):
        frame = frame @ yaw(share * side) @ pitch(share * down)
        pose.turn(name, frame)


def hand_swing(role: Role, feet: dict[Side, Foot], side: Side) -> FloatArray:
    """Return how far a hanging hand swings forward ``[T]``, m: with the foot of the other side."""
    other: Side = "right" if side == "left" else "left"
    ahead = feet[other].ankle[:, :2] - 0.5 * sum(feet[s].ankle[:, :2] for s in SIDES)
    along = np.einsum("ti,ti->t", ahead, _forward(role))
    return 0.9 * role.arm_swing * gaussian_filter1d(along, 2.0, mode="nearest")
