"""What is given of a motion that is to be generated (Sec. 5.4): one person, paths, or both ends.

A :class:`Given` says which features are known and what they are. :mod:`generator.applications`
draws the rest. Torch-free.

**Where the pair stands.** Features start in a canonical frame: under one person's pelvis, facing
where its hips face. So a placement comes with what is given, and the result is put back by it:
keypoints that were given come out where they were, in the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from generator.architecture import FEATURES
from generator.data.clip import clip_of, resampled
from generator.features import (
    LOCAL_ROTATIONS,
    POINTS,
    Placement,
    Poses,
    lowest,
    person_features,
    placement_of,
)
from generator.motion import DuetMotion
from robots.errors import MotionError
from robots.skeleton import FloatArray, read_only

Person = Literal["a", "b"]
PEOPLE: tuple[Person, Person] = ("a", "b")

PELVIS_GROUND = (0, 2)
"""Features of the pelvis' place on the ground: x and z of the first keypoint, m."""
PELVIS_STEP = (3 * POINTS, 3 * POINTS + 2)
"""Features of its displacement on the ground, m per frame."""
TRAJECTORY = (*PELVIS_GROUND, *PELVIS_STEP)
"""Features that the path of a person decides."""

_FACING_SECONDS = 0.5
"""A path without a facing faces where it leads within this time, s."""
_STANDING = 0.1
"""A path that leads less far than this within it does not show a facing, m."""


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """Known features, and where the pair stands.

    Raises:
        MotionError: The arrays do not fit together, or a known feature is not finite.
    """

    values: FloatArray
    """``[T, 2, 262]`` features in metres; 0 where nothing is known."""
    known: NDArray[np.bool_]
    """``[T, 2, 262]``, which of them are known."""
    placement: Placement
    """Where the canonical frame stands."""
    paths: tuple[bool, bool] = (False, False)
    """Whether only the path of a person is given: its whole body is moved along with its pelvis."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        known = read_only(self.known, np.bool_)
        if known.ndim != 3 or known.shape[1:] != (2, FEATURES):
            raise MotionError(f"shape {known.shape}", allowed=f"(frames, 2, {FEATURES})")
        values = np.where(known, self.values, 0.0)
        if not np.isfinite(values).all():
            raise MotionError("what is given is not finite")
        object.__setattr__(self, "known", known)
        object.__setattr__(self, "values", read_only(values))

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return len(self.values)


def given_person(motion: DuetMotion, person: Person, fps: float) -> Given:
    """Return what is known if one person of a motion is given: all of that person.

    Args:
        motion: Where the person comes from; the other one in it is not looked at.
        person: Who.
        fps: Frames per second of the features; another rate is brought to it.

    Raises:
        MotionError: Fewer than two frames remain at that rate.
    """
    pair = _pair(motion, fps)
    at = PEOPLE.index(person)
    poses = pair[at]
    placement = placement_of(poses.positions, lowest(poses))
    values = np.zeros((poses.frames, 2, FEATURES))
    values[:, at] = person_features(_extended(poses), placement, fps)
    known = np.zeros(values.shape, bool)
    known[:, at] = True
    return Given(values, known, placement)


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where the pelvis of a person is above the ground over time.

    Raises:
        MotionError: The arrays do not fit, are not finite, or time does not increase.
    """

    times: FloatArray
    """``[N]`` s, strictly increasing."""
    points: FloatArray
    """``[N, 2]`` m, x and y in the project's z-up world."""
    facing: float | None = None
    """Where the hips face at the start, rad from x towards y; ``None``: where the path leads."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        times, points = (read_only(x) for x in (self.times, self.points))
        if len(times) < 2 or times.ndim != 1 or points.shape != (len(times), 2):
            raise MotionError(
                f"times {times.shape} and points {points.shape}", allowed="(N,) and (N, 2), N >= 2"
            )
        if not (np.isfinite(times).all() and np.isfinite(points).all()):
            raise MotionError("a path is not finite")
        if not (np.diff(times) > 0).all():
            raise MotionError("times of a path do not increase")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "points", points)

    def at(self, frames: int, fps: float) -> FloatArray:
        """Return ``[frames, 2]`` m, linear between points and at rest beyond the ends."""
        times = self.times[0] + np.arange(frames) / fps
        return np.stack([np.interp(times, self.times, axis) for axis in self.points.T], axis=1)

    @property
    def duration(self) -> float:
        """Time from the first point to the last, s."""
        return float(self.times[-1] - self.times[0])


def track_of(motion: DuetMotion, person: Person) -> Track:
    """Return the path and the first facing of a person of a motion."""
    points = motion.people[PEOPLE.index(person)].keypoints
    skeleton = motion.a.skeleton
    across = points[0, skeleton.index("left_hip")] - points[0, skeleton.index("right_hip")]
    facing = float(np.arctan2(-across[0], across[1]))
    times = np.arange(len(points)) / motion.fps
    return Track(times, points[:, 0, :2], facing)


def given_tracks(tracks: tuple[Track | None, Track | None], frames: int, fps: float) -> Given:
    """Return what is known if the paths of one or both people are given.

    Raises:
        MotionError: No path is given, or there are fewer than two frames.
    """
    if tracks == (None, None) or frames < 2:
        raise MotionError("trajectory control needs a path and two frames or more")
    points = [None if track is None else track.at(frames, fps) for track in tracks]
    placement = _track_placement(tracks, points, fps)
    values, known = np.zeros((frames, 2, FEATURES)), np.zeros((frames, 2, FEATURES), bool)
    for at, line in enumerate(points):
        if line is None:
            continue
        # z-up (x, y) is y-up (z, x): the permutation of generator.features.
        world = np.stack([line[:, 1], np.zeros(frames), line[:, 0]], axis=-1)
        ground = placement.apply(world)[:, ::2]
        steps = np.diff(ground, axis=0, append=ground[-1:])
        values[:, at, TRAJECTORY] = np.concatenate([ground, steps], axis=1)
        known[:, at, TRAJECTORY] = True
    return Given(values, known, placement, (tracks[0] is not None, tracks[1] is not None))


def _track_placement(
    tracks: tuple[Track | None, Track | None], points: Sequence[FloatArray | None], fps: float
) -> Placement:
    """Return the frame of the leading person, a if it has a path.

    It faces where its track says; else where the path leads; else, if that leads nowhere, towards
    the other person.
    """
    lead = 0 if tracks[0] is not None else 1
    track, line, other = tracks[lead], points[lead], points[1 - lead]
    if track is None or line is None:
        raise MotionError("there is no path")
    facing = track.facing
    if facing is None:
        ahead = line[min(len(line) - 1, max(1, round(_FACING_SECONDS * fps)))] - line[0]
        if np.hypot(*ahead) < _STANDING and other is not None:
            ahead = other[0] - line[0]
        facing = float(np.arctan2(ahead[1], ahead[0])) if np.hypot(*ahead) > 1e-6 else 0.0
    # Facing +x of the z-up world is +z of the y-up one; the turn takes it there.
    x, y = line[0]
    return Placement(-facing, (float(y), 0.0, float(x)))


def given_ends(start: DuetMotion | None, end: DuetMotion | None, frames: int, fps: float) -> Given:
    """Return what is known if the first and the last part of a motion are given.

    Both stand where they stand in their files. The frame is that of person a at the start.

    Args:
        start: How it begins, or nothing.
        end: How it ends, or nothing.
        frames: Length of the whole.
        fps: Frames per second of the whole.

    Raises:
        MotionError: Nothing is given, or no frame is left between the two.
    """
    pairs = [None if motion is None else _pair(motion, fps) for motion in (start, end)]
    first = pairs[0] or pairs[1]
    if first is None:
        raise MotionError("in-betweening needs a start or an end")
    taken = sum(pair[0].frames for pair in pairs if pair is not None)
    if taken >= frames:
        raise MotionError(
            f"the ends take {taken} of {frames} frames", hint="ask for more with --frames"
        )
    people = [person for pair in pairs if pair is not None for person in pair]
    placement = placement_of(first[0].positions, lowest(*people))
    values, known = np.zeros((frames, 2, FEATURES)), np.zeros((frames, 2, FEATURES), bool)
    for pair, at_end in zip(pairs, (False, True), strict=True):
        if pair is None:
            continue
        count = pair[0].frames
        rows = slice(frames - count, frames) if at_end else slice(0, count)
        both = [person_features(_extended(person), placement, fps) for person in pair]
        values[rows] = np.stack(both, axis=1)
        known[rows] = True
    if pairs[0] is not None:
        # The step out of the start is not known: it leads to the first generated frame.
        known[pairs[0][0].frames - 1, :, 3 * POINTS : 6 * POINTS] = False
    return Given(values, known, placement)


def cut_motion(motion: DuetMotion, start: float | None, end: float | None) -> DuetMotion:
    """Return the part of a motion from ``start`` to ``end`` s, both included; ``None``: no cut.

    Raises:
        MotionError: Fewer than two frames lie between.
    """
    first = 0 if start is None else max(0, round(start * motion.fps))
    last = motion.frames - 1 if end is None else min(motion.frames - 1, round(end * motion.fps))
    if last - first < 1:
        raise MotionError(
            f"from {start or 0:g} s to {'the end' if end is None else f'{end:g} s'} there are not"
            " two frames",
            allowed=f"0 to {motion.duration:g} s",
        )

    def cut(array: NDArray | None) -> NDArray | None:
        return None if array is None else array[first : last + 1]

    people = [
        replace(
            person,
            keypoints=person.keypoints[first : last + 1],
            rotations=cut(person.rotations),
            foot_contacts=cut(person.foot_contacts),
        )
        for person in motion.people
    ]
    return replace(motion, a=people[0], b=people[1], contacts=())


def _pair(motion: DuetMotion, fps: float) -> tuple[Poses, Poses]:
    return resampled(clip_of(motion), fps).poses


def _extended(poses: Poses) -> Poses:
    """Return poses with one more frame that goes on as the last one moved.

    Features have a displacement to the next frame, so the last frame of a motion is dropped when it
    is encoded; a frame that is given must not be.
    """
    points = poses.positions
    more = 2 * points[-1:] - points[-2:-1]
    rotations = poses.rotations[[*range(poses.frames), -1]]
    contacts = None if poses.contacts is None else poses.contacts[[*range(poses.frames), -1]]
    if rotations.shape[1:] != (LOCAL_ROTATIONS, 6):
        raise MotionError(f"rotations have shape {rotations.shape}")
    return Poses(np.concatenate([points, more]), rotations, contacts)
