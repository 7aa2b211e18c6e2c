"""Corrections that hold in some spells of time, and pass smoothly from one to the next.

**The problem.** A foot must be moved by this much while it stands here, by that much while it
stands there; in between any amount will do, if only nothing jerks. A correction that cancels a
slide changes while it holds, so easing it out with zero slope would give the foot back its slide in
one frame. In each gap the correction therefore follows the quintic that takes over value and slope
at both ends, with no acceleration there; in a long gap it goes to zero and comes back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray

_LOOK = 2
"""Frames over which the slope at the end of a spell is taken."""


def runs(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the runs of true moments ``[T]``."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).tolist()
    return [slice(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def bridge(values: NDArray, given: NDArray[np.bool_], ease: int) -> FloatArray:
    """Return corrections ``[T, C]`` that are as given in spells and smooth in the gaps.

    Args:
        values: ``[T, C]``; what is not given is not looked at.
        given: ``[T]``, when they hold.
        ease: Frames in which a correction comes or goes where no other follows soon.
    """
    out = np.where(given[:, None], values, 0.0)
    spells = runs(given)
    ease = max(1, ease)
    for before, after in zip([None, *spells], [*spells, None], strict=True):
        start = 0 if before is None else before.stop
        stop = len(out) if after is None else after.start
        if start >= stop:
            continue
        if before is not None and after is not None and stop - start <= 2 * ease:
            ends = _end(out, before), _start(out, after)
            out[start:stop] = _quintic(*ends, stop - start + 1)[1:-1]
            continue
        still = np.zeros((2, out.shape[1]))
        if before is not None:
            tail = _quintic(_end(out, before), still, ease + 1)[1:-1]
            out[start : start + ease] = tail[: stop - start]
        if after is not None:
            head = _quintic(still, _start(out, after), ease + 1)[1:-1]
            out[max(start, stop - ease) : stop] += head[-(stop - start) :]
    return out


def _end(values: NDArray, spell: slice) -> FloatArray:
    """Return value and slope per frame ``[2, C]`` at the end of a spell."""
    back = min(_LOOK, spell.stop - spell.start - 1)
    value = values[spell.stop - 1]
    slope = (value - values[spell.stop - 1 - back]) / back if back else np.zeros_like(value)
    return np.stack([value, slope])


def _start(values: NDArray, spell: slice) -> FloatArray:
    ahead = min(_LOOK, spell.stop - spell.start - 1)
    value = values[spell.start]
    slope = (values[spell.start + ahead] - value) / ahead if ahead else np.zeros_like(value)
    return np.stack([value, slope])


def _quintic(start: NDArray, end: NDArray, steps: int) -> FloatArray:
    """Return the course ``[steps + 1, C]`` between two values and slopes ``[2, C]``."""
    u = (np.arange(steps + 1) / steps)[:, None]
    rise = u**3 * (10 - 15 * u + 6 * u**2)
    leave = u * (1 - u) ** 3 * (1 + 3 * u)
    arrive = -(u**3) * (1 - u) * (4 - 3 * u)
    return (1 - rise) * start[0] + rise * end[0] + steps * (leave * start[1] + arrive * end[1])
