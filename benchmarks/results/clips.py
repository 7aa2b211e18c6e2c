"""The duets that everything is asked for: held-out performances with sentences and labels.

A set is kept in chunks, each an archive that appears whole or not at all: the features that a
network at the benchmark's rate would see, the sentences, who leads, which points are meant to
touch, and the figures of the performance itself at its own frame rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.results import figures, spectra
from benchmarks.results.chunks import Chunk, keep_chunk, kept_chunk, key_of
from benchmarks.results.figures import Touch, measured
from generator.choreographer import Style
from generator.data import Choreographed, clip_of, resampled
from generator.data.choreographed import Split
from generator.features import lowest, pair_features
from generator.motion import LEFT_HAND, RIGHT_HAND, DuetMotion
from robots.files import sha256

HANDS = (LEFT_HAND, RIGHT_HAND)
SEED = 1_000_003
"""Of the held-out performances; training draws other seeds."""


@dataclass(frozen=True, slots=True)
class Asked:
    """What a generator is asked for, and what tells whether it was done."""

    number: int
    """Within its set."""
    texts: tuple[str, ...]
    """Sentences that all describe the performance."""
    frames: int
    """Feature frames of the performance at the benchmark's rate, after cutting."""
    interaction: str
    """What is done."""
    style: Style
    """In which manner, and who leads."""
    touches: tuple[Touch, ...]
    """Pairs of hands that meet in the performance."""

    @property
    def second_leads(self) -> bool:
        """Whether person b has the leading role."""
        return self.style.swap

    def text(self, repetition: int) -> str:
        """Return the sentence of a repetition: they take turns."""
        return self.texts[repetition % len(self.texts)]


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A set by its name and size; the clips are made when they are asked for.

    The same number is the same clip whatever the size, so a larger set begins with a smaller one.
    """

    split: Split
    """Which kind of performances (:data:`generator.data.choreographed.SPLITS`)."""
    fps: float
    """Rate of the features."""
    frames: int
    """Longest clip; longer performances are cut at a place that depends on their number."""
    root: Path
    """Folder in which chunks are kept."""
    size: int
    """Clips in a chunk."""
    seed: int = SEED
    """Decides all clips."""

    def chunk(self, number: int) -> tuple[list[Asked], Chunk]:
        """Return what the clips of a chunk ask for and the performances, made now if need be.

        Raises:
            MotionFileError: The chunk cannot be written.
        """
        source = Choreographed((number + 1) * self.size, seed=self.seed, split=self.split)
        key = key_of("clips/1", source.fingerprint, self.fps, self.frames, _code())
        path = self.root / f"{self.split}-{self.seed}" / f"{self.size}-{number:03d}.npz"
        chunk = kept_chunk(path, key)
        if chunk is None:
            chunk = self._made(source, number)
            keep_chunk(path, key, chunk)
        return [_asked(entry) for entry in chunk.notes["clips"]], chunk

    def _made(self, source: Choreographed, number: int) -> Chunk:
        clips, features, rows, powers = [], [], [], []
        for index in range(number * self.size, (number + 1) * self.size):
            done = source.performance(index)
            touches = hands_that_meet(done.motion)
            cut = features_of(done.motion, self.fps, self.frames, (self.seed, index))
            row, power = measured(done.motion, touches)
            features.append(cut)
            rows.append(row)
            powers.append(power)
            clips.append(
                {
                    "number": index,
                    "texts": list(done.texts),
                    "frames": len(cut),
                    "interaction": done.motion.interaction,
                    "style": asdict(done.style),
                    "touches": [list(pair) for pair in touches],
                }
            )
        return Chunk(features, rows, powers, {"clips": clips})


def features_of(
    motion: DuetMotion, fps: float, frames: int, seed: Sequence[int]
) -> NDArray[np.float32]:
    """Return features ``[T, 524]`` of a motion at another rate, the frame put on person a.

    Args:
        motion: Two people.
        fps: Frames per second of the features.
        frames: Most of them; longer motions are cut.
        seed: Decides where.
    """
    clip = resampled(clip_of(motion), fps)
    room = max(clip.frames - frames - 1, 0)
    start = int(np.random.default_rng(list(seed)).integers(room + 1))
    pair = [person.cut(start, start + frames + 1) for person in clip.poses]
    made = pair_features(pair, fps, canonical=0, floor=lowest(*clip.poses))
    return made.reshape(len(made), -1).astype(np.float32)


def _code() -> str:
    """Return a hash of the files that turn a performance into features and figures."""
    names = (__file__, figures.__file__, spectra.__file__)
    return key_of([sha256(name) for name in names])


def hands_that_meet(motion: DuetMotion) -> tuple[Touch, ...]:
    """Return the pairs of hands, each once, that a motion labels as touching."""
    pairs = [(c.a, c.b, c.gap) for c in motion.contacts if c.a in HANDS and c.b in HANDS]
    return tuple(dict.fromkeys(pairs))


def _asked(entry: dict[str, Any]) -> Asked:
    return Asked(
        number=entry["number"],
        texts=tuple(entry["texts"]),
        frames=entry["frames"],
        interaction=entry["interaction"],
        style=Style(**entry["style"]),
        touches=tuple((a, b, gap) for a, b, gap in entry["touches"]),
    )
