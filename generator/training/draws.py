"""What training draws at random: each a function of its number.

**The problem.** A killed run must go on as if nothing had happened, and two processes with half a
batch each must learn what one with the whole batch learns. A random generator that walks along with
training would have to be saved in every process and be in the same place everywhere. So there is
none: noise, step, text drop-out and freezing of sample ``g`` (counted from the start of training)
come from a generator seeded with the seed and ``g``. The state of all randomness is the number of
steps done. Drop-out inside the network is seeded by step and process.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from generator.diffusion import STEPS, cosine_alphas
from generator.training.config import TrainingConfig
from generator.training.freezing import frozen

_SAMPLES, _DROPOUT = 3, 4
"""Streams of random numbers; :mod:`generator.data.batches` has 0 to 2."""


@dataclass(frozen=True, slots=True, eq=False)
class Draws:
    """Random numbers of one batch."""

    noise: Tensor
    """``[B, T, 2F]`` standard normal."""
    t: Tensor
    """``[B]`` diffusion steps, uniform."""
    keep_text: Tensor
    """``[B, 1]``, 0 where the text is dropped."""
    frozen: Tensor | None
    """``[B, T, 2F]``, what carries no noise; ``None``: everything does."""


def draw(
    config: TrainingConfig, first: int, lengths: Sequence[int], frames: int, width: int
) -> Draws:
    """Return what is drawn for samples ``first`` and following.

    Args:
        config: Seed and shares.
        first: Number of the first sample.
        lengths: Frames of each sample.
        frames: Rows T of the batch; the noise of a sample's first rows does not depend on it.
        width: Columns of the batch.
    """
    noise = np.empty((len(lengths), frames, width), np.float32)
    t = np.empty(len(lengths), np.int64)
    keep = np.empty((len(lengths), 1), np.float32)
    masks = []
    for row, length in enumerate(lengths):
        rng = np.random.default_rng([config.seed, _SAMPLES, first + row])
        t[row] = rng.integers(STEPS)
        keep[row] = rng.random() >= config.unconditional
        if config.freeze != "none":
            masks.append(frozen(config.freeze, config.freeze_share, frames, int(length), rng))
        rng.standard_normal(out=noise[row], dtype=np.float32)
    return Draws(
        torch.from_numpy(noise),
        torch.from_numpy(t),
        torch.from_numpy(keep),
        torch.from_numpy(np.stack(masks)) if masks else None,
    )


def noised(clean: Tensor, t: Tensor, noise: Tensor) -> Tensor:
    """Return ``x_t [B, ...]`` for steps ``t [B]``: a clean motion with its share of noise."""
    alphas = torch.tensor(cosine_alphas(), dtype=torch.float64, device=clean.device)[t]
    alphas = alphas.reshape(-1, *[1] * (clean.dim() - 1))
    return alphas.sqrt().to(clean.dtype) * clean + (1 - alphas).sqrt().to(clean.dtype) * noise


def seed_dropout(seed: int, step: int, rank: int) -> None:
    """Put torch's own generator where it belongs at a step of a process."""
    torch.manual_seed(_mixed(seed, _DROPOUT, step, rank))


def seed_weights(seed: int) -> None:
    """Put torch's own generator where initial weights are drawn from."""
    torch.manual_seed(_mixed(seed, _DROPOUT))


def _mixed(*numbers: int) -> int:
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0] >> np.uint64(1))
