"""The types that carry human motion: :class:`Motion` for one person, :class:`DuetMotion` for two.

World frame: right-handed, z up, metres. Quaternions are ``wxyz``. Torch-free.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robots.errors import MotionError
from robots.skeleton import FloatArray, Skeleton, human_skeleton, read_only

MAX_FRAMES = 100_000
"""Longest motion that is accepted."""

CONTACT_POINTS = ("left_ankle", "left_foot", "right_ankle", "right_foot")
"""Keypoints whose ground contact :attr:`Motion.foot_contacts` labels, in this order."""

LEFT_HAND = "left_hand"
RIGHT_HAND = "right_hand"


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion of one person.

    Raises:
        MotionError: A shape does not fit, a number is not finite, or the frame rate is absurd.
    """

    fps: float
    """Frames per second."""
    keypoints: FloatArray
    """``[T, 22, 3]`` m, world frame, z up."""
    rotations: FloatArray | None = None
    """``[T, 22, 4]`` wxyz: index 0 takes the rest frame to the world, the others are local to the
    parent (see :mod:`generator.kinematics`). ``None`` where the source has positions only."""
    foot_contacts: NDArray[np.bool_] | None = None
    """``[T, 4]``, which of :data:`CONTACT_POINTS` stand on the floor. ``None`` if not labelled."""
    skeleton: Skeleton = field(default_factory=human_skeleton)
    """Names, parents and rest offsets; its bone lengths are those of this person."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        points = np.asarray(self.keypoints)
        count = len(self.skeleton)
        if points.ndim != 3 or points.shape[1:] != (count, 3):
            raise MotionError(
                f"keypoints have shape {points.shape}", allowed=f"(frames, {count}, 3)"
            )
        frames = len(points)
        if not 2 <= frames <= MAX_FRAMES:
            raise MotionError(f"{frames} frames", allowed=f"2 to {MAX_FRAMES}")
        if not (np.isfinite(self.fps) and 1 <= self.fps <= 1000):
            raise MotionError(f"{self.fps} frames per second", allowed="1 to 1000")
        _require_finite(points, "keypoints")
        object.__setattr__(self, "fps", float(self.fps))
        object.__setattr__(self, "keypoints", read_only(points))
        if self.rotations is not None:
            rotations = np.asarray(self.rotations)
            if rotations.shape != (frames, count, 4):
                raise MotionError(
                    f"rotations have shape {rotations.shape}", allowed=f"({frames}, {count}, 4)"
                )
            _require_finite(rotations, "rotations")
            if np.abs(np.linalg.norm(rotations, axis=-1) - 1).max() > 1e-3:
                raise MotionError("rotations are not unit quaternions")
            object.__setattr__(self, "rotations", read_only(rotations))
        if self.foot_contacts is not None:
            contacts = np.asarray(self.foot_contacts)
            if contacts.shape != (frames, len(CONTACT_POINTS)):
                raise MotionError(
                    f"foot contacts have shape {contacts.shape}", allowed=f"({frames}, 4)"
                )
            object.__setattr__(self, "foot_contacts", read_only(contacts, np.bool_))

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return len(self.keypoints)

    @property
    def times(self) -> FloatArray:
        """``[T]`` s, from 0."""
        return np.arange(self.frames) / self.fps

    def point(self, name: str) -> FloatArray:
        """Return the path ``[T, 3]`` m of a keypoint, or of ``left_hand`` / ``right_hand``.

        A hand is the middle knuckle: the wrist, continued along the forearm by
        :attr:`Skeleton.hand_per_forearm` of its length.

        Raises:
            SpecError: There is no such point.
        """
        if name in (LEFT_HAND, RIGHT_HAND):
            side = name.removesuffix("_hand")
            elbow, wrist = self.point(f"{side}_elbow"), self.point(f"{side}_wrist")
            return wrist + (wrist - elbow) * self.skeleton.hand_per_forearm
        return self.keypoints[:, self.skeleton.index(name)]


def _require_finite(array: NDArray, what: str) -> None:
    bad = ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
    if bad.any():
        raise MotionError(
            f"{what} are not finite in frame {int(np.argmax(bad))}",
            hint="repair or cut the motion there",
        )


@dataclass(frozen=True, slots=True)
class Contact:
    """A window in which a point of ``a`` is meant to touch a point of ``b``."""

    a: str
    """Point of person a: a keypoint name, ``left_hand`` or ``right_hand``."""
    b: str
    """Point of person b."""
    start: float
    """First moment of touch, s."""
    end: float
    """Last moment of touch, s."""
    gap: float = 0.0
    """Intended distance between the two points while they touch, m."""


@dataclass(frozen=True, slots=True, eq=False)
class DuetMotion:
    """The motion of two people in one world frame and on one clock.

    Raises:
        MotionError: The two differ in frame rate or length.
    """

    a: Motion
    """Person a."""
    b: Motion
    """Person b."""
    text: str = ""
    """The sentence it was made from, or a description; may be empty."""
    seed: int | None = None
    """Seed of the generator, if generated."""
    source: str = ""
    """Where it comes from: a generator with its version, or a file."""
    licence: str = ""
    """Licence of the motion; travels with every copy. Empty if unknown."""
    contacts: tuple[Contact, ...] = ()
    """Intended touches between the two, if the source labels them."""
    interaction: str = ""
    """Name of the interaction from the generator's repertoire; empty if not from one."""
    kind: Literal["reference", "simulated"] = "reference"
    """Whether this was dreamt or captured, or came out of the physics."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.a.fps != self.b.fps:
            raise MotionError(f"person a has {self.a.fps} frames per second, b {self.b.fps}")
        if self.a.frames != self.b.frames:
            raise MotionError(f"person a has {self.a.frames} frames, b {self.b.frames}")

    @property
    def fps(self) -> float:
        """Frames per second of both."""
        return self.a.fps

    @property
    def frames(self) -> int:
        """Number of frames T of both."""
        return self.a.frames

    @property
    def duration(self) -> float:
        """Time from the first frame to the last, s."""
        return (self.frames - 1) / self.fps

    @property
    def people(self) -> tuple[Motion, Motion]:
        """``(a, b)``."""
        return (self.a, self.b)

    @property
    def keypoints(self) -> FloatArray:
        """``[T, 2, 22, 3]`` m, both people."""
        return np.stack([self.a.keypoints, self.b.keypoints], axis=1)

    def gap(self, contact: Contact) -> FloatArray:
        """Return the distance ``[T]`` m between the two points of a contact."""
        return np.linalg.norm(self.a.point(contact.a) - self.b.point(contact.b), axis=1)
