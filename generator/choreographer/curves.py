"""Curves over time that bodies follow: minimum-jerk moves, windows, oscillations, slow drift."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robots.skeleton import FloatArray


def ease(progress: ArrayLike) -> FloatArray:
    """Return the minimum-jerk course from 0 to 1 (Flash and Hogan 1985); flat outside 0..1."""
    u = np.clip(progress, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u * u)


def rise(times: NDArray, start: float, end: float) -> FloatArray:
    """Return the minimum-jerk course ``[T]`` from 0 at ``start`` to 1 at ``end`` (s)."""
    return ease((times - start) / max(end - start, 1e-6))


def window(times: NDArray, start: float, on: float, off: float, end: float) -> FloatArray:
    """Return ``[T]``: 0 until ``start``, 1 from ``on`` to ``off``, 0 again from ``end`` (s)."""
    return rise(times, start, on) * (1.0 - rise(times, off, end))


def through(times: NDArray, knots: Sequence[tuple[float, ArrayLike]]) -> FloatArray:
    """Return the curve ``[T, ...]`` that comes to rest at each ``(time, value)`` in turn."""
    value = np.asarray(knots[0][1], dtype=float)
    out = np.broadcast_to(value, (len(times), *value.shape)).copy()
    for (start, before), (end, after) in pairwise(knots):
        course = rise(times, start, end).reshape(-1, *[1] * value.ndim)
        out += course * (np.asarray(after, dtype=float) - np.asarray(before, dtype=float))
    return out


def oscillation(times: NDArray, start: float, end: float, hertz: float) -> FloatArray:
    """Return ``[T]``: whole periods of a sine within a window, eased in and out, 0 outside."""
    span = end - start
    periods = max(1, round(hertz * span))
    phase = 2 * np.pi * periods * (times - start) / span
    fade = min(0.3 * span, 0.5 / hertz)
    return np.sin(phase) * window(times, start, start + fade, end - fade, end)


def drift(
    times: NDArray,
    rng: np.random.Generator,
    amplitude: float,
    band: tuple[float, float] = (0.1, 0.5),
) -> FloatArray:
    """Return band-limited random wandering ``[T]`` of the given standard deviation.

    Four sines of random frequency within ``band`` (Hz) and random phase: smooth at every order.
    """
    frequency = rng.uniform(*band, size=4)
    phase = rng.uniform(0, 2 * np.pi, size=4)
    waves = np.sin(2 * np.pi * np.outer(times, frequency) + phase)
    return waves.sum(axis=1) * (amplitude / np.sqrt(2.0))
