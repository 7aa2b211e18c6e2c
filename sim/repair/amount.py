"""How much a repair changed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

Repair = dict[str, float]
"""``mean`` and ``max`` of a change, m (of a low-pass: s)."""


def amount(change: ArrayLike) -> Repair:
    """Return mean and largest size of changes, any shape."""
    size = np.abs(np.asarray(change, dtype=float))
    return {"mean": round(float(size.mean()), 6), "max": round(float(size.max()), 6)}
