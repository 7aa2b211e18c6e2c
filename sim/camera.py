"""A camera that keeps a duet in the picture: person a on the left, b on the right."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from robots.skeleton import FloatArray

MARGIN = 1.08
"""How much further away than needed the camera stands."""


@dataclass(frozen=True, slots=True)
class CameraPath:
    """A camera on a dolly: it looks one way, follows the subjects and keeps its distance."""

    centre: FloatArray
    """``[N, 3]`` m, world, the point looked at."""
    distance: FloatArray
    """``[N]`` m, from the camera to the centre."""
    azimuth: float
    """Heading of the line of sight, degrees from +x, counter-clockwise."""
    elevation: float
    """Pitch of the line of sight, degrees; negative looks down."""

    def axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the unit vectors ``[3]`` to the right, up and along the line of sight."""
        heading, pitch = np.radians(self.azimuth), np.radians(self.elevation)
        level = np.array([np.cos(heading), np.sin(heading), 0.0])
        right = np.array([np.sin(heading), -np.cos(heading), 0.0])
        sight = np.cos(pitch) * level + np.array([0.0, 0.0, np.sin(pitch)])
        return right, np.cross(right, sight), sight

    def eye(self, index: int) -> FloatArray:
        """Return where the camera stands ``[3]`` m at a moment."""
        return self.centre[index] - self.distance[index] * self.axes()[2]


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
    azimuth = float(np.degrees(np.arctan2(across[1], across[0])) + 90.0 - turn)
    points = np.concatenate([a, b], axis=1)
    middle = 0.5 * (points.min(axis=1) + points.max(axis=1))
    window = min(max(int(2 * fps), 1), len(middle))
    centre = uniform_filter1d(middle, window, axis=0, mode="nearest")
    centre[:, 2] = np.median(middle[:, 2])

    # A point at height v and depth w off the centre is in the picture from a distance of
    # |v| / tan(fovy / 2) - w on; the widest in a sliding window is kept, so that zooming is slow.
    path = CameraPath(centre, np.zeros(len(centre)), azimuth, elevation)
    right, up, sight = path.axes()
    offset = points - centre[:, None]
    tangent = np.tan(np.radians(fovy / 2))
    needed = np.maximum(np.abs(offset @ up), np.abs(offset @ right) / aspect) / tangent
    widest = (needed - offset @ sight).max(axis=1)
    kept = maximum_filter1d(widest, 2 * window - 1, mode="nearest")
    return replace(path, distance=MARGIN * uniform_filter1d(kept, window, mode="nearest"))


def still(
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0), *, distance: float = 3.0
) -> CameraPath:
    """Return a camera that stands still for one moment."""
    return CameraPath(np.array([centre]), np.array([distance]), 90.0, -12.0)
