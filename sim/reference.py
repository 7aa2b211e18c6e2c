"""What the controller is to follow: a :class:`DuetMotion` as smooth poses at control rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from generator.kinematics import from_wxyz
from generator.motion import Contact, DuetMotion, Motion
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.fitting import fit_person
from sim.footing import clear_floor, ground_shift


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
    foot_lift: tuple[float, float]
    """Most that a swinging foot of each was lifted to clear the floor, m."""
    contacts: tuple[Contact, ...] = ()
    """Touches that the motion labels."""

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
        """Return velocities ``[N-1, 2, 3]`` and ``[N-1, 2, J, 3]`` from each sample to the next.

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
    clear: bool = True,
    weights: tuple[float | None, float | None] = (None, None),
) -> Reference:
    """Return the poses of a motion at control rate.

    Args:
        motion: What to follow.
        rate: Samples per second.
        smoothing: Standard deviation of the Gaussian low-pass, s; 0 leaves poses as they are.
        ground: Whether to lift or lower each person so that standing soles meet the floor.
        clear: Whether to lift swinging feet clear of the floor.
        weights: Body masses, kg; ``None`` takes the default for the stature.
    """
    count = int(np.ceil(motion.duration * rate - 1e-9)) + 1
    times = np.minimum(np.arange(count) / rate, motion.duration)
    roots, rotations, points, bodies, shifts, lifts = [], [], [], [], [], []
    for person, weight in zip(motion.people, weights, strict=True):
        skeleton, turns = fit_person(person)
        body = HumanBody.of(skeleton, weight)
        path = person.keypoints[:, 0]
        shift = ground_shift(body, path, turns, person.fps) if ground else 0.0
        up = np.array([0.0, 0.0, shift])
        sigma = smoothing * motion.fps
        root = _resample(person, path + up, times, sigma)
        turns, lift = _unit(_resample(person, turns, times, sigma)), 0.0
        if clear:
            turns, lift = clear_floor(body, root, turns, rate)
        roots.append(root)
        rotations.append(turns)
        points.append(_resample(person, person.keypoints + up, times, 0.0))
        bodies.append(body)
        shifts.append(shift)
        lifts.append(lift)
    return Reference(
        rate,
        np.stack(roots, axis=1),
        np.stack(rotations, axis=1),
        np.stack(points, axis=1),
        (bodies[0], bodies[1]),
        (shifts[0], shifts[1]),
        (lifts[0], lifts[1]),
        contacts=motion.contacts,
    )


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
