"""The figures of a row on a split in one repetition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.results.chunks import Chunk
from benchmarks.results.clips import Asked
from benchmarks.results.figures import MET
from benchmarks.results.judges import Judges
from benchmarks.results.takes import FINISHING, SAMPLING
from generator.choreographer import repertoire
from generator.metrics import PAPER, multimodality
from generator.scores import Floats, figures

MEANS = ("bones", "skate_labelled", "skate_low", "jerk", "speed", "sunk", "overlap", "overlapping")
"""Figures of single motions of which the mean counts."""


@dataclass(frozen=True, slots=True)
class Taken:
    """Everything that a row made in one repetition."""

    asked: Sequence[Asked]
    """What for."""
    texts: Sequence[str]
    """With which sentence."""
    chunks: Sequence[Chunk]
    """What was made, in the same order."""


@dataclass(frozen=True, slots=True)
class Standard:
    """What motions are measured against."""

    judges: Judges
    """Who judges."""
    reference: Floats
    """``[M, E]`` embeddings of real motions."""
    led: frozenset[str]
    """Interactions whose leader can be told."""


def measured_row(taken: Taken, standard: Standard, seed: Sequence[int]) -> dict[str, Any]:
    """Return the figures, their parts by interaction, and the mean spectrum, as JSON holds them.

    Args:
        taken: Motions.
        standard: What they are measured against.
        seed: Decides the pools of R-precision and the pairs of Diversity.
    """
    features = [x for chunk in taken.chunks for x in chunk.features]
    motion = standard.judges.watch(features)
    text = standard.judges.read(taken.texts)
    found: dict[str, float | None] = dict(figures(text, motion, standard.reference, seed)["paper"])
    single = [row for chunk in taken.chunks for row in chunk.figures]
    found |= {name: mean_of([row.get(name) for row in single]) for name in MEANS}
    right, led = judged(taken.asked, features, standard)
    met = [None if row["missed"] is None else row["missed"] <= MET for row in single]
    found |= {"class": mean_of(right), "role": mean_of(led), "met": mean_of(met)}
    count = len(single)
    for name in (SAMPLING, FINISHING):
        spent = [chunk.notes[name] for chunk in taken.chunks if name in chunk.notes]
        found[name] = sum(spent) / count if len(spent) == len(taken.chunks) else None
    names = [one.interaction for one in taken.asked]
    return {
        "clips": count,
        "figures": found,
        "by_interaction": {
            name: {
                "class": _mean_where(right, names, name),
                "role": _mean_where(led, names, name),
                "met": _mean_where(met, names, name),
            }
            for name in dict.fromkeys(names)
        },
        "spectrum": _spectrum([s for chunk in taken.chunks for s in chunk.spectra]),
    }


def judged(
    asked: Sequence[Asked], features: Sequence[NDArray[np.float32]], standard: Standard
) -> tuple[list[bool], list[bool | None]]:
    """Return whether what was asked for is what is seen, and whether who should lead does.

    The second is ``None`` where no leader can be told.
    """
    what, second = standard.judges.classify(features)
    names = repertoire()
    right = [names[w] == one.interaction for w, one in zip(what, asked, strict=True)]
    led = [
        bool(said) == one.second_leads if one.interaction in standard.led else None
        for said, one in zip(second, asked, strict=True)
    ]
    return right, led


def spread_of(chunks: Sequence[Chunk], judges: Judges, seed: Sequence[int]) -> float:
    """Return MModality of chunks that each hold the motions of one sentence."""
    embedded = np.stack([judges.watch(chunk.features) for chunk in chunks])
    pairs = min(PAPER.multimodality_pairs, embedded.shape[1])
    return multimodality(embedded, rng=np.random.default_rng([*seed, 12]), pairs=pairs)


def mean_of(values: Sequence[float | bool | None]) -> float | None:
    """Return the mean of the values that are there."""
    known = [float(value) for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _mean_where(
    values: Sequence[float | bool | None], names: Sequence[str], name: str
) -> float | None:
    return mean_of([value for value, of in zip(values, names, strict=True) if of == name])


def _spectrum(spectra: Sequence[NDArray[np.float64]]) -> list[float | None]:
    """Return the mean of each frequency over the motions that are long enough for it."""
    table = np.array(spectra)
    known = ~np.isnan(table)
    sums, counts = np.where(known, table, 0.0).sum(axis=0), known.sum(axis=0)
    return [float(s / c) if c else None for s, c in zip(sums, counts, strict=True)]


def worst(record: Mapping[str, Any], figure: str, count: int) -> list[tuple[str, float]]:
    """Return the interactions of a record in which a figure is lowest."""
    known = [
        (name, parts[figure])
        for name, parts in record["by_interaction"].items()
        if parts[figure] is not None
    ]
    return sorted(known, key=lambda item: item[1])[:count]
