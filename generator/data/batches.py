"""Batches for training: drawn, cut, augmented and padded, each a function of its number.

**The problem.** Training must be able to stop anywhere and go on as if it had not, on another
number of processes if need be, without replaying what it drew before. So nothing here has a state:
sample ``g`` (counted from the start of training) depends on the seed and on ``g`` alone, and batch
``s`` holds samples ``s * size`` up to ``(s + 1) * size``. Within an epoch every set gives its share
of samples; over epochs each walks through its own permutations, so that no clip comes a second time
before all others of its set came once.

**Buckets.** A batch is as long as its longest clip, and what is padded is computed in vain: a
third of all frames where clips have 50 to 150. With ``bucket`` above 1, the samples of so many
batches are dealt out by length instead of by number; which these are depends on numbers alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, cast

import numpy as np
from numpy.typing import NDArray

from generator.augment import mirror_poses, mirror_text, swap_text
from generator.canonical import to_canonical
from generator.data.cache import ClipCache
from generator.data.clip import Clip, ClipSet
from generator.data.statistics import WIDTHS, Representation
from generator.features import lowest, pair_features
from robots.errors import MotionError, SpecError
from robots.skeleton import FloatArray


@dataclass(frozen=True, slots=True)
class BatchConfig:
    """How batches are made.

    Raises:
        SpecError: A number is out of range.
    """

    size: int = 64
    """Clips per batch, over all processes."""
    frames: int = 300
    """Feature frames per clip; longer clips are cut at a random place, shorter ones padded."""
    shortest: int = 15
    """Frames below which a clip is left out."""
    mirror: bool = True
    """Mirror half of the samples."""
    swap: bool = True
    """Exchange the people of half of the samples, and put the frame on either."""
    frame: Literal["either", "first"] = "either"
    """On whom the frame is put if people are exchanged: on either at random, or on the first."""
    pad: Literal["full", "longest"] = "full"
    """Length of a batch: always ``frames``, or that of its longest clip."""
    bucket: int = 1
    """Batches among which samples are dealt out by length."""
    representation: Representation = "non_canonical"
    """Which features."""
    release_compat: bool = False
    """Cut ``frames`` poses (one feature frame fewer), measure a floor per person and crop, derive
    the contacts from thresholds, and treat sentences as the public release does."""
    seed: int = 0
    """Decides everything that is drawn."""

    def __post_init__(self) -> None:
        """Validate."""
        lowest = (("size", 1), ("frames", 2), ("shortest", 2), ("seed", 0), ("bucket", 1))
        for name, low in lowest:
            if getattr(self, name) < low:
                raise SpecError(f"{getattr(self, name)}", where=name, allowed=f"{low} or more")
        choices = {"pad": ("full", "longest"), "frame": ("either", "first")}
        for name, allowed in {**choices, "representation": tuple(WIDTHS)}.items():
            if getattr(self, name) not in allowed:
                raise SpecError(f"'{getattr(self, name)}'", where=name, allowed=", ".join(allowed))


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Samples side by side."""

    x_raw: NDArray[np.float32]
    """``[B, T, 2F]`` features, person a first, not normalised; 0 where there is no frame."""
    mask: NDArray[np.float32]
    """``[B, T]``, 1 where there is a frame."""
    lengths: NDArray[np.int64]
    """``[B]`` frames of each sample."""
    texts: tuple[str, ...]
    """A sentence for each sample."""
    names: tuple[str, ...]
    """The clip of each sample."""

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.lengths)


