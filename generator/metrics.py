"""Metrics of generated motions against text and real motions (Sec. 5), from embeddings.

All take embeddings that a contrastive evaluator made, and no motions. The paper's protocol and that
of the public release differ in numbers only, which are parameters here: see :data:`PAPER` and
:data:`RELEASE`. Figures of different pools or scales cannot be compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray

Sampler = np.random.Generator | np.random.RandomState
"""Source of randomness; the legacy one only to repeat published figures."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """Numbers that the metrics depend on."""

    pool: int
    """Motions among which R-precision looks for the right one."""
    fid_scale: float
    """Factor on the embeddings before FID; FID grows with its square."""
    diversity_scale: float
    """Factor on the distances of Diversity."""
    diversity_pairs: int = 300
    """Random pairs of Diversity."""
    motions_per_text: int = 20
    """Motions generated per text for MModality."""
    multimodality_pairs: int = 10
    """Random pairs per text of MModality."""
    repetitions: int = 20
    """Runs that mean and interval are taken over."""


PAPER = Protocol(pool=32, fid_scale=1.0, diversity_scale=1.0)
"""Sec. 5, after Guo et al. (2022)."""

RELEASE = Protocol(pool=96, fid_scale=6.0, diversity_scale=3.0, motions_per_text=30)
"""The public release: FID of six times the embedding (36 times the value), distances times 6/2."""


def distances(first: NDArray, second: NDArray) -> FloatArray:
    """Return Euclidean distances ``[N, M]`` of embeddings ``[N, D]`` and ``[M, D]``."""
    first, second = np.asarray(first, float), np.asarray(second, float)
    squares = (first**2).sum(1)[:, None] + (second**2).sum(1) - 2 * first @ second.T
    return np.sqrt(np.maximum(squares, 0))


def r_precision(
    text: NDArray, motion: NDArray, *, pool: int = PAPER.pool, top: int = 3
) -> FloatArray:
    """Return R-precision: how often the right motion is among the ``k`` nearest to its text.

    Rows are taken in order, ``pool`` at a time; an incomplete last pool is left out. Shuffle
    before: neighbours in a file are often alike. Of equally near motions the right one counts last.

    Args:
        text: ``[N, D]`` embeddings of sentences.
        motion: ``[N, D]`` embeddings of their motions.
        pool: Motions to choose from; the figure depends on it.
        top: Largest k.

    Returns:
        ``[top]``, shares for k = 1 to ``top``.

    Raises:
        ValueError: The shapes differ, or there is not one full pool.
    """
    _require_pairs(text, motion)
    pools = len(text) // pool if pool >= 1 else 0
    if pools < 1:
        raise ValueError(f"{len(text)} motions fill no pool of {pool}")
    ranks = []
    for start in range(0, pools * pool, pool):
        near = distances(text[start : start + pool], motion[start : start + pool])
        own = np.diagonal(near)[:, None]
        ranks.append((near <= own).sum(axis=1) - 1)
    return np.array([(np.concatenate(ranks) < k).mean() for k in range(1, top + 1)])


def mm_dist(text: NDArray, motion: NDArray) -> float:
    """Return the multimodal distance: mean distance of each text to its motion, both ``[N, D]``.

    Raises:
        ValueError: The shapes differ.
    """
    _require_pairs(text, motion)
    gap = np.asarray(text, float) - np.asarray(motion, float)
    return float(np.linalg.norm(gap, axis=1).mean())


def fid(real: NDArray, generated: NDArray, *, scale: float = PAPER.fid_scale) -> float:
    """Return the Fréchet distance of two sets of embeddings ``[N, D]`` and ``[M, D]``.

    **The problem.** |mu_a - mu_b|^2 + tr(A + B - 2 (A B)^(1/2)) is usually computed with a matrix
    root of the non-symmetric A B, which turns complex for singular covariances (fewer samples than
    dimensions) and whose interface in scipy changes. The trace of that root equals that of
    (A^(1/2) B A^(1/2))^(1/2), and both roots there are of symmetric matrices: two
    eigendecompositions do, and nothing can become complex.

    Args:
        real: Embeddings of captured motions.
        generated: Embeddings of generated ones.
        scale: Factor on both.

    Raises:
        ValueError: A set has fewer than two rows, or the widths differ.
    """
    real, generated = (np.asarray(x, float) * scale for x in (real, generated))
    if (
        real.ndim != 2
        or real.shape[1:] != generated.shape[1:]
        or min(map(len, (real, generated))) < 2
    ):
        raise ValueError(f"embeddings have shapes {real.shape} and {generated.shape}")
    gap = real.mean(axis=0) - generated.mean(axis=0)
    a, b = (np.atleast_2d(np.cov(x, rowvar=False)) for x in (real, generated))
    values, vectors = np.linalg.eigh(a)
    root = (vectors * np.sqrt(np.maximum(values, 0))) @ vectors.T
    common = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ b @ root), 0)).sum()
    return float(gap @ gap + np.trace(a) + np.trace(b) - 2 * common)


def diversity(
    motion: NDArray,
    *,
    rng: Sampler,
    pairs: int = PAPER.diversity_pairs,
    scale: float = PAPER.diversity_scale,
) -> float:
    """Return the mean distance of random pairs of motions.

    The two ends of the pairs are drawn one after the other, each without repetition.

    Args:
        motion: ``[N, D]`` embeddings.
        rng: Draws the pairs.
        pairs: How many.
        scale: Factor on the distances.

    Raises:
        ValueError: There are fewer motions than pairs.
    """
    motion = np.asarray(motion, float)
    if len(motion) < pairs or pairs < 1:
        raise ValueError(f"{pairs} pairs of {len(motion)} motions")
    first, second = (rng.choice(len(motion), pairs, replace=False) for _ in range(2))
    return float(np.linalg.norm(motion[first] - motion[second], axis=1).mean() * scale)


def multimodality(
    motion: NDArray, *, rng: Sampler, pairs: int = PAPER.multimodality_pairs
) -> float:
    """Return the mean distance of random pairs of motions of the same text.

    Args:
        motion: ``[texts, motions, D]`` embeddings.
        rng: Draws the pairs, the same for all texts.
        pairs: How many per text.

    Raises:
        ValueError: The shape does not fit, or there are fewer motions per text than pairs.
    """
    motion = np.asarray(motion, float)
    if motion.ndim != 3 or motion.shape[1] < pairs or pairs < 1:
        raise ValueError(f"{pairs} pairs of motions with shape {motion.shape}")
    first, second = (rng.choice(motion.shape[1], pairs, replace=False) for _ in range(2))
    return float(np.linalg.norm(motion[:, first] - motion[:, second], axis=-1).mean())


def confidence_interval(values: Sequence[float] | NDArray) -> tuple[float, float]:
    """Return mean and half width of the 95 % interval of repeated measurements.

    1.96 times the (population) standard deviation over the root of their number, as is customary
    in this field.

    Raises:
        ValueError: There are no values.
    """
    array = np.asarray(values, float)
    if not array.size:
        raise ValueError("no values")
    return float(array.mean()), float(1.96 * array.std() / math.sqrt(array.size))


def _require_pairs(text: NDArray, motion: NDArray) -> None:
    if np.ndim(text) != 2 or np.shape(text) != np.shape(motion) or not len(text):
        raise ValueError(f"embeddings have shapes {np.shape(text)} and {np.shape(motion)}")
