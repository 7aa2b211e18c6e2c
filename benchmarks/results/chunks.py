"""Motions and their figures in archives that are whole or absent, so that nothing is done twice."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.errors import MotionFileError
from robots.files import read_archive, write_archive

Features = NDArray[np.float32]
"""``[T, 524]`` of one duet, in metres, person a first."""


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Some motions."""

    features: Sequence[Features]
    """Of each motion, at the benchmark's rate."""
    figures: Sequence[Mapping[str, float | None]]
    """Of each motion (:mod:`benchmarks.results.figures`)."""
    spectra: Sequence[NDArray[np.float64]]
    """Of each motion, ``[frequencies]`` (:mod:`benchmarks.results.spectra`)."""
    notes: dict[str, Any] = field(default_factory=dict)
    """What else is to be kept, as JSON."""


def key_of(*parts: object) -> str:
    """Return a short hash of everything that decides a content."""
    text = json.dumps(parts, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def keep_chunk(path: Path, key: str, chunk: Chunk) -> None:
    """Write a chunk, whole or not at all.

    Raises:
        MotionFileError: It cannot be written.
    """
    header = {"key": key, "figures": [dict(row) for row in chunk.figures], "notes": chunk.notes}
    arrays = {
        "lengths": np.array([len(x) for x in chunk.features]),
        "features": np.concatenate(list(chunk.features)).astype(np.float32),
        "spectra": np.array(chunk.spectra),
    }
    write_archive(path, header, arrays)


def kept_chunk(path: Path, key: str) -> Chunk | None:
    """Return a chunk that was kept under this key; ``None`` if there is none that is whole."""
    if not path.is_file():
        return None
    try:
        header, arrays = read_archive(path)
        if header is None or header.get("key") != key:
            return None
        ends = np.cumsum(arrays["lengths"])[:-1]
        features = np.split(arrays["features"], ends)
        return Chunk(features, header["figures"], list(arrays["spectra"]), header["notes"])
    except (MotionFileError, KeyError, ValueError):
        return None  # made again
