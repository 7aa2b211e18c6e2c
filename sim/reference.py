"""What the controller is to follow: a :class:`DuetMotion` as smooth poses at control rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from generator.kinematics import forward_kinematics, from_wxyz
from generator.motion import Contact, DuetMotion, Motion
from robots.errors import SpecError
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.fitting import fit_person
from sim.footing import MAX_GROUND_SHIFT, clear_floor, ground_shift
from sim.repair.amount import Repair, amount
from sim.repair.apart import push_apart
from sim.repair.lowpass import low_pass
from sim.repair.planting import find_stance, level_drift, plant_feet


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
    contacts: tuple[Contact, ...] = ()
    """Touches that the motion labels."""
    repairs: dict[str, dict[str, Repair]] = field(default_factory=dict)
    """What was changed, per person and kind; plain JSON, kinds in ``docs/physics.md``."""

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
    repair: bool = True,
    weights: tuple[float | None, float | None] = (None, None),
) -> Reference:
    """Return the poses of a motion at control rate.

    Args:
        motion: What to follow.
        rate: Samples per second.
        smoothing: Standard deviation of the Gaussian low-pass on clean motions, s.
        ground: Whether to lift or lower each person so that standing soles meet the floor.
        repair: Whether to take out what no body can do (:mod:`sim.repair`).
        weights: Body masses, kg; ``None`` takes the default for the stature.

    Raises:
        SpecError: A person's limbs or weight are those of nobody.
    """
    count = int(np.ceil(motion.duration * rate - 1e-9)) + 1
    times = np.minimum(np.arange(count) / rate, motion.duration)
    people = []
    for name, person, weight in zip("ab", motion.people, weights, strict=True):
        try:
            people.append(_follow(person, weight, times, smoothing, ground=ground, repair=repair))
        except SpecError as error:
            raise SpecError(
                f"by the keypoints, {error.what}",
                where=f"person {name} of the motion",
                allowed=error.allowed,
                hint="check its --scale, and whether these are joints of a person at all",
            ) from error
    if repair:
        people = [_level(person, rate) for person in people]
        aside = _apart(people, motion.contacts, rate)
        people = [_plant(one, other, rate) for one, other in zip(people, aside, strict=True)]
    a, b = people
    return Reference(
        rate,
        np.stack([a.root, b.root], axis=1),
        np.stack([a.rotations, b.rotations], axis=1),
        np.stack([a.keypoints, b.keypoints], axis=1),
        (a.body, b.body),
        (a.ground_shift, b.ground_shift),
        contacts=motion.contacts,
        repairs={"a": a.repairs, "b": b.repairs},
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Person:
    """One person on the way to a reference; fields as there."""

    body: HumanBody
    root: FloatArray
    rotations: FloatArray
    keypoints: FloatArray
    ground_shift: float
    repairs: dict[str, Repair]

    def points(self) -> FloatArray:
        """Return the keypoints ``[N, J, 3]`` m of the poses."""
        return forward_kinematics(self.body.skeleton, self.root, self.rotations)


def _follow(
    person: Motion,
    weight: float | None,
    times: NDArray,
    smoothing: float,
    *,
    ground: bool,
    repair: bool,
) -> _Person:
    """Return what a person's keypoints say, as poses of a body at given times."""
    skeleton, turns = fit_person(person)
    body = HumanBody.of(skeleton, weight)
    if repair:
        smoothing = low_pass(turns, person.fps, smoothing)
    sigma = smoothing * person.fps
    path, turns = _smooth(person.keypoints[:, 0], sigma), _unit(_smooth(turns, sigma))
    shift = ground_shift(body, path, turns, person.fps) if ground else 0.0
    up = np.array([0.0, 0.0, shift])
    root, rotations = _resample(person, path + up, times), _unit(_resample(person, turns, times))
    points = _resample(person, person.keypoints + up, times)
    off = np.linalg.norm(forward_kinematics(skeleton, root, rotations) - points, axis=-1)
    repairs = {
        "ground_shift": amount(abs(shift)),
        "low_pass_s": amount(smoothing),
        "limb_stretch": amount(off),
    }
    return _Person(body, root, rotations, points, shift, repairs)


def _level(person: _Person, rate: float) -> _Person:
    """Return a person at the height at which standing feet are on the floor."""
    stances = find_stance(person.body, person.root, person.rotations, rate)
    always, drift = level_drift(stances, rate)
    if abs(person.ground_shift + always) > MAX_GROUND_SHIFT:
        always = 0.0
    up = np.array([0.0, 0.0, 1.0])
    shift = person.ground_shift + always
    changes = {"ground_shift": amount(shift), "height_drift": amount(drift - always)}
    return replace(
        person,
        root=person.root + drift[:, None] * up,
        keypoints=person.keypoints + always * up,
        ground_shift=shift,
        repairs=person.repairs | changes,
    )


def _apart(
    people: Sequence[_Person], contacts: Sequence[Contact], rate: float
) -> tuple[_Person, _Person]:
    """Return two people of whom none is inside the other, and whose touches meet."""
    root = np.stack([p.root for p in people], axis=1)
    rotations = np.stack([p.rotations for p in people], axis=1)
    bodies = people[0].body, people[1].body
    root, rotations = push_apart(bodies, root, rotations, contacts, rate)
    out = []
    for p, person in enumerate(people):
        made = replace(person, root=root[:, p], rotations=rotations[:, p])
        moved = np.linalg.norm(made.points() - person.points(), axis=-1)
        out.append(replace(made, repairs=person.repairs | {"push_apart": amount(moved)}))
    return out[0], out[1]


def _plant(before: _Person, person: _Person, rate: float) -> _Person:
    """Return a person whose feet stand still, or swing clear of the floor.

    Args:
        before: The person before it was pushed aside, which shows when feet stand.
        person: The person.
        rate: Samples per second.
    """
    body, root = person.body, person.root
    aside = root - before.root
    stances = find_stance(body, before.root, before.rotations, rate)
    left, right = (replace(s, ball=s.ball + aside) for s in stances)
    rotations, moved = plant_feet(body, root, person.rotations, (left, right), rate)
    rotations, lift = clear_floor(body, root, rotations, rate)
    changes = {"foot_plant": amount(moved), "foot_lift": amount(lift)}
    return replace(person, rotations=rotations, repairs=person.repairs | changes)


def _smooth(values: NDArray, sigma: float) -> FloatArray:
    """Return ``values [T, ...]`` after a Gaussian low-pass of ``sigma`` frames."""
    return gaussian_filter1d(values, sigma, axis=0, mode="nearest") if sigma > 0 else values


def _resample(person: Motion, values: NDArray, times: NDArray) -> FloatArray:
    """Return ``values [T, ...]`` at other times, by a cubic spline."""
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
