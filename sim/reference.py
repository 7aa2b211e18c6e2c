"""What the controller is to follow: a :class:`DuetMotion` as smooth poses at control rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from generator.kinematics import from_wxyz, global_rotations
from generator.motion import DuetMotion, Motion
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.fitting import fit_person, standing

MAX_GROUND_SHIFT = 0.10
"""A floor found further off than this, m, is not sloppy calibration: nothing is shifted."""

FOOT_BODIES = ("left_ankle", "left_foot", "right_ankle", "right_foot")
"""Keypoints whose bodies carry the boxes of the feet."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Poses to follow, two people on one clock."""

    rate: float
    """Samples per second."""
    root: FloatArray
    """``[N, 2, 3]`` m, pelvis keypoints, world."""
    rotations: FloatArray
    """``[N, 2, J, 4]`` wxyz, root to world and others local to the parent."""
    keypoints: FloatArray
    """``[N, 2, J, 3]`` m: the motion's own keypoints (resampled and grounded, nothing else)."""
    bodies: tuple[HumanBody, HumanBody]
    """The two people."""
    ground_shift: tuple[float, float]
    """How far each was lifted so that its standing soles are on the floor, m."""

    @property
    def times(self) -> FloatArray:
        """``[N]`` s from 0."""
        return np.arange(len(self.root)) / self.rate

    def velocities(self) -> tuple[FloatArray, FloatArray]:
        """Return linear ``[N, 2, 3]`` m/s (world) and angular ``[N, 2, J, 3]`` rad/s velocities.

        Angular velocities are in the frame of the rotating body, as MuJoCo's. Central differences;
        one-sided at the ends.
        """
        linear, angular = self.steps()
        return _between(linear), _between(angular)

    def steps(self) -> tuple[FloatArray, FloatArray]:
        """Return the velocities ``[N-1, 2, 3]`` and ``[N-1, 2, J, 3]`` from each sample to the next.

        Units and frames as in :meth:`velocities`.
        """
        first = from_wxyz(self.rotations[:-1].reshape(-1, 4))
        turn = (first.inv() * from_wxyz(self.rotations[1:].reshape(-1, 4))).as_rotvec()
        shape = (len(self.root) - 1, *self.rotations.shape[1:3], 3)
        return np.diff(self.root, axis=0) * self.rate, turn.reshape(shape) * self.rate


def _between(steps: NDArray) -> FloatArray:
    """Return the mean of neighbouring steps ``[N-1, ...]`` at the ``N`` samples between them."""
    return np.concatenate([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]])


def make_reference(
    motion: DuetMotion,
    *,
    rate: float = 60.0,
    smoothing: float = 0.02,
    ground: bool = True,
    weights: tuple[float | None, float | None] = (None, None),
) -> Reference:
    """Return the poses of a motion at control rate.

    Args:
        motion: What to follow.
        rate: Samples per second.
        smoothing: Standard deviation of the Gaussian low-pass, s; 0 leaves poses as they are.
        ground: Whether to lift or lower each person so that standing soles meet the floor.
        weights: Body masses, kg; ``None`` takes the default for the stature.
    """
    count = int(np.ceil(motion.duration * rate - 1e-9)) + 1
    times = np.minimum(np.arange(count) / rate, motion.duration)
    roots, rotations, points, bodies, shifts = [], [], [], [], []
    for person, weight in zip(motion.people, weights, strict=True):
        skeleton, turns = fit_person(person)
        body = HumanBody.of(skeleton, weight)
        lift = ground_shift(person, body, turns) if ground else 0.0
        up = np.array([0.0, 0.0, lift])
        sigma = smoothing * motion.fps
        roots.append(_resample(person, person.keypoints[:, 0] + up, times, sigma))
        rotations.append(_unit(_resample(person, turns, times, sigma)))
        points.append(_resample(person, person.keypoints + up, times, 0.0))
        bodies.append(body)
        shifts.append(lift)
    return Reference(
        rate,
        np.stack(roots, axis=1),
        np.stack(rotations, axis=1),
        np.stack(points, axis=1),
        (bodies[0], bodies[1]),
        (shifts[0], shifts[1]),
    )


def ground_shift(person: Motion, body: HumanBody, rotations: NDArray) -> float:
    """Return how far to lift a person, m, so that the soles are on the floor where they stand.

    The median, over the frames in which a foot stands, of the height of the lowest sole corner: one
    constant for the clip, because a changing one would move the person up and down. 0 if no foot
    ever stands, or if the floor would be further off than :data:`MAX_GROUND_SHIFT`.
    """
    low = sole_heights(person, body, rotations)
    lowest = low.min(axis=1)
    stands = np.zeros(person.frames, dtype=bool)
    for i, name in enumerate(FOOT_BODIES):
        stands |= standing(person.point(name), person.fps) & (low[:, i] < lowest + 0.02)
    if not stands.any():
        return 0.0
    shift = -float(np.median(lowest[stands]))
    return shift if abs(shift) <= MAX_GROUND_SHIFT else 0.0


def sole_heights(person: Motion, body: HumanBody, rotations: NDArray) -> FloatArray:
    """Return the height ``[T, 4]`` m of the lowest corner of each of :data:`FOOT_BODIES`."""
    frames = global_rotations(body.skeleton, rotations)
    heights = np.empty((person.frames, len(FOOT_BODIES)))
    for i, name in enumerate(FOOT_BODIES):
        j = body.skeleton.index(name)
        up = frames[j].inv().apply([0.0, 0.0, 1.0])
        corners = up @ body.sole_corners(name).T
        heights[:, i] = person.keypoints[:, j, 2] + corners.min(axis=1)
    return heights


def _resample(person: Motion, values: NDArray, times: NDArray, sigma: float) -> FloatArray:
    """Return ``values [T, ...]`` at other times, by a cubic spline after a low-pass."""
    if sigma > 0:
        values = gaussian_filter1d(values, sigma, axis=0, mode="nearest")
    if person.frames < 4:
        spline = CubicSpline(person.times, values, axis=0, bc_type="natural")
    else:
        spline = CubicSpline(person.times, values, axis=0)
    return spline(times)


def _unit(quaternions: NDArray) -> FloatArray:
    """Return quaternions of length 1.

    A spline through sign-continuous unit quaternions stays within a few per mille of the sphere at
    human speeds and frame rates, so that normalising is all that a spline on SO(3) needs here.
    """
    return quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
