"""How far two bodies of capsules are apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray, Skeleton


@dataclass(frozen=True, slots=True)
class Capsule:
    """A segment between two keypoints with a radius for a person of 1.70 m."""

    name: str
    start: str
    end: str
    radius: float


TRUNK = (
    Capsule("pelvis", "left_hip", "right_hip", 0.11),
    Capsule("chest", "spine1", "spine3", 0.12),
    Capsule("head", "head", "head", 0.10),
)
LEGS = tuple(
    capsule
    for side in ("left", "right")
    for capsule in (
        Capsule(f"{side} thigh", f"{side}_hip", f"{side}_knee", 0.08),
        Capsule(f"{side} shank", f"{side}_knee", f"{side}_ankle", 0.055),
    )
)
ARMS = tuple(
    capsule
    for side in ("left", "right")
    for capsule in (
        Capsule(f"{side} upper arm", f"{side}_shoulder", f"{side}_elbow", 0.05),
        Capsule(f"{side} forearm", f"{side}_elbow", f"{side}_wrist", 0.04),
    )
)


def segment_distance(p: NDArray, q: NDArray, r: NDArray, s: NDArray) -> FloatArray:
    """Return the distances ``[...]`` m between segments p-q and r-s, all ``[..., 3]`` m.

    The closest points of two segments are closest points of their lines, or one of them is an end:
    the least of the inner solution, where it lies inside, and the four end-to-segment distances.
    """
    u, v, w = q - p, s - r, p - r
    a, b, c = (_dot(x, y) for x, y in ((u, u), (u, v), (v, v)))
    d, e = (_dot(x, w) for x in (u, v))
    denominator = a * c - b * b
    safe = np.where(denominator > 1e-12, denominator, 1.0)
    first, second = (b * e - c * d) / safe, (a * e - b * d) / safe
    inside = (denominator > 1e-12) & (abs(first - 0.5) <= 0.5) & (abs(second - 0.5) <= 0.5)
    gap = np.linalg.norm(w + first[..., None] * u - second[..., None] * v, axis=-1)
    ends = [_point_segment(x, y, z) for x, y, z in ((p, r, s), (q, r, s), (r, p, q), (s, p, q))]
    return np.minimum(np.where(inside, gap, np.inf), np.min(ends, axis=0))


def _dot(x: NDArray, y: NDArray) -> FloatArray:
    return np.einsum("...i,...i->...", x, y)


def _point_segment(x: NDArray, p: NDArray, q: NDArray) -> FloatArray:
    u = q - p
    length = np.maximum(_dot(u, u), 1e-18)
    share = np.clip(_dot(x - p, u) / length, 0.0, 1.0)
    return np.linalg.norm(x - p - share[..., None] * u, axis=-1)


def clearances(
    bodies: tuple[tuple[Skeleton, NDArray, float], tuple[Skeleton, NDArray, float]],
    capsules: tuple[Capsule, ...] = TRUNK + LEGS + ARMS,
) -> dict[tuple[str, str], FloatArray]:
    """Return, for every pair of capsules of two people, the gap ``[T]`` m (negative: sunk in).

    Args:
        bodies: Per person the skeleton, keypoints ``[T, J, 3]`` m, and size relative to 1.70 m.
        capsules: Which parts of both bodies.
    """
    (p, q, own), (r, s, others) = (_segments(*body, capsules) for body in bodies)
    distance = segment_distance(p[:, None], q[:, None], r[None], s[None])
    gaps = distance - (own[:, None] + others[None])[..., None]
    return {
        (one.name, other.name): gaps[i, j]
        for i, one in enumerate(capsules)
        for j, other in enumerate(capsules)
    }


def _segments(
    skeleton: Skeleton, points: NDArray, scale: float, capsules: tuple[Capsule, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the ends ``[C, T, 3]`` m of the capsules and their radii ``[C]`` m."""
    start = points[:, [skeleton.index(c.start) for c in capsules]].swapaxes(0, 1)
    end = points[:, [skeleton.index(c.end) for c in capsules]].swapaxes(0, 1)
    return start, end, np.array([c.radius * scale for c in capsules])
