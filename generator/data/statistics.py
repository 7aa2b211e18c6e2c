"""Mean and standard deviation of features, for normalisation."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from generator.architecture import FEATURES
from generator.augment import mirror_poses
from generator.canonical import CANONICAL_FEATURES, to_canonical
from generator.data.clip import ClipSet
from generator.features import lowest, pair_features
from robots.errors import MotionFileError
from robots.files import write_json
from robots.skeleton import FloatArray, read_only

Representation = Literal["non_canonical", "canonical"]

WIDTHS: dict[Representation, int] = {
    "non_canonical": FEATURES,
    "canonical": CANONICAL_FEATURES,
}
"""Numbers per person and frame."""

STD_FLOOR = 0.001
"""Smallest deviation: what never changes is not to be blown up. Displacements of calm motion at 30
frames per second deviate by 0.0015 m and must stay above it."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureStatistics:
    """Statistics of the features of one person; the same for both.

    Raises:
        MotionFileError: The arrays do not fit, or a number is not finite or not positive.
    """

    mean: FloatArray
    """``[F]``."""
    std: FloatArray
    """``[F]``, at least :data:`STD_FLOOR` if measured here."""
    count: int
    """Frames that were measured."""
    representation: Representation = "non_canonical"
    """What the features are."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        if self.representation not in WIDTHS:
            raise MotionFileError(
                f"unknown representation '{self.representation}'", allowed=", ".join(WIDTHS)
            )
        width = WIDTHS[self.representation]
        for name in ("mean", "std"):
            array = np.asarray(getattr(self, name), float)
            if array.shape != (width,) or not np.isfinite(array).all():
                raise MotionFileError(f"'{name}' is not {width} finite numbers")
            object.__setattr__(self, name, read_only(array))
        if self.std.min() <= 0:
            raise MotionFileError("a standard deviation is not positive")

    def normalise(self, features: NDArray) -> FloatArray:
        """Return features ``[..., F]`` or ``[..., 2F]`` with mean 0 and deviation 1."""
        both = features.reshape(*features.shape[:-1], -1, len(self.mean))
        return ((both - self.mean) / self.std).reshape(features.shape)

    def denormalise(self, features: NDArray) -> FloatArray:
        """Return normalised features ``[..., F]`` or ``[..., 2F]`` in metres again."""
        both = features.reshape(*features.shape[:-1], -1, len(self.mean))
        return (both * self.std + self.mean).reshape(features.shape)

    def save(self, path: str | Path) -> None:
        """Write them as JSON, whole or not at all."""
        fields = {"representation": self.representation, "count": self.count}
        lists = {"mean": self.mean.tolist(), "std": self.std.tolist()}
        write_json(path, {**fields, **lists})

    @classmethod
    def load(cls, path: str | Path) -> FeatureStatistics:
        """Return statistics from a file.

        Raises:
            MotionFileError: It cannot be read or holds something else.
        """
        try:
            data = json.loads(Path(path).read_bytes())
            mean, std = (np.array(data[name], float) for name in ("mean", "std"))
            return cls(mean, std, int(data["count"]), data["representation"])
        except MotionFileError as error:
            raise MotionFileError(error.what, where=str(path)) from error
        except OSError as error:
            raise MotionFileError(
                f"cannot be read: {error.strerror or error}", where=str(path)
            ) from error
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise MotionFileError("these are not statistics", where=str(path)) from error


class RunningStatistics:
    """Mean and deviation of rows that arrive in blocks (Welford's method, by Chan et al.)."""

    def __init__(self, width: int) -> None:
        """Start with no rows."""
        self.count = 0
        self._mean = np.zeros(width)
        self._squares = np.zeros(width)

    def add(self, rows: NDArray) -> None:
        """Take in rows ``[N, width]``."""
        if not len(rows):
            return
        mean = rows.mean(axis=0)
        shift = mean - self._mean
        total = self.count + len(rows)
        self._squares += ((rows - mean) ** 2).sum(axis=0)
        self._squares += shift**2 * (self.count * len(rows) / total)
        self._mean += shift * (len(rows) / total)
        self.count = total

    def result(self, representation: Representation) -> FeatureStatistics:
        """Return the statistics so far.

        Raises:
            ValueError: There were no rows.
        """
        if not self.count:
            raise ValueError("no rows were added")
        std = np.maximum(np.sqrt(self._squares / self.count), STD_FLOOR)
        return FeatureStatistics(self._mean.copy(), std, self.count, representation)


def measure(
    clips: ClipSet | Iterable[ClipSet],
    *,
    frames: int = 300,
    representation: Representation = "non_canonical",
    release_compat: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> FeatureStatistics:
    """Return the statistics of the features of clips, as augmentation will present them.

    Each clip counts as seen from either person and with its mirror image, so the mean is left-right
    symmetric. Long clips are cut into pieces of at most ``frames`` features, each put into place by
    itself, as crops are.

    Args:
        clips: One set, or several.
        frames: Longest piece, in feature frames.
        representation: What is measured.
        release_compat: As in :func:`generator.features.pair_features`.
        progress: Called with the number of clips done and their total.
    """
    sets = list(clips) if isinstance(clips, Iterable) else [clips]
    running = RunningStatistics(WIDTHS[representation])
    total, done = sum(map(len, sets)), 0
    for group in sets:
        for index in range(len(group)):
            for block in _blocks(group, index, frames, representation, release_compat):
                running.add(block)
            done += 1
            if progress is not None:
                progress(done, total)
    return running.result(representation)


def _blocks(
    clips: ClipSet, index: int, frames: int, representation: Representation, release_compat: bool
) -> Iterator[FloatArray]:
    clip = clips.clip(index)
    floor = lowest(*clip.poses)
    for start in range(0, clip.frames - 1, frames):
        pair = [person.cut(start, start + frames + 1) for person in clip.poses]
        for people in (pair, [mirror_poses(person) for person in pair]):
            for canonical in (0, 1):
                rows = pair_features(
                    people,
                    clip.fps,
                    canonical=canonical,
                    floor=floor,
                    release_compat=release_compat,
                )
                if representation == "canonical":
                    rows = to_canonical(rows)
                yield rows.reshape(-1, rows.shape[-1])
