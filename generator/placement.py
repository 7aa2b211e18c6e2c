"""Where a motion stands: the canonical frame of a first pose, in the y-up world.

A canonical frame has its origin on the floor under the pelvis, and +z where the hips face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray

_LEFT_HIP, _RIGHT_HIP = 1, 2


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a canonical frame stands in the y-up world: undoing it puts a motion back."""

    yaw: float
    """Turn about y that makes the hips of the first frame face +z, rad."""
    root: tuple[float, float, float]
    """What is subtracted before the turn: x and z of the pelvis in the first frame, and the
    height of the floor, m."""

    @property
    def quaternion(self) -> FloatArray:
        """``[4]`` wxyz of the turn."""
        return np.array([np.cos(self.yaw / 2), 0.0, np.sin(self.yaw / 2), 0.0])

    def turn(self, vectors: NDArray) -> FloatArray:
        """Return vectors ``[..., 3]`` as seen in the canonical frame."""
        return turn_about_y(vectors, self.yaw)

    def apply(self, points: NDArray) -> FloatArray:
        """Return world points ``[..., 3]`` m in the canonical frame."""
        return self.turn(np.asarray(points, float) - self.root)

    def undo(self, points: NDArray) -> FloatArray:
        """Return points ``[..., 3]`` m of the canonical frame in the world."""
        return turn_about_y(points, -self.yaw) + self.root

    def seen_from(self, other: Placement) -> FloatArray:
        """Return ``[half angle, x, z]`` of this frame as ``other`` sees it, rad and m.

        The half angle is that of the quaternion ``self * other^-1``; a motion that is canonical
        for its own person is turned by *minus* twice of it and shifted to lie in ``other``.
        """
        half = (self.yaw - other.yaw) / 2
        offset = other.turn(np.subtract(self.root, other.root))
        return np.array([np.arctan2(np.sin(half), np.cos(half)), offset[0], offset[2]])


def turn_about_y(vectors: NDArray, angle: float | NDArray) -> FloatArray:
    """Return vectors ``[..., 3]`` turned about y by ``angle`` rad (broadcast over ``[...]``)."""
    x, y, z = np.moveaxis(np.asarray(vectors, float), -1, 0)
    cos, sin = np.cos(angle), np.sin(angle)
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def facing_yaw(positions: NDArray) -> FloatArray:
    """Return ``[T]`` rad, the turn about y that makes the hips of each pose face +z.

    Hips on one vertical line face nowhere; such a frame gets 0.

    Args:
        positions: ``[T, 22, 3]`` m, y-up.
    """
    across = positions[:, _RIGHT_HIP] - positions[:, _LEFT_HIP]
    # forward = up x across = (across_z, 0, -across_x); the turn takes it to +z.
    return np.arctan2(-across[:, 2], -across[:, 0]) * (np.abs(across[:, ::2]).max(axis=1) > 1e-9)


def placement_of(positions: NDArray, floor: float = 0.0) -> Placement:
    """Return the canonical frame of a person: that of its first pose ``positions [T, 22, 3]`` m."""
    x, _, z = positions[0, 0]
    return Placement(float(facing_yaw(positions[:1])[0]), (float(x), float(floor), float(z)))
