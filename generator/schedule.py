"""Learning rates over a training run: a linear warm-up, then half a cosine. Torch-free."""

from __future__ import annotations

import math


def warmup_cosine(
    progress: float, warmup: float, total: float, *, release_compat: bool = False
) -> float:
    """Return the factor on the highest learning rate (Sec. 5.1: 10 of 2,000 epochs warm up).

    The cosine runs from the first step to ``total``; the warm-up multiplies it.

    Args:
        progress: Epochs or steps done, from 0.
        warmup: Epochs or steps until the warm-up ends.
        total: Epochs or steps until the rate is zero.
        release_compat: Let the warm-up overshoot in its last epoch, (10 + 1) / 10, as the public
            release does.
    """
    cosine = 0.5 * (1 + math.cos(math.pi * min(progress / total, 1.0)))
    if warmup <= 0:
        return cosine
    ramp = (progress + 1) / warmup
    warming = progress <= warmup if release_compat else progress < warmup
    return cosine * (ramp if release_compat else min(ramp, 1.0)) if warming else cosine
