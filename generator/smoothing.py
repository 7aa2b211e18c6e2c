"""Smoothing of motion over time. Torch-free."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d


def smooth(array: NDArray[Any], sigma: float = 1.0) -> NDArray[Any]:
    """Return ``[T, ...]`` smoothed over its first axis by a Gaussian, ends held.

    InterGen's own jitter ends this way in the public demo (sigma of 1 frame): each value becomes a
    mean of its neighbours, weighted ``exp(-d^2 / 2 sigma^2)``, cut at 4 sigma; beyond the ends the
    first and last frame repeat.

    Args:
        array: Time along the first axis.
        sigma: Deviation of the Gaussian, frames; 0 changes nothing.
    """
    if sigma == 0:
        return np.array(array)
    return gaussian_filter1d(array, sigma, axis=0, mode="nearest")
