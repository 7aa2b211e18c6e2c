"""What a robot needs to know of a person: directions and lengths of limbs, heading, feet, head."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from bridge.retarget.build import SIDES
from generator.kinematics import fit_rotations, global_rotations, unit
from generator.motion import Motion
from robots.skeleton import FloatArray

SMOOTHING = 0.04
"""Standard deviation of the low-pass on keypoints, s: servos should not follow capture noise."""
TURNING = 0.15
"""The same for headings, s."""
STANCE = 0.03
"""An ankle this close above its lowest is taken to stand, m."""


@dataclass(frozen=True, slots=True, eq=False)
class Person:
    """One person's motion, in directions and lengths. World frame, z up."""

    motion: Motion
    """Smoothed."""
    heading: FloatArray
    """``[T]`` rad, unwrapped: where the pelvis faces."""
    torso: Rotation
    """``[T]`` rest frame to world: up along the trunk, sideways between hips and shoulders."""
    head: Rotation
    """``[T]`` rest frame to world."""
    arm_length: float
    """Shoulder to hand, stretched, m."""
    leg_length: float
    """Hip to ankle, stretched, m."""
    hip_width: float
    """Between the hips, m."""
    floor: float
    """Height of the ankles when standing, m."""

    def limb(self, start: str, end: str) -> FloatArray:
        """Return unit directions ``[T, 3]`` between two points."""
        return unit(self.motion.point(end) - self.motion.point(start))

    @property
    def hips(self) -> FloatArray:
        """``[T, 3]`` m, middle between the hips."""
        return 0.5 * (self.motion.point("left_hip") + self.motion.point("right_hip"))

    def foot(self, side: str) -> FloatArray:
        """Return how the foot is turned ``[T, 2]`` rad: yaw, and pitch of the toes upwards.

        Pitch counts from the median over stance, so that a standing foot is flat whatever the
        shape of the captured shoe.
        """
        line = self.limb(f"{side}_ankle", f"{side}_foot")
        pitch = np.arcsin(np.clip(line[:, 2], -1, 1))
        ankle = self.motion.point(f"{side}_ankle")[:, 2]
        pitch = pitch - np.median(pitch[ankle <= ankle.min() + STANCE])
        yaw = np.unwrap(np.arctan2(line[:, 1], line[:, 0]))
        return np.stack([yaw, pitch], axis=1)


def observe(motion: Motion) -> Person:
    """Return what a robot needs to know of a person's motion."""
    sigma = SMOOTHING * motion.fps
    points = gaussian_filter1d(motion.keypoints, sigma, axis=0, mode="nearest")
    smooth = Motion(motion.fps, points, skeleton=motion.skeleton)
    pelvis = smooth.point("left_hip") - smooth.point("right_hip")
    heading = np.unwrap(np.arctan2(-pelvis[:, 0], pelvis[:, 1]))
    turns = fit_rotations(motion.skeleton, points)
    frames = global_rotations(motion.skeleton, turns)
    ankles = np.stack([smooth.point(f"{side}_ankle")[:, 2] for side in SIDES])
    return Person(
        motion=smooth,
        heading=gaussian_filter1d(heading, TURNING * motion.fps, mode="nearest"),
        torso=_torso(smooth),
        head=frames[motion.skeleton.index("head")],
        arm_length=_length(smooth, "shoulder", "elbow") + _length(smooth, "elbow", "hand"),
        leg_length=_length(smooth, "hip", "knee") + _length(smooth, "knee", "ankle"),
        hip_width=float(np.median(np.linalg.norm(pelvis, axis=1))),
        floor=float(np.percentile(ankles.min(axis=0), 10)),
    )


def _length(motion: Motion, start: str, end: str) -> float:
    """Return the median length of a limb over time and both sides, m."""
    bones = [motion.point(f"{side}_{end}") - motion.point(f"{side}_{start}") for side in SIDES]
    return float(np.median(np.linalg.norm(np.stack(bones), axis=-1)))


def _torso(motion: Motion) -> Rotation:
    shoulders = {side: motion.point(f"{side}_shoulder") for side in SIDES}
    hips = {side: motion.point(f"{side}_hip") for side in SIDES}
    up = unit(sum(shoulders.values()) - sum(hips.values()))  # type: ignore[operator]
    left = unit(shoulders["left"] - shoulders["right"]) + unit(hips["left"] - hips["right"])
    return frame(up, left)


def frame(up: NDArray, left: NDArray) -> Rotation:
    """Return rotations ``[T]`` whose z axis is ``up`` and whose y axis is nearest to ``left``."""
    z = unit(up)
    y = unit(left - z * np.einsum("ti,ti->t", left, z)[:, None])
    return Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=-1))
