"""Hands that meet: which point of a person is to be where, relative to the partner, and when.

**The problem.** Two people who each track their own path to 3 cm miss each other's hand by 5. What
matters is the hand in the partner's frame. So while a touch lasts, the hand's goal is not its place
in the reference but the place where the partner's hand will be, by the partner's own plan, plus the
offset that the two have in the reference. Both do so and meet half way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from generator.kinematics import from_wxyz
from generator.motion import LEFT_HAND, RIGHT_HAND, Contact
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray

NEAR = 0.08
"""Hands closer than this in the reference, m, are taken to touch where nothing is labelled."""
RAMP = 0.25
"""How long before and after a touch it is already, and still, attended to, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A point fixed in one of a person's bodies."""

    body: int
    """Keypoint index."""
    local: FloatArray
    """``[3]`` m, in that body's frame."""

    def world(self, positions: NDArray, turns: NDArray) -> FloatArray:
        """Return the point ``[T, 3]`` m of poses ``[T, J, 3]`` and ``[T, J, 4]`` wxyz."""
        turned: Rotation = from_wxyz(turns[:, self.body])
        return positions[:, self.body] + turned.apply(self.local)


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """A point of one person that is to meet a point of the other."""

    own: Point
    partner: Point
    weight: FloatArray
    """``[N]`` 0 to 1, per tick."""
    offset: FloatArray
    """``[N, 3]`` m, world: from the partner's point to the own one in the reference."""


def body_point(body: HumanBody, name: str) -> Point:
    """Return the point of a keypoint, or of a hand (the middle knuckle)."""
    skeleton = body.skeleton
    if name in (LEFT_HAND, RIGHT_HAND):
        side = name.removesuffix("_hand")
        forearm = skeleton.offsets[skeleton.index(f"{side}_wrist")]
        return Point(skeleton.index(f"{side}_elbow"), forearm * (1 + skeleton.hand_per_forearm))
    return Point(skeleton.index(name), np.zeros(3))


def find_touches(
    bodies: tuple[HumanBody, HumanBody],
    poses: Sequence[tuple[NDArray, NDArray]],
    contacts: Sequence[Contact],
    rate: float,
) -> tuple[list[Touch], list[Touch]]:
    """Return the touches of both people.

    Args:
        bodies: Persons a and b.
        poses: Per person, positions ``[N, J, 3]`` m and orientations ``[N, J, 4]`` wxyz of all
            bodies in the reference.
        contacts: As labelled; without any, hands that come close are taken to touch.
        rate: Ticks per second.
    """
    found: tuple[list[Touch], list[Touch]] = ([], [])
    times = np.arange(len(poses[0][0])) / rate
    pairs = [(c.a, c.b) for c in contacts] or list(product((LEFT_HAND, RIGHT_HAND), repeat=2))
    for i, (a, b) in enumerate(pairs):
        points = body_point(bodies[0], a), body_point(bodies[1], b)
        one, other = (p.world(*pose) for p, pose in zip(points, poses, strict=True))
        if contacts:
            early, late = contacts[i].start - times, times - contacts[i].end
            weight = np.clip(1 - np.maximum(early, late) / RAMP, 0, 1)
        else:
            near = (np.linalg.norm(one - other, axis=1) < NEAR).astype(float)
            weight = np.minimum(1, 2 * gaussian_filter1d(near, RAMP / 2 * rate, mode="nearest"))
        weight[weight < 0.01] = 0
        if weight.any():
            found[0].append(Touch(points[0], points[1], weight, one - other))
            found[1].append(Touch(points[1], points[0], weight, other - one))
    return found
