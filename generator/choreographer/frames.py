"""Rotation matrices over time, ``[T, 3, 3]``, and the two-bone limb that joins them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.kinematics import unit
from robots.skeleton import FloatArray


def yaw(angle: ArrayLike) -> FloatArray:
    """Return rotations about z (counterclockwise seen from above), rad."""
    return _about(np.asarray(angle, dtype=float), 0, 1)


def pitch(angle: ArrayLike) -> FloatArray:
    """Return rotations about y (forward, nose down), rad."""
    return _about(np.asarray(angle, dtype=float), 2, 0)


def roll(angle: ArrayLike) -> FloatArray:
    """Return rotations about x (towards the right side), rad."""
    return _about(np.asarray(angle, dtype=float), 1, 2)


def _about(angle: FloatArray, first: int, second: int) -> FloatArray:
    """Return rotations that turn axis ``first`` towards axis ``second``."""
    matrix = np.zeros((*angle.shape, 3, 3))
    third = 3 - first - second
    matrix[..., third, third] = 1.0
    matrix[..., first, first] = matrix[..., second, second] = np.cos(angle)
    matrix[..., second, first] = np.sin(angle)
    matrix[..., first, second] = -np.sin(angle)
    return matrix


def apply(rotation: NDArray, vector: ArrayLike) -> FloatArray:
    """Return vectors ``[T, 3]`` turned by rotations ``[T, 3, 3]``."""
    return np.einsum("tij,tj->ti", rotation, np.broadcast_to(vector, (len(rotation), 3)))


def unapply(rotation: NDArray, vector: ArrayLike) -> FloatArray:
    """Return vectors ``[T, 3]`` turned by the inverse of rotations ``[T, 3, 3]``."""
    return np.einsum("tji,tj->ti", rotation, np.broadcast_to(vector, (len(rotation), 3)))


def dot(a: NDArray, b: NDArray) -> FloatArray:
    """Return the products ``[T]`` of vectors ``[T, 3]``."""
    return np.einsum("ti,ti->t", a, b)


def two_bones(
    start: NDArray,
    end: NDArray,
    pole: NDArray,
    bones: tuple[NDArray, NDArray],
    hinge: ArrayLike,
    tip: float = 1.0,
) -> tuple[FloatArray, FloatArray]:
    """Return the world rotations of the two bones of a limb that spans from start to end.

    **The problem.** Two bones of lengths ``l1`` and ``l2`` span a distance ``d`` in only one shape,
    the triangle of the law of cosines, but the triangle may spin about the line from start to end.
    The pole says to which side the middle points. Each bone's frame is then built from its
    direction and the normal of the triangle, and compared with the same two vectors at rest; so
    the middle bends about its own hinge and nothing else.

    Args:
        start: ``[T, 3]`` m, where the limb hangs.
        end: ``[T, 3]`` m, within reach of the limb.
        pole: ``[T, 3]``, direction to which the middle points; not along the limb.
        bones: Rest offsets of the two bones, m.
        hinge: Rest axis about which the middle bends (upper x lower, when bent).
        tip: Factor by which the lower bone is prolonged to the end (a hand in line with it).
    """
    upper, lower = float(np.linalg.norm(bones[0])), float(np.linalg.norm(bones[1])) * tip
    span = end - start
    distance = np.linalg.norm(span, axis=1)
    along = unit(span)
    aside = unit(pole - along * dot(pole, along)[:, None])
    cosine = (upper**2 + distance**2 - lower**2) / (2 * upper * np.maximum(distance, 1e-9))
    cosine = np.clip(cosine, -1.0, 1.0)[:, None]
    middle = start + upper * (cosine * along + np.sqrt(1 - cosine**2) * aside)
    normal = unit(np.cross(aside, along))
    axis = np.asarray(hinge, dtype=float)
    rotations = []
    for direction, rest in ((middle - start, bones[0]), (end - middle, bones[1])):
        world = _triad(unit(direction), normal)
        local = _triad(unit(rest)[None], axis[None])
        rotations.append(world @ np.swapaxes(local, -1, -2))
    return rotations[0], rotations[1]


def _triad(first: NDArray, second: NDArray) -> FloatArray:
    """Return rotations whose first column is ``first`` and whose second lies nearest ``second``."""
    second = unit(second - first * dot(first, second)[:, None])
    return np.stack([first, second, np.cross(first, second)], axis=-1)
