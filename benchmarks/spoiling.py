"""Spoil a motion the way a network of positions errs: everything roughly right, nothing exact.

Each person's pelvis drifts, joints wander by a few degrees, bones breathe, keypoints jitter from
frame to frame, people stand a little off their places so that hands miss, and labels of foot
contacts are wrong here and there. Keypoints are what a network puts out, so skeleton and rotations
are fitted to the spoilt ones; the frame rate is lower than that of the original.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from generator.finishing.resample import resample, resample_labels, resample_rotations
from generator.io.assembly import fit_body
from generator.kinematics import forward_kinematics, from_wxyz, to_wxyz
from generator.motion import DuetMotion, Motion
from robots.skeleton import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Spoiling:
    """How much to spoil; lengths and angles are standard deviations per axis."""

    fps: float = 15.0
    """Frames per second of the spoilt motion."""
    place: float = 0.05
    """Of where a person stands along the floor, m."""
    drift: float = 0.02
    """Of the slow path of the pelvis, m."""
    drift_time: float = 0.4
    """Width of the Gaussian that smooths drift and turns, s."""
    turn: float = np.radians(3.0)
    """Of the slow part of every rotation, rad."""
    bones: float = 0.04
    """Of the length of every bone, as a share."""
    jitter: float = 0.004
    """Of what is new in each frame in every keypoint, m."""
    labels: float = 0.05
    """Share of foot contacts that are labelled wrongly."""


def spoil(motion: DuetMotion, seed: int, amount: Spoiling | None = None) -> DuetMotion:
    """Return a spoilt motion with the touches of the old one; the same seed spoils it alike.

    Args:
        motion: Two people with rotations.
        seed: Of the noise; both people draw from it, a first.
        amount: The defaults if not given.
    """
    amount = amount or Spoiling()
    rng = np.random.default_rng(seed)
    a, b = (_spoilt(person, amount, rng) for person in motion.people)
    return replace(motion, a=a, b=b, source=f"{motion.source}, spoilt with seed {seed}")


def _spoilt(person: Motion, amount: Spoiling, rng: np.random.Generator) -> Motion:
    if person.rotations is None:
        raise ValueError("the motion has no rotations")
    skeleton, fps = person.skeleton, amount.fps
    root = resample(person.keypoints[:, 0], person.fps, fps)
    rotations = resample_rotations(person.rotations, person.fps, fps)
    frames, joints = rotations.shape[:2]
    width = amount.drift_time * fps
    root = root + amount.place * rng.standard_normal(3) * (1, 1, 0)
    root = root + amount.drift * _slow(rng, frames, 3, width)
    turns = amount.turn * _slow(rng, frames, 3 * joints, width).reshape(-1, 3)
    turned = from_wxyz(rotations.reshape(-1, 4)) * Rotation.from_rotvec(turns)
    rigid = forward_kinematics(skeleton, root, to_wxyz(turned).reshape(rotations.shape))
    breath = 1 + amount.bones * _slow(rng, frames, joints, width)
    points = rigid.copy()
    for j, parent in enumerate(skeleton.parents[1:], start=1):
        bone = rigid[:, j] - rigid[:, parent]
        points[:, j] = points[:, parent] + breath[:, [j]] * bone
    points += amount.jitter * rng.standard_normal(points.shape)
    own, pose = fit_body(points)
    labels = None
    if person.foot_contacts is not None:
        labels = resample_labels(person.foot_contacts, person.fps, fps)
        labels = labels ^ (rng.random(labels.shape) < amount.labels)
    return Motion(fps, points, pose, labels, own)


def _slow(rng: np.random.Generator, frames: int, channels: int, width: float) -> FloatArray:
    """Return smooth noise ``[frames, channels]`` of unit variance, the same in law everywhere."""
    reach = int(np.ceil(4 * width))
    white = rng.standard_normal((frames + 2 * reach, channels))
    smooth = gaussian_filter1d(white, width, axis=0, mode="wrap")
    return smooth[reach : reach + frames] * np.sqrt(2 * np.sqrt(np.pi) * width)
