"""What the rows make of what they are asked for.

A motion depends on the row, the clip and the repetition alone, so chunks can be made in any order,
and what was made before a run was stopped is found again. Rows that differ in post-processing only
share what was drawn.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results import clips, figures, spectra
from benchmarks.results.chunks import Chunk, Features, keep_chunk, kept_chunk, key_of
from benchmarks.results.clips import Asked, features_of
from benchmarks.results.figures import measured
from benchmarks.results.models import Models
from benchmarks.results.performed import made_with, performed
from benchmarks.results.rows import Protocol, Row
from generator import choreographer, finishing
from generator.features import decode
from generator.finishing.meant import meetings_of
from generator.motion import DuetMotion
from robots.files import sha256

SAMPLING, FINISHING = "sampling_s", "finishing_s"
"""CPU seconds of a chunk, in its notes."""


def _code(row: Row) -> str:
    """Return a hash of the files that turn a drawn motion into features and figures."""
    files = [Path(module.__file__ or "") for module in (clips, figures, spectra)]
    if row.finish:
        files += sorted(Path(finishing.__file__ or "").parent.glob("*.py"))
    return key_of([sha256(file) for file in files])


@dataclass(frozen=True, slots=True)
class Order:
    """Motions that are wanted together."""

    name: str
    """Identifier among all orders of a row."""
    asked: Sequence[Asked]
    """Clips, several times if several motions of one are wanted."""
    texts: Sequence[str]
    """A sentence for each."""
    seeds: Sequence[Sequence[int]]
    """A seed for each."""
    performed: Chunk | None = None
    """The performances themselves, if they are what is asked for."""


@dataclass(frozen=True, slots=True)
class Makers:
    """Makes, or finds, what rows make of orders."""

    root: Path
    """Folder of all takes."""
    protocol: Protocol
    """Rate and lengths."""
    models: Models
    """Where models come from."""

    def identity(self, row: Row) -> str:
        """Return a hash of everything that decides what a row makes."""
        protocol = [self.protocol.fps, self.protocol.frames, self.protocol.length_step, _code(row)]
        if row.drawn:
            loaded = self.models.load(row)
            sampler = asdict(loaded.sampler(row))
            return key_of(f"{row.kind}/1", loaded.hash, sampler, row.finish, protocol)
        return key_of(f"{row.kind}/1", choreographer.SOURCE, row.decoded, row.finish, protocol)

    def take(self, row: Row, order: Order) -> Chunk:
        """Return what a row makes of an order, made now unless it is on disk.

        Raises:
            DuetError: It cannot be made, or not be written.
        """
        if row.kind == "data" and not row.decoded and order.performed is not None:
            return order.performed
        identity = self.identity(row)
        path = self.root / identity / f"{order.name}.npz"
        key = key_of(identity, list(order.texts), [list(s) for s in order.seeds])
        chunk = kept_chunk(path, key)
        if chunk is None:
            chunk = self._finished(row, order) if row.finish else self._drawn(row, order)
            keep_chunk(path, key, chunk)
        return chunk

    def performed(self, row: Row, order: Order) -> Chunk:
        """Return an order's motions with figures of how two simulated people performed them.

        They perform what a user would have, finished motions, whether the row finishes them or not.

        Raises:
            DuetError: The motions cannot be made, or not be written.
        """
        finished = self.identity(replace(row, finish=True))
        identity = key_of("performed/1", finished, made_with())
        path = self.root / identity / f"{order.name}.npz"
        key = key_of(identity, list(order.texts), [list(s) for s in order.seeds])
        chunk = kept_chunk(path, key)
        if chunk is None:
            raw = self.take(replace(row, finish=False), order)
            figures = [performed(motion) for motion in self._all_finished(raw, order)]
            chunk = replace(raw, figures=figures)
            keep_chunk(path, key, chunk)
        return chunk

    def _finished(self, row: Row, order: Order) -> Chunk:
        raw = self.take(replace(row, finish=False), order)
        began = time.process_time()
        done = self._all_finished(raw, order)
        spent = time.process_time() - began
        notes = {**raw.notes, FINISHING: spent}
        return self._chunk(done, order, notes, [self._features(m, (0,)) for m in done])

    def _all_finished(self, raw: Chunk, order: Order) -> list[DuetMotion]:
        return [
            finishing.finish(self._decoded(x), settings=finishing.DRAWN, expected=meetings_of(text))
            for x, text in zip(raw.features, order.texts, strict=True)
        ]

    def _drawn(self, row: Row, order: Order) -> Chunk:
        if row.drawn:
            return self._sampled(row, order)
        if row.kind == "data" and order.performed is not None:
            features = order.performed.features
            motions = [self._decoded(x) for x in features]
            return self._chunk(motions, order, {}, features)
        make = _performed_again if row.kind == "data" else _read_and_performed
        began = time.process_time()
        motions = [make(*each) for each in zip(order.asked, order.texts, order.seeds, strict=True)]
        notes = {SAMPLING: time.process_time() - began}
        features = [
            self._features(motion, seed) for motion, seed in zip(motions, order.seeds, strict=True)
        ]
        return self._chunk(motions, order, notes, features)

    def _sampled(self, row: Row, order: Order) -> Chunk:
        step = self.protocol.length_step
        lengths = np.array([max(round(a.frames / step), 1) * step for a in order.asked], np.int64)
        model = self.models.load(row)
        began = time.process_time()
        features = model.draw(row, order.texts, lengths, order.seeds)
        notes = {SAMPLING: time.process_time() - began}
        motions = [self._decoded(x) for x in features]
        return self._chunk(motions, order, notes, features)

    def _decoded(self, features: Features) -> DuetMotion:
        """Return the motion, with the rotations that its features hold: they know the twist."""
        return decode(features, self.protocol.fps, rotations="features")

    def _features(self, motion: DuetMotion, seed: Sequence[int]) -> Features:
        return features_of(motion, self.protocol.fps, self.protocol.frames, seed)

    def _chunk(
        self,
        motions: Sequence[DuetMotion],
        order: Order,
        notes: dict[str, Any],
        features: Sequence[Features],
    ) -> Chunk:
        both = [
            measured(motion, asked.touches)
            for motion, asked in zip(motions, order.asked, strict=True)
        ]
        return Chunk(features, [f for f, _ in both], [s for _, s in both], notes)


def _read_and_performed(asked: Asked, text: str, seed: Sequence[int]) -> DuetMotion:
    """Return what the choreographer makes of a sentence that it has to read."""
    number = int(np.random.default_rng(list(seed)).integers(2**31))
    return choreographer.generate(text, seed=number, nearest=True)[0]


def _performed_again(asked: Asked, text: str, seed: Sequence[int]) -> DuetMotion:
    """Return another performance in the same manner, by other bodies."""
    rng = np.random.default_rng(list(seed))
    return choreographer.sample(asked.interaction, rng, style=asked.style)[0]
