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
    from_wxyz,
    global_rotations,
    to_wxyz,
    unit,
)
from generator.motion import Motion
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray, Skeleton
from sim.footing import sole_corners, standing
from sim.repair.legs import smoothstep

_OWN_ROTATIONS_ERROR = 0.02
"""Mean distance, m, up to which a motion's own rotations are believed."""
_LEVEL = 0.01
"""Most that the corners of a standing sole may differ in height, m, to be called level."""
_PITCH = np.radians([5.0, 60.0])
"""Range of the angle of the ankle-to-toe bone below the horizontal in a flat foot."""


def fit_person(motion: Motion) -> tuple[Skeleton, FloatArray]:
    """Return the skeleton of a person and rotations ``[T, J, 4]`` wxyz that give its keypoints.

    Rotations that come with the motion are used if they reproduce its keypoints and stand level.
    """
    points = motion.keypoints
    if motion.rotations is not None:
        made = forward_kinematics(motion.skeleton, points[:, 0], motion.rotations)
        fits = np.linalg.norm(made - points, axis=-1).mean() < _OWN_ROTATIONS_ERROR
        if fits and _stands_level(motion, motion.rotations):
            bent = _bend_toes(motion.skeleton, points, motion.rotations)
            return motion.skeleton, continuous(bent)
    skeleton = fit_skeleton(motion.skeleton, points)
    for _ in range(2):
        skeleton = _refine_branches(skeleton, points)
    skeleton = _level_rest_feet(skeleton, motion)
    rotations = fit_rotations(skeleton, points)
    rotations = _level_feet(skeleton, points, rotations)
    return skeleton, continuous(_bend_toes(skeleton, points, rotations))


def _stands_level(motion: Motion, rotations: NDArray) -> bool:
    """Return whether the soles of standing feet are level, so that rotations suit our feet."""
    body = HumanBody.of(motion.skeleton)
    heights = sole_corners(body, motion.keypoints[:, 0], rotations)[..., 2]
    for i, side in enumerate(("left", "right")):
        ankle, toe = motion.point(f"{side}_ankle"), motion.point(f"{side}_foot")
        flat = standing(ankle, motion.fps) & standing(toe, motion.fps)
        heel = heights[flat, 2 * i]
        if flat.any() and np.median(np.ptp(heel, axis=1)) > _LEVEL:
            return False
    return True


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


def _level_feet(skeleton: Skeleton, points: NDArray, rotations: NDArray) -> FloatArray:
    """Return rotations with feet rolled level about their own axis near the floor."""
    rotations = rotations.copy()
    frames = global_rotations(skeleton, rotations)
    for side in ("left", "right"):
        knee, ankle, toe = (skeleton.index(f"{side}_{n}") for n in ("knee", "ankle", "foot"))
        axis = frames[ankle].apply(unit(skeleton.offsets[toe]))
        across = frames[ankle].apply([0.0, 1.0, 0.0])
        roll = np.arctan2(-across[:, 2], np.cross(axis, across)[:, 2])
        roll = np.clip(roll, -np.pi / 4, np.pi / 4) * _near_floor(points[:, toe])
        level = Rotation.from_rotvec(axis * roll[:, None]) * frames[ankle]
        rotations[:, ankle] = to_wxyz(frames[knee].inv() * level)
    return rotations


def _bend_toes(skeleton: Skeleton, points: NDArray, rotations: NDArray) -> FloatArray:
    """Return rotations with toes bent up to the level near the floor, where the heel is up.

    Without it the toes of everybody who walks would push through the floor at every step.
    """
    rotations = np.array(rotations)
    frames = global_rotations(skeleton, rotations)
    for side in ("left", "right"):
        toe = skeleton.index(f"{side}_foot")
        down = np.arcsin(np.clip(-frames[toe].apply([1.0, 0.0, 0.0])[:, 2], -1, 1))
        bend = np.clip(down, 0.0, np.pi / 3) * _near_floor(points[:, toe])
        own = from_wxyz(rotations[:, toe])
        rotations[:, toe] = to_wxyz(own * Rotation.from_rotvec(-bend[:, None] * [0.0, 1.0, 0.0]))
    return rotations


def _near_floor(path: NDArray) -> FloatArray:
    """Return 1 where a toe keypoint ``[T, 3]`` m is about as low as it gets, 0 from 15 cm up."""
    height = path[:, 2] - np.percentile(path[:, 2], 5)
    return 1 - smoothstep((height - 0.03) / 0.12)
