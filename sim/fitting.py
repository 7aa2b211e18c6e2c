"""From a person's keypoints to a skeleton and rotations that a body with feet can follow.

**The problem.** :func:`generator.kinematics.fit_rotations` meets the directions of bones of *our*
rest pose. Other skeletons differ where a keypoint has several children (hips and lower spine;
collars and neck) and at the foot: in one data set the ankle keypoint lies 8 cm above a flat sole,
in the next 4 cm, and then every standing foot would come out pitched by 15 degrees, through the
floor. Positions say nothing about the roll of a foot and the bend of its toes either. So

1. rest offsets of the children of branching keypoints become their time-median in the parent's
   frame,
2. the ankle-to-toe offset is pitched so that the foot is level where it stands flat,
3. near the floor, feet are rolled level about their own axis, and toes are bent level when the heel
   is up.

Example: a clip whose toe keypoint lies 3 cm below the ankle over 13 cm of foot, our rest pose has
5.5 cm: step 2 turns the rest offset up by 11 degrees, and the sole box of the body stands flat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.kinematics import (
    continuous,
    fit_rotations,
    fit_skeleton,
    forward_kinematics,
    global_rotations,
    to_wxyz,
    unit,
)
from generator.motion import Motion
from robots.skeleton import FloatArray, Skeleton
from sim.footing import smoothstep, standing

_OWN_ROTATIONS_ERROR = 0.02
"""Mean distance, m, up to which a motion's own rotations are believed."""
_PITCH = np.radians([5.0, 60.0])
"""Range of the angle of the ankle-to-toe bone below the horizontal in a flat foot."""


def fit_person(motion: Motion) -> tuple[Skeleton, FloatArray]:
    """Return the skeleton of a person and rotations ``[T, J, 4]`` wxyz that give its keypoints.

    Rotations that come with the motion are used if they reproduce its keypoints.
    """
    points = motion.keypoints
    if motion.rotations is not None:
        made = forward_kinematics(motion.skeleton, points[:, 0], motion.rotations)
        if np.linalg.norm(made - points, axis=-1).mean() < _OWN_ROTATIONS_ERROR:
            return motion.skeleton, continuous(motion.rotations)
    skeleton = fit_skeleton(motion.skeleton, points)
    for _ in range(2):
        skeleton = _refine_branches(skeleton, points)
    skeleton = _level_rest_feet(skeleton, motion)
    rotations = fit_rotations(skeleton, points)
    return skeleton, continuous(_plant_feet(skeleton, points, rotations))


def _refine_branches(skeleton: Skeleton, points: NDArray) -> Skeleton:
    """Return the skeleton with the rest offsets of siblings as this person has them."""
    frames = global_rotations(skeleton, fit_rotations(skeleton, points))
    offsets = skeleton.offsets.copy()
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0 and skeleton.parents.count(parent) > 1:
            local = frames[parent].inv().apply(points[:, j] - points[:, parent])
            offsets[j] = np.median(local, axis=0)
    return Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.hand_per_forearm)


def _level_rest_feet(skeleton: Skeleton, motion: Motion) -> Skeleton:
    """Return the skeleton with ankle-to-toe offsets pitched as they are in standing feet."""
    offsets = skeleton.offsets.copy()
    for side in ("left", "right"):
        ankle, toe = motion.point(f"{side}_ankle"), motion.point(f"{side}_foot")
        flat = standing(ankle, motion.fps) & standing(toe, motion.fps)
        if not flat.any():
            continue
        bone = np.median(unit(toe[flat] - ankle[flat]) @ [0.0, 0.0, 1.0])
        pitch = np.clip(np.arcsin(-bone), *_PITCH)
        j = skeleton.index(f"{side}_foot")
        length, ahead = np.linalg.norm(offsets[j]), unit(offsets[j] * (1.0, 1.0, 0.0))
        offsets[j] = length * (np.cos(pitch) * ahead - [0.0, 0.0, np.sin(pitch)])
    return Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.hand_per_forearm)


def _plant_feet(skeleton: Skeleton, points: NDArray, rotations: NDArray) -> FloatArray:
    """Return rotations with feet rolled level and toes bent level near the floor."""
    rotations = rotations.copy()
    frames = global_rotations(skeleton, rotations)
    for side in ("left", "right"):
        knee, ankle, toe = (skeleton.index(f"{side}_{n}") for n in ("knee", "ankle", "foot"))
        height = points[:, toe, 2] - np.percentile(points[:, toe, 2], 5)
        near = 1 - smoothstep((height - 0.03) / 0.12)
        axis = frames[ankle].apply(unit(skeleton.offsets[toe]))
        across = frames[ankle].apply([0.0, 1.0, 0.0])
        roll = np.arctan2(-across[:, 2], np.cross(axis, across)[:, 2])
        roll = np.clip(roll, -np.pi / 4, np.pi / 4) * near
        level = Rotation.from_rotvec(axis * roll[:, None]) * frames[ankle]
        rotations[:, ankle] = to_wxyz(frames[knee].inv() * level)
        down = np.arcsin(np.clip(-level.apply([1.0, 0.0, 0.0])[:, 2], -1, 1))
        bend = np.clip(down, 0.0, np.pi / 3) * near
        rotations[:, toe] = to_wxyz(Rotation.from_rotvec(-bend[:, None] * [0.0, 1.0, 0.0]))
    return rotations
