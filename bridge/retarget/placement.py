"""How two robots stand to each other, so that hands which met still meet.

**The problem.** Scaling a duet by leg length moves the bodies together by .29 (for an OP3) but the
arms only shrink to .46: robots overlap or reach past each other. The distance between them is its
own unknown. Where no hands touch, it is scaled by the arms. Otherwise let ``d(t)`` be the vector
from a's touching point to b's, as the limb-normalised targets have it, and ``g(t)`` the intended
one. Robots on legs get an offset that turns with the pair, ``alpha u(t) + beta n(t)`` with ``u``
from a to b and ``n`` across; alpha and beta are the closed-form least squares of
``d + alpha u + beta n - g`` over all touches. Half of it moves each. A fixed base has one place for
the whole clip: the weighted mean does it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from bridge.retarget.build import Build
from bridge.retarget.human import Person
from bridge.retarget.targets import Targets, seated_targets, standing_targets
from bridge.retarget.touch import Touch
from generator.kinematics import unit
from robots.skeleton import FloatArray

SAFE = 1.1
"""Fixed robots that never touch stand this many added arm lengths apart: out of reach."""


def place(
    people: tuple[Person, Person],
    builds: tuple[Build, Build],
    free: tuple[bool, bool],
    touching: list[Touch],
) -> tuple[tuple[Targets, Targets], float]:
    """Return the targets of both robots on one stage, and the yaw of b's base if it is fixed.

    A fixed a stands at the origin and faces +x. If only one robot is fixed, the other moves about
    it as the people moved about each other, and the fixed one is put on a block that brings its
    shoulders to the other's height.
    """
    a, b = (
        standing_targets(person, build) if on_legs else seated_targets(person, build)
        for person, build, on_legs in zip(people, builds, free, strict=True)
    )
    if not any(free):
        return _seat_both(people, builds, a, b, touching)
    if not free[0]:
        b = _seen_from(people[0], b, builds[1].leg_length / people[1].leg_length)
    if not free[1]:
        a = _seen_from(people[1], a, builds[0].leg_length / people[0].leg_length)
    if not all(free):
        block = np.array([0.0, 0.0, _block_height(builds, free)])
        a, b = (a, b.shifted(block)) if free[0] else (a.shifted(block), b)
    directions = _directions(a, b, people[0].motion.fps)
    if _hand_touches(touching):
        offset = _along(a, b, touching, directions)
    else:
        offset = _apart(people, builds, directions[0])
    if all(free):
        return (a.shifted(-0.5 * offset), b.shifted(0.5 * offset)), 0.0
    return ((a, b.shifted(offset)) if free[1] else (a.shifted(-offset), b)), 0.0


def _block_height(builds: tuple[Build, Build], free: tuple[bool, bool]) -> float:
    """Return what a fixed robot must be raised by, m, for shoulders as high as the other's."""
    heights = []
    for build, on_legs in zip(builds, free, strict=True):
        shoulders = build.torso_from_base + np.mean(list(build.shoulders.values()), axis=0)
        base = 0.0
        if on_legs:
            hips = np.mean(list(build.hips.values()), axis=0)
            base = build.leg_length + build.ankle_height - hips[2]
        heights.append(base + shoulders[2])
    return max(0.0, heights[free.index(True)] - heights[free.index(False)])


def _seen_from(person: Person, targets: Targets, scale: float) -> Targets:
    """Return another robot's targets as seen from a person who stays put and faces +x."""
    feet = scale * person.hips
    feet[:, 2] = 0.0
    return targets.shifted(-feet).turned(-person.heading)


def _directions(a: Targets, b: Targets, fps: float) -> tuple[FloatArray, FloatArray]:
    """Return horizontal unit vectors ``[T, 3]`` from a to b, and across."""
    between = b.base - a.base
    between[:, 2] = 0.0
    along = unit(gaussian_filter1d(between, 0.2 * fps, axis=0, mode="nearest"))
    return along, np.stack([-along[:, 1], along[:, 0], along[:, 2]], axis=1)


def _along(
    a: Targets, b: Targets, touching: list[Touch], directions: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return the offset ``[T, 3]`` m of b against a that lets touches meet."""
    sums, weights = np.zeros(2), 0.0
    for touch in _hand_touches(touching):
        miss = _miss(a.points[touch.a], b.points[touch.b], touch)
        for i, direction in enumerate(directions):
            sums[i] += (touch.weight * np.einsum("ti,ti->t", miss, direction)).sum()
        weights += touch.weight.sum()
    alpha, beta = sums / weights
    return alpha * directions[0] + beta * directions[1]


def _apart(
    people: tuple[Person, Person], builds: tuple[Build, Build], along: NDArray
) -> FloatArray:
    """Return the offset ``[T, 3]`` m of b against a that scales their distance by the arms."""
    excess = np.mean(
        [
            b.arm_length / p.arm_length - (b.leg_length / p.leg_length if b.leg else 0.0)
            for p, b in zip(people, builds, strict=True)
        ]
    )
    distance = np.linalg.norm((people[1].hips - people[0].hips)[:, :2], axis=1)
    slow: FloatArray = gaussian_filter1d(distance, 0.3 * people[0].motion.fps, mode="nearest")
    return np.asarray(excess * slow[:, None] * along)


def _miss(a: NDArray, b: NDArray, touch: Touch) -> FloatArray:
    """Return what b's point lacks ``[T, 3]`` m to be at the intended distance from a's."""
    between = b - a
    return touch.gap * unit(between) - between


def _hand_touches(touching: list[Touch]) -> list[Touch]:
    """Return the touches that decide where robots stand: of hands, where there are any."""
    return [touch for touch in touching if touch.of_hands]


def _seat_both(
    people: tuple[Person, Person],
    builds: tuple[Build, Build],
    a: Targets,
    b: Targets,
    touching: list[Touch],
) -> tuple[tuple[Targets, Targets], float]:
    deciding = _hand_touches(touching)
    weight = np.sum([t.weight for t in deciding], axis=0) if deciding else np.ones(len(a.base))
    relative = people[1].heading - people[0].heading
    yaw = float(np.arctan2((weight * np.sin(relative)).sum(), (weight * np.cos(relative)).sum()))
    b = b.turned(yaw)
    if deciding:
        # The intended gap lies along the line between the two chests: a's +x, about.
        lacks = [
            t.weight[:, None] * (a.points[t.a] - b.points[t.b] + [t.gap, 0.0, 0.0])
            for t in deciding
        ]
        offset = np.sum(lacks, axis=(0, 1)) / weight.sum()
    else:
        between = people[1].hips - people[0].hips
        turn = -people[0].heading
        x = np.cos(turn) * between[:, 0] - np.sin(turn) * between[:, 1]
        y = np.sin(turn) * between[:, 0] + np.cos(turn) * between[:, 1]
        offset = np.array([x.mean(), y.mean(), 0.0])
        away = SAFE * (builds[0].arm_length + builds[1].arm_length)
        offset *= away / max(float(np.linalg.norm(offset)), 1e-6)
    offset[2] = 0.0
    return (a, b.shifted(offset)), yaw
