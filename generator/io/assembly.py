"""From raw points of two people to a :class:`DuetMotion`: axes, unit, plausibility, rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.io.plausible import require_plausible, require_sane
from generator.io.statement import UpAxis
from generator.kinematics import fit_rotations, fit_skeleton, global_rotations
from generator.motion import MAX_FRAMES, DuetMotion, Motion
from robots.errors import MotionFileError
from robots.skeleton import FloatArray, Skeleton, human_skeleton

_Y_UP_TO_Z_UP = (2, 0, 1)
"""World axes of a y-up file in the order (x, y, z) of ours: who faces +z there, faces +x here."""

_MEASURED_FRAMES = 500
"""About so many frames, spread over the motion, are enough to measure directions of bones."""


@dataclass(frozen=True, slots=True, eq=False)
class RawDuet:
    """Two people as a file gives them: its axes, its unit."""

    a: NDArray
    """``[T, 22, 3]``, person a."""
    b: NDArray
    """``[T, 22, 3]``, person b."""
    fps: float
    """Frames per second."""
    up: UpAxis
    """Up axis of the file."""
    scale: float
    """Metres per unit of the file."""
    where: str
    """The file, for errors."""
    source: str
    """Format and file name, kept in the motion."""
    text: str = ""
    """Sentence that describes it, if the file has one."""
    licence: str = ""
    """Licence, if known."""


def to_z_up(points: NDArray, up: UpAxis) -> FloatArray:
    """Return points ``[..., 3]`` in z-up axes."""
    return np.asarray(points, float)[..., _Y_UP_TO_Z_UP] if up == "y" else np.asarray(points, float)


def to_y_up(points: NDArray) -> FloatArray:
    """Return z-up points ``[..., 3]`` in y-up axes; undoes :func:`to_z_up`."""
    return np.asarray(points, float)[..., (1, 2, 0)]


def assemble(raw: RawDuet) -> DuetMotion:
    """Return the motion in the project's frame and unit, with fitted skeletons and rotations.

    The motion itself is not touched: not grounded, smoothed or resampled.

    Raises:
        MotionFileError: The points are damaged or cannot be two people.
    """
    people = []
    for name, points in (("a", raw.a), ("b", raw.b)):
        require_frames(len(points), raw.where)
        require_sane(points, f"{raw.where}, person {name}")
        people.append(to_z_up(points, raw.up) * raw.scale)
    require_plausible((people[0], people[1]), scale=raw.scale, up=raw.up, where=raw.where)
    a, b = (_motion(points, raw.fps) for points in people)
    return DuetMotion(a, b, text=raw.text, source=raw.source, licence=raw.licence)


def require_frames(frames: int, where: str) -> None:
    """Return if a motion may have that many frames.

    Raises:
        MotionFileError: It may not.
    """
    if not 2 <= frames <= MAX_FRAMES:
        raise MotionFileError(f"{frames} frames", where=where, allowed=f"2 to {MAX_FRAMES}")


def same_length(a: NDArray, b: NDArray, where: str) -> tuple[NDArray, NDArray]:
    """Return both people's frames; one surplus frame, as exporters leave it, is cut off.

    Raises:
        MotionFileError: The lengths differ by more than one frame.
    """
    if abs(len(a) - len(b)) > 1:
        raise MotionFileError(
            f"person a has {len(a)} frames, person b {len(b)}",
            where=where,
            allowed="a difference of one frame",
            hint="are these two files of one recording? cut them to the same moments",
        )
    frames = min(len(a), len(b))
    return a[:frames], b[:frames]


def fit_body(points: NDArray) -> tuple[Skeleton, FloatArray]:
    """Return the skeleton of a person and its rotations ``[T, 22, 4]`` from ``points [T, 22, 3]``.

    **The problem.** Rest offsets of the standard skeleton, stretched to a person's bone lengths,
    still have the standard *directions*. Where several bones leave one keypoint (hips and spine
    from the pelvis, neck and collars from the chest) their angles to each other are part of the
    body, and no rotation can make up for a difference. So after a first fit those directions are
    measured, as the mean over time seen from the keypoint's own frame, and the fit is repeated.
    """
    skeleton = fit_skeleton(human_skeleton(), points)
    some = points[:: max(1, len(points) // _MEASURED_FRAMES)]
    frames = global_rotations(skeleton, fit_rotations(skeleton, some))
    offsets = skeleton.offsets.copy()
    parents = list(skeleton.parents)
    for j, parent in enumerate(parents):
        if parent < 0 or parents.count(parent) < 2:
            continue
        mean = frames[parent].inv().apply(some[:, j] - some[:, parent]).mean(axis=0)
        size = np.linalg.norm(mean)
        if size > 1e-6:
            offsets[j] = mean * (skeleton.bone_lengths[j] / size)
    own = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.hand_per_forearm)
    return own, fit_rotations(own, points)


def _motion(points: FloatArray, fps: float) -> Motion:
    skeleton, rotations = fit_body(points)
    return Motion(fps, points, rotations, None, skeleton)
