"""One recording of two people with its sentences, as training takes it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from generator.features import Poses, from_sixd, poses_of, to_sixd
from generator.motion import DuetMotion
from robots.errors import MotionError
from robots.skeleton import FloatArray


class Symmetric(NamedTuple):
    """Sentences of a clip under its symmetries."""

    mirrored: tuple[str, ...]
    """As seen in a mirror."""
    swapped: tuple[str, ...]
    """With the two people exchanged."""
    both: tuple[str, ...]
    """Mirrored and exchanged."""


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Two people over time, not yet put into place, with what is said of them.

    Raises:
        MotionError: The two differ in length, there is no sentence, or the rate is absurd.
    """

    name: str
    """Identifier within its source, for messages."""
    poses: tuple[Poses, Poses]
    """Person a and person b."""
    fps: float
    """Frames per second."""
    texts: tuple[str, ...] = ("",)
    """Sentences that all describe it."""
    licence: str = ""
    """Licence of the motion; empty if unknown."""
    symmetric: Symmetric | None = None
    """Sentences of the clip as augmentation turns it round, where the source knows them; words are
    exchanged by rule otherwise."""

    def __post_init__(self) -> None:
        """Validate."""
        a, b = self.poses
        if a.frames != b.frames:
            raise MotionError(f"the two have {a.frames} and {b.frames} frames", where=self.name)
        if not self.texts or not all(self.symmetric or self.texts[:0]):
            raise MotionError("there is no sentence", where=self.name)
        if not (np.isfinite(self.fps) and 1 <= self.fps <= 1000):
            raise MotionError(f"{self.fps} frames per second", where=self.name)

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return self.poses[0].frames


class ClipSet(Protocol):
    """Clips that can be asked for by number, in any order and repeatedly."""

    def __len__(self) -> int:
        """Return how many there are."""
        ...

    def clip(self, index: int) -> Clip:
        """Return the clip of a number; the same number gives the same clip."""
        ...


class ClipSource(ClipSet, Protocol):
    """Clips that are read or computed anew at every call."""

    @property
    def name(self) -> str:
        """What it is, in a few words."""
        ...

    @property
    def fingerprint(self) -> str:
        """Text that changes whenever the clips may have changed."""
        ...


def clip_of(motion: DuetMotion, name: str = "") -> Clip:
    """Return a motion as a clip."""
    a, b = (poses_of(person) for person in motion.people)
    return Clip(name or motion.source, (a, b), motion.fps, (motion.text,), motion.licence)


def resampled(clip: Clip, fps: float) -> Clip:
    """Return the clip at another frame rate; at its own rate, itself.

    Positions are interpolated linearly, rotations as well and then made orthonormal, contacts are
    those of the nearest frame. A whole-number ratio picks frames.

    Raises:
        MotionError: Fewer than two frames remain.
    """
    if fps == clip.fps:
        return clip
    step = clip.fps / fps
    count = int(np.floor((clip.frames - 1) / step + 1e-6)) + 1
    if count < 2:
        raise MotionError(f"{clip.frames} frames are too few for {fps:g} per second")
    at = np.minimum(np.arange(count) * step, clip.frames - 1)
    low = np.minimum(at.astype(int), clip.frames - 2)
    share = at - low

    def between(values: NDArray) -> FloatArray:
        weight = share.reshape(-1, *[1] * (values.ndim - 1))
        return values[low] * (1 - weight) + values[low + 1] * weight

    poses = [
        Poses(
            between(person.positions),
            to_sixd(from_sixd(between(person.rotations))),
            None if person.contacts is None else person.contacts[np.rint(at).astype(int)],
        )
        for person in clip.poses
    ]
    return replace(clip, poses=(poses[0], poses[1]), fps=float(fps))
