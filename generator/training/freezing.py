"""Fine-tuning for applications (Sec. 5.4): what a sample gives away without noise.

The paper masks the noise on what is to be frozen, after the fine-tuning of MDM (Tevet et al. 2022):
the network's input holds the true numbers there, and it learns to rely on them. What is frozen is
drawn per sample, so that one model serves every choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.architecture import FEATURES
from generator.given import TRAJECTORY
from generator.training.config import Freeze

LONGEST_END = 0.4
"""Largest share of a clip that is frozen at its start, and at its end."""

_SINGLE: tuple[Freeze, ...] = ("person", "trajectory", "ends")


def frozen(
    kind: Freeze, share: float, frames: int, length: int, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Return ``[frames, 524]``: which numbers of one sample carry no noise.

    Args:
        kind: What is frozen.
        share: Probability that anything is.
        frames: Rows T of the batch.
        length: Frames of the sample; beyond them nothing is frozen.
        rng: Draws all of it.
    """
    mask = np.zeros((frames, 2, FEATURES), bool)
    if kind == "none" or rng.random() >= share:
        return mask.reshape(frames, -1)
    if kind == "mixed":
        kind = _SINGLE[int(rng.integers(len(_SINGLE)))]
    if kind == "person":
        mask[:length, int(rng.integers(2))] = True
    elif kind == "trajectory":
        for person in ((0,), (1,), (0, 1))[int(rng.integers(3))]:
            mask[:length, person, TRAJECTORY] = True
    else:
        start, end = (rng.random(2) * LONGEST_END * length).astype(int)
        if not start + end:
            start = 1
        mask[:start] = True
        mask[length - end : length] = True
    return mask.reshape(frames, -1)
