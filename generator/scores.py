"""The figures of Sec. 5 on the scales of the paper and of the release, from embeddings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.metrics import (
    PAPER,
    RELEASE,
    confidence_interval,
    diversity,
    fid,
    mm_dist,
    multimodality,
    r_precision,
)

SCALES = {"paper": PAPER, "release": RELEASE}
"""Numbers that each scale goes by."""

Floats = NDArray[np.float32]
Figures = dict[str, float | None]


def figures(
    text: Floats, motion: Floats, reference: Floats, seed: Sequence[int]
) -> dict[str, Figures]:
    """Return the figures of one repetition, on both scales.

    ``None`` stands for a figure that needs more clips than there are.

    Args:
        text: ``[N, E]`` embeddings of sentences.
        motion: ``[N, E]`` embeddings of their motions: real, or generated.
        reference: ``[M, E]`` embeddings of real motions, for FID.
        seed: Decides pools and pairs.
    """
    result: dict[str, Figures] = {}
    for name, scale in SCALES.items():
        rng = np.random.default_rng([*seed, 10])
        order = rng.permutation(len(motion))
        found: Figures = {}
        for k in (1, 2, 3):
            found[f"r_precision_top{k}"] = None
        if len(motion) >= scale.pool:
            top = r_precision(text[order], motion[order], pool=scale.pool)
            found |= {f"r_precision_top{k + 1}": float(value) for k, value in enumerate(top)}
        found["fid"] = fid(reference, motion, scale=scale.fid_scale)
        found["mm_dist"] = mm_dist(text, motion)
        found["diversity"] = diversity(
            motion,
            rng=rng,
            pairs=min(scale.diversity_pairs, len(motion)),
            scale=scale.diversity_scale,
        )
        result[name] = found
    return result


def spread_figures(spread: Floats | None, scale: str, seed: Sequence[int]) -> Figures:
    """Return MModality on a scale; nothing if there are no motions for it.

    Args:
        spread: ``[texts, motions, E]`` embeddings.
        scale: Which.
        seed: Decides the pairs.
    """
    if spread is None:
        return {}
    wanted = SCALES[scale]
    motions = spread[:, : wanted.motions_per_text]
    pairs = min(wanted.multimodality_pairs, motions.shape[1])
    rng = np.random.default_rng([*seed, 12])
    return {"multimodality": multimodality(motions, rng=rng, pairs=pairs)}


def summarise(repetitions: Sequence[dict[str, Figures]]) -> dict[str, dict[str, Any]]:
    """Return mean, half width of the 95 % interval and count of every figure, per scale."""
    result: dict[str, dict[str, Any]] = {}
    for scale in SCALES:
        names = dict.fromkeys(name for one in repetitions for name in one[scale])
        result[scale] = {}
        for name in names:
            values = [v for one in repetitions if (v := one[scale].get(name)) is not None]
            if not values:
                result[scale][name] = None
                continue
            mean, interval = confidence_interval(values)
            result[scale][name] = {"mean": mean, "interval": interval, "runs": len(values)}
    return result