class BatchStream:
    """An endless stream of batches from one or several sets of clips."""

    def __init__(
        self,
        sets: ClipSet | Sequence[tuple[ClipSet, float]],
        config: BatchConfig | None = None,
        *,
        epoch: int | None = None,
    ) -> None:
        """Prepare to draw.

        Args:
            sets: One set of clips, or several with their weights: shares of the samples.
            config: How batches are made.
            epoch: Samples per epoch; as many as there are usable clips by default.

        Raises:
            SpecError: There are no sets or usable clips, a weight is not positive, or the sets
                differ in frame rate.
        """
        self.config = config or BatchConfig()
        pairs = list(sets) if isinstance(sets, Sequence) else [(cast(ClipSet, sets), 1.0)]
        if not pairs or any(not (weight > 0 and np.isfinite(weight)) for _, weight in pairs):
            raise SpecError("sets of clips need positive weights", where="mixture")
        self._sets = [clips for clips, _ in pairs]
        rates = {clips.fps for clips in self._sets if isinstance(clips, ClipCache)}
        if len(rates) > 1:
            raise SpecError(
                f"sets of {' and '.join(f'{rate:g}' for rate in sorted(rates))} frames per second",
                where="mixture",
                hint="cache them at one rate",
            )
        self._usable = [self._usable_clips(clips) for clips in self._sets]
        self.epoch = sum(map(len, self._usable)) if epoch is None else epoch
        if self.epoch < 1:
            raise SpecError(f"{self.epoch} samples", where="epoch", allowed="1 or more")
        self._shares = _shares([weight for _, weight in pairs], self.epoch)
        self._draws = lru_cache(maxsize=2)(self._drawn)
        self._dealt = lru_cache(maxsize=2)(self._dealt_out)
        self._orders = lru_cache(maxsize=4 * len(pairs))(self._order)

    @property
    def steps_per_epoch(self) -> int:
        """Batches in which an epoch is seen (the last one reaches into the next)."""
        return -(-self.epoch // self.config.size)

    def batch(self, step: int, *, rank: int = 0, world: int = 1) -> Batch:
        """Return batch number ``step``, counted from the start of training.

        Args:
            step: From 0; batches can be asked for in any order.
            rank: Number of this process among ``world``.
            world: Processes that share the batch; must divide its size.

        Raises:
            SpecError: The batch cannot be shared so.
            MotionFileError: A clip cannot be read.
        """
        size = self.config.size
        if size % world or not 0 <= rank < world:
            raise SpecError(f"process {rank} of {world}", where="world", allowed=f"{size} / world")
        share = size // world
        numbers = self._numbers(step)[rank * share : (rank + 1) * share]
        return self._collate([self.sample(g) for g in numbers])

    def _numbers(self, step: int) -> Sequence[int]:
        """Return the numbers of the samples of a batch."""
        size, bucket = self.config.size, self.config.bucket
        if bucket == 1:
            return range(step * size, (step + 1) * size)
        return self._dealt(step // bucket)[step % bucket]

    def _dealt_out(self, window: int) -> list[list[int]]:
        """Return the samples of ``bucket`` batches, each of samples of about the same length."""
        size, bucket = self.config.size, self.config.bucket
        first = window * bucket * size
        numbers = np.arange(first, first + bucket * size)
        lengths = [min(self._length(int(g)), self.config.frames + 1) for g in numbers]
        sorted_numbers = numbers[np.argsort(lengths, kind="stable")].reshape(bucket, size)
        order = np.random.default_rng([self.config.seed, 5, window]).permutation(bucket)
        return [sorted_numbers[i].tolist() for i in order]

    def _length(self, number: int) -> int:
        """Return the frames of the clip of a sample."""
        epoch, slot = divmod(number, self.epoch)
        group, index = self._draws(epoch)[slot]
        clips = self._sets[group]
        return clips.lengths[index] if isinstance(clips, ClipCache) else clips.clip(index).frames

    def batches(self, start: int = 0, *, rank: int = 0, world: int = 1) -> Iterator[Batch]:
        """Yield batches without end, from number ``start`` on: to resume is to start there."""
        step = start
        while True:
            yield self.batch(step, rank=rank, world=world)
            step += 1

    def sample(self, number: int) -> tuple[FloatArray, str, str]:
        """Return features ``[T, 2F]``, a sentence and the clip's name of sample ``number``."""
        epoch, slot = divmod(number, self.epoch)
        group, index = self._draws(epoch)[slot]
        rng = np.random.default_rng([self.config.seed, 2, epoch, slot])
        clip = self._sets[group].clip(index)
        if clip.frames < self.config.shortest:
            raise MotionError(
                f"{clip.frames} frames",
                where=clip.name,
                allowed=f"{self.config.shortest} or more",
                hint="cache the source: short clips are left out of a cache",
            )
        features, text = self._augmented(clip, rng)
        return features, text, clip.name

    def _augmented(self, clip: Clip, rng: np.random.Generator) -> tuple[FloatArray, str]:
        config = self.config
        poses = config.frames + (0 if config.release_compat else 1)
        start = int(rng.integers(max(clip.frames - poses, 0) + 1))
        drawn = int(rng.integers(len(clip.texts)))
        allowed = (config.mirror, config.swap, config.swap and config.frame == "either")
        mirror, swap, canonical = (rng.random(3) < 0.5) & allowed
        floor = lowest(*clip.poses)
        pair = [person.cut(start, start + poses) for person in clip.poses]
        if mirror:
            pair = [mirror_poses(person) for person in pair]
        if swap:
            pair = pair[::-1]
        text = self._text(clip, drawn, bool(mirror), bool(swap))
        features = pair_features(
            pair,
            clip.fps,
            canonical=1 if canonical else 0,
            floor=floor,
            release_compat=config.release_compat,
        )
        if config.representation == "canonical":
            features = to_canonical(features)
        return features.reshape(len(features), -1), text

    def _text(self, clip: Clip, drawn: int, mirror: bool, swap: bool) -> str:
        """Return a sentence of a clip that was turned round so."""
        compat = self.config.release_compat
        if clip.symmetric is not None and (mirror or swap):
            texts = clip.symmetric[mirror + 2 * swap - 1]
            return texts[drawn % len(texts)]
        text = clip.texts[drawn]
        text = mirror_text(text, release_compat=compat) if mirror else text
        return swap_text(text) if swap and not compat else text

    def _collate(self, samples: list[tuple[FloatArray, str, str]]) -> Batch:
        lengths = np.array([len(features) for features, _, _ in samples], np.int64)
        rows = self.config.frames if self.config.pad == "full" else int(lengths.max())
        width = 2 * WIDTHS[self.config.representation]
        x = np.zeros((len(samples), rows, width), np.float32)
        for row, (features, _, _) in zip(x, samples, strict=True):
            row[: len(features)] = features
        mask = (np.arange(rows) < lengths[:, None]).astype(np.float32)
        texts = tuple(text for _, text, _ in samples)
        return Batch(x, mask, lengths, texts, tuple(name for _, _, name in samples))

    def _usable_clips(self, clips: ClipSet) -> NDArray[np.int64]:
        indices = np.arange(len(clips))
        if isinstance(clips, ClipCache):
            indices = indices[np.asarray(clips.lengths) >= self.config.shortest]
        if not len(indices):
            raise SpecError(
                f"none of {len(clips)} clips has {self.config.shortest} frames", where="mixture"
            )
        return indices

    def _drawn(self, epoch: int) -> list[tuple[int, int]]:
        """Return the set and the clip of every slot of an epoch."""
        slots: list[tuple[int, int]] = []
        for group, share in enumerate(self._shares):
            usable = self._usable[group]
            for place in range(epoch * share, (epoch + 1) * share):
                lap, at = divmod(place, len(usable))
                slots.append((group, int(usable[self._orders(group, lap)[at]])))
        order = np.random.default_rng([self.config.seed, 1, epoch]).permutation(len(slots))
        return [slots[i] for i in order]

    def _order(self, group: int, lap: int) -> NDArray[np.int64]:
        rng = np.random.default_rng([self.config.seed, 0, group, lap])
        return rng.permutation(len(self._usable[group]))


def _shares(weights: Sequence[float], total: int) -> list[int]:
    """Return whole numbers near the shares of ``total``, which they add up to."""
    ideal = np.asarray(weights, float) / sum(weights) * total
    shares = np.floor(ideal).astype(int)
    rest = total - int(shares.sum())
    shares[np.argsort(shares - ideal, kind="stable")[:rest]] += 1
    return shares.tolist()
