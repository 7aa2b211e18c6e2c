"""A camera that keeps a duet in the picture: person a on the left, b on the right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from robots.skeleton import FloatArray


@dataclass(frozen=True, slots=True)
class CameraPath:
    """A camera on a dolly: fixed direction and distance, a centre that follows the subjects."""

    centre: FloatArray
    """``[N, 3]`` m, world, the point looked at."""
    azimuth: float
    """Heading of the line of sight, degrees from +x, counter-clockwise."""
    elevation: float
    """Pitch of the line of sight, degrees; negative looks down."""
    distance: float
    """From the camera to the centre, m."""


def follow(
    a: NDArray,
    b: NDArray,
    *,
    fps: float,
    aspect: float = 1.0,
    fovy: float = 45.0,
    turn: float = 18.0,
    elevation: float = -12.0,
) -> CameraPath:
    """Return a camera path that shows both subjects all the time.

    Args:
        a: ``[N, K, 3]`` m, points of subject a.
        b: ``[N, M, 3]`` m, points of subject b.
        fps: Frames per second of N, for how fast the camera may follow.
        aspect: Width over height of the picture.
        fovy: Vertical field of view, degrees.
        turn: How far the view is turned away from straight across, degrees.
        elevation: Pitch of the line of sight, degrees.
    """
    across = (b.mean(axis=1) - a.mean(axis=1)).mean(axis=0)
    azimuth = np.degrees(np.arctan2(across[1], across[0])) + 90.0 - turn
    points = np.concatenate([a, b], axis=1)
    middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
    window = max(int(2 * fps), 1)
    centre = uniform_filter1d(middle, min(window, len(middle)), axis=0, mode="nearest")
    centre[:, 2] = np.median(middle[:, 2])

    spread = points - centre[:, None]
    heading = np.radians(azimuth)
    sight = np.array([np.cos(heading), np.sin(heading)])
    right = np.array([np.sin(heading), -np.cos(heading)])
    wide = np.abs(spread[..., :2] @ right).max()
    high = np.abs(spread[..., 2]).max()
    near = np.abs(spread[..., :2] @ sight).max()
    tangent = np.tan(np.radians(fovy / 2))
    distance = 1.12 * max(high / tangent, wide / (tangent * aspect)) + 0.6 * near
    return CameraPath(centre, float(azimuth), elevation, float(distance))


def still(
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0), *, distance: float = 3.0
) -> CameraPath:
    """Return a camera that stands still for one moment."""
    return CameraPath(np.array([centre]), 90.0, -12.0, distance)
