"""Soles and floor: where the soles are, how far to lift a person, how high to swing a foot.

**The problem.** Keypoints lie inside the foot, and every source puts them at another height above
the sole; a captured floor is off by centimetres; and a swinging heel that skims the floor by 7 mm
at 5 m/s, as captured ones do, catches on it as soon as the simulated leg lags a little, and the
person stumbles. So each person is moved by one constant such that standing soles are on the floor,
and a foot that moves fast is lifted to a clearance by bending the knee.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from generator.kinematics import continuous, forward_kinematics, global_rotations
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.repair.legs import SIDES, move_foot, smoothstep

FOOT_BODIES = ("left_ankle", "left_foot", "right_ankle", "right_foot")
"""Keypoints whose bodies carry the boxes of the feet."""

MAX_GROUND_SHIFT = 0.10
"""A floor found further off than this, m, is not sloppy calibration: nothing is shifted."""

CLEARANCE = 0.030
"""Clearance of a foot in full swing, m; people clear the floor by 10 to 30 mm in mid-swing."""
_SWING = (0.2, 0.8)
"""Speeds of a foot, m/s, between which the clearance grows from 0 to full."""
_STILL = 0.3
"""Speed below which a foot counts as standing, m/s."""
_LOW = 0.03
"""Height above its usual lowest below which a foot counts as standing, m."""


def standing(path: NDArray, fps: float) -> NDArray[np.bool_]:
    """Return in which frames ``[T]`` a foot's keypoint ``[T, 3]`` m is low and still."""
    speed = np.linalg.norm(np.gradient(path, axis=0), axis=1) * fps
    return (speed < _STILL) & (path[:, 2] < np.percentile(path[:, 2], 5) + _LOW)


def sole_corners(body: HumanBody, root: NDArray, rotations: NDArray) -> FloatArray:
    """Return the sole corners ``[T, 4, 4, 3]`` m, world, of each of :data:`FOOT_BODIES`.

    Args:
        body: Whose soles.
        root: ``[T, 3]`` m.
        rotations: ``[T, J, 4]`` wxyz.
    """
    points = forward_kinematics(body.skeleton, root, rotations)
    frames = global_rotations(body.skeleton, rotations)
    corners = np.empty((len(root), len(FOOT_BODIES), 4, 3))
    for i, name in enumerate(FOOT_BODIES):
        j = body.skeleton.index(name)
        local = body.sole_corners(name)
        corners[:, i] = points[:, j, None] + np.einsum("tij,cj->tci", frames[j].as_matrix(), local)
    return corners


def ground_shift(body: HumanBody, root: NDArray, rotations: NDArray, fps: float) -> float:
    """Return how far to lift a person, m, so that the soles are on the floor where they stand.

    The median, over the frames in which a foot stands, of the height of the lowest sole corner: one
    constant for the clip, because a changing one would move the person up and down. 0 if no foot
    ever stands, or if the floor would be further off than :data:`MAX_GROUND_SHIFT`.
    """
    points = forward_kinematics(body.skeleton, root, rotations)
    low = sole_corners(body, root, rotations)[..., 2].min(axis=2)
    lowest = low.min(axis=1)
    stands = np.zeros(len(root), dtype=bool)
    for i, name in enumerate(FOOT_BODIES):
        path = points[:, body.skeleton.index(name)]
        stands |= standing(path, fps) & (low[:, i] < lowest + 0.02)
    if not stands.any():
        return 0.0
    shift = -float(np.median(lowest[stands]))
    return shift if abs(shift) <= MAX_GROUND_SHIFT else 0.0


def clear_floor(
    body: HumanBody, root: NDArray, rotations: NDArray, fps: float
) -> tuple[FloatArray, FloatArray]:
    """Return rotations ``[T, J, 4]`` whose swinging feet clear the floor, and the lifts ``[T]`` m.

    Args:
        body: Whose feet.
        root: ``[T, 3]`` m.
        rotations: ``[T, J, 4]`` wxyz.
        fps: Samples per second.
    """
    corners = sole_corners(body, root, rotations)
    most = np.zeros(len(root))
    for i, side in enumerate(SIDES):
        sole = corners[:, 2 * i : 2 * i + 2].reshape(len(root), -1, 3)
        speed = np.linalg.norm(np.gradient(sole.mean(axis=1), axis=0), axis=1) * fps
        share = smoothstep((speed - _SWING[0]) / (_SWING[1] - _SWING[0]))
        lift = np.maximum(CLEARANCE * share - sole[..., 2].min(axis=1), 0.0) * share
        lift = maximum_filter1d(lift, 2 * round(0.05 * fps) + 1)
        lift = gaussian_filter1d(np.minimum(lift, 2 * CLEARANCE), 0.03 * fps)
        if lift.max() > 1e-3:
            up = lift[:, None] * [0.0, 0.0, 1.0]
            rotations = move_foot(body, root, rotations, side, up)
            most = np.maximum(most, lift)
    return continuous(rotations), most
