"""Spoil a motion the way a generator of motions errs.

Networks that draw motion get the whole right and the details wrong: people drift against the floor
and against each other by centimetres, limbs wander by a few degrees, and neighbouring frames do not
quite agree. So each person's pelvis gets a slow random path, and every rotation a slow and a
frame-wise random turn; keypoints then follow by forward kinematics, so that bones keep their
lengths. Intended touches stay labelled though the hands now miss each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from generator.kinematics import continuous, forward_kinematics, from_wxyz, to_wxyz
from generator.motion import DuetMotion, Motion
from robots.skeleton import FloatArray
from sim.fitting import fit_person


@dataclass(frozen=True, slots=True, kw_only=True)
class Corruption:
    """How much to spoil; each value is a standard deviation per axis."""

    drift: float = 0.02
    """Of the pelvis, m."""
    drift_time: float = 0.5
    """Width of the Gaussian that smooths the drift, s."""
    turn: float = np.radians(2.0)
    """Of the smooth part of every rotation, rad."""
    turn_time: float = 0.25
    """Width of the Gaussian that smooths the turns, s."""
    shake: float = np.radians(0.5)
    """Of the part of every rotation that is new in each frame, rad."""


def corrupt(motion: DuetMotion, seed: int, amount: Corruption | None = None) -> DuetMotion:
    """Return a spoilt motion with the labels of the old one; the same seed spoils it alike.

    Args:
        motion: Any duet.
        seed: Of the noise; both people draw from it, a first.
        amount: Standard deviations; the defaults if not given.
    """
    amount = amount or Corruption()
    rng = np.random.default_rng(seed)
    a, b = (_spoilt(person, amount, rng) for person in motion.people)
    return replace(motion, a=a, b=b, source=f"{motion.source}, corrupted with seed {seed}")


def _spoilt(person: Motion, amount: Corruption, rng: np.random.Generator) -> Motion:
    skeleton, rotations = fit_person(person)
    frames, joints = rotations.shape[:2]
    drift = amount.drift * _smooth(rng, frames, 3, amount.drift_time * person.fps)
    turns = amount.turn * _smooth(rng, frames, 3 * joints, amount.turn_time * person.fps)
    turns += amount.shake * rng.standard_normal(turns.shape)
    noise = Rotation.from_rotvec(turns.reshape(-1, 3))
    spoilt = to_wxyz(from_wxyz(rotations.reshape(-1, 4)) * noise).reshape(rotations.shape)
    spoilt = continuous(spoilt)
    points = forward_kinematics(skeleton, person.keypoints[:, 0] + drift, spoilt)
    return Motion(person.fps, points, spoilt, person.foot_contacts, skeleton)


def _smooth(rng: np.random.Generator, frames: int, channels: int, sigma: float) -> FloatArray:
    """Return Gaussian-filtered white noise ``[frames, channels]`` of unit variance.

    It is stationary: drawn wide enough that the filter never sees an edge, and scaled by what the
    filter leaves of the variance, not by what one short clip happens to show.
    """
    reach = int(np.ceil(4 * sigma))
    impulse = np.zeros(2 * reach + 1)
    impulse[reach] = 1.0
    kernel = gaussian_filter1d(impulse, sigma, mode="constant")
    white = rng.standard_normal((frames + 2 * reach, channels))
    smooth = gaussian_filter1d(white, sigma, axis=0, mode="constant")
    return smooth[reach : reach + frames] / np.sqrt((kernel**2).sum())
