"""Networks that rows draw from: with torch as a row says, or without as they ship."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.results.rows import Row
from generator.checkpoint import load
from generator.diffusion import SamplerConfig
from generator.drawing import batches_of_equal_length, generate, noise_of
from generator.model import InterGen
from generator.model_folder import read_header
from generator.runtime import Portable
from generator.runtime.drawing import draw
from generator.scores import Floats
from generator.text.encoder import SentenceEncoder, packaged_encoder
from robots.errors import CheckpointError, SpecError

BATCH = 16
"""Motions drawn at a time."""
_LOADS = 5
"""Attempts to read a model whose training replaces it just then."""


@dataclass(frozen=True, slots=True)
class Trained:
    """A model of a training run, on torch."""

    model: InterGen
    """Ready to draw."""
    hash: str
    """SHA-256 of its weights."""

    def sampler(self, row: Row) -> SamplerConfig:
        """Return what the row says."""
        return row.sampler

    def draw(
        self,
        row: Row,
        texts: Sequence[str],
        lengths: NDArray[np.int64],
        seeds: Sequence[Sequence[int]],
    ) -> list[Floats]:
        """Return motions ``[T, 524]`` in metres."""
        return generate(self.model, texts, lengths, seeds, row.sampler, batch=BATCH)


@dataclass(frozen=True, slots=True)
class Shipped:
    """A model that runs without torch."""

    model: Portable
    """Ready to draw."""
    hash: str
    """SHA-256 of its network."""
    encoder: SentenceEncoder
    """Reads the sentences."""

    def sampler(self, row: Row) -> SamplerConfig:
        """Return what the model's folder says: that is what a user gets."""
        return self.model.sampling.sampler()

    def draw(
        self,
        row: Row,
        texts: Sequence[str],
        lengths: NDArray[np.int64],
        seeds: Sequence[Sequence[int]],
    ) -> list[Floats]:
        """Return motions ``[T, 524]`` in metres, from the same noise as :class:`Trained`."""
        known = {text: self.encoder.encode([text])[0] for text in dict.fromkeys(texts)}
        out: dict[int, Floats] = {}
        for rows in batches_of_equal_length(lengths, BATCH):
            cond = np.stack([known[texts[i]] for i in rows]).astype(np.float32)
            frames = int(lengths[rows[0]])
            width = 2 * self.model.config.features
            noise = np.stack([noise_of(seeds[i], frames, width) for i in rows])
            drawn = draw(self.model, cond, frames, noise=noise)
            for i, features in zip(rows, drawn, strict=True):
                out[i] = features.reshape(frames, -1).astype(np.float32)
        return [out[i] for i in range(len(texts))]


@dataclass(slots=True)
class Models:
    """Models by folder, each read once: a run measures one state of a model that is training."""

    fps: float
    """Frame rate that they must have."""
    known: dict[tuple[str, str], Trained | Shipped] = field(default_factory=dict)
    """Those that were read."""

    def load(self, row: Row) -> Trained | Shipped:
        """Return the model of a row.

        Raises:
            CheckpointError: It is missing or damaged.
            SpecError: It has another frame rate.
        """
        key = (row.kind, row.folder)
        if key not in self.known:
            self.known[key] = self._read(row)
        return self.known[key]

    def _read(self, row: Row) -> Trained | Shipped:
        part = "weights" if row.kind == "model" else "network"
        for _ in range(_LOADS):
            before = _hash(row.folder, part)
            model = _trained(row, before) if row.kind == "model" else _shipped(row, before)
            if _hash(row.folder, part) == before:
                break
        else:
            raise CheckpointError("changes while it is read", where=row.folder, hint="run again")
        fps = model.model.provenance.fps
        if fps != self.fps:
            raise SpecError(
                f"a model of {fps:g} frames per second",
                where=row.folder,
                allowed=f"{self.fps:g}",
            )
        return model


def _trained(row: Row, digest: str) -> Trained | Shipped:
    return Trained(load(row.folder), digest)


def _shipped(row: Row, digest: str) -> Trained | Shipped:
    model = Portable.load(row.folder)
    encoder = packaged_encoder(model.text_encoder)
    if encoder is None:
        raise CheckpointError(
            f"its text encoder '{model.text_encoder}' does not come with it", where=row.folder
        )
    return Shipped(model, digest, encoder)


def _hash(folder: str, part: str) -> str:
    return str(read_header(Path(folder)).get(part, {}).get("sha256", ""))
