"""When feet stand.

**The problem.** In what a network draws, standing feet creep at 5 to 25 cm/s and float or sink by
centimetres, and a network's own labels of contact are sometimes wrong. A foot is taken to stand
while its ball or its heel is low for the moment and slow for long enough; slow is judged with
hysteresis. Labels do not decide, but they move the bounds: where a contact is labelled a foot may
be faster and higher, where the label denies it must be slower.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, median_filter, minimum_filter1d

from generator.finishing.corrections import runs
from generator.finishing.figure import Figure
from robots.skeleton import FloatArray

SIDES = ("left", "right")

_STILL, _MOVING = 0.22, 0.40
"""A stance begins where a point is slower than the first and spreads while it is slower than the
second, m/s."""
_LABELLED, _DENIED = 2.5, 0.7
"""Factor on these speeds where a label says that the foot stands, and that it does not."""
_LABELLED_HEEL = 1.5
"""The first of them for heels, which are let down and lifted about a standing ball."""
_LOW, _LOW_LABELLED = 0.05, 0.09
"""Height over the lowest ball around the moment up to which a point may stand, m."""
_AROUND = 0.4
"""Half the time that is around the moment, s."""
_LOOK = 0.04
"""Low-pass on positions before their speed is judged, s."""
_SHORTEST = 0.1
"""Shortest stance, s."""
_GLIDE = 0.12
"""Farthest that a foot slides from the middle of one stance, m; what goes farther hides a step."""
_MEDIAN = 5
"""Frames of the median that drops single wrong labels."""
_HEEL = 0.018
"""How much higher above the ball than in a flat foot an ankle may be whose heel stands, m."""
_HEEL_LABELLED = 0.05
"""The same where a label says that it stands."""


@dataclass(frozen=True, slots=True, eq=False)
class Stance:
    """When one foot stands."""

    toe: NDArray[np.bool_]
    """``[T]``: the ball stands."""
    heel: NDArray[np.bool_]
    """``[T]``: the heel stands."""

    @property
    def flat(self) -> NDArray[np.bool_]:
        """``[T]``: the whole sole stands."""
        return self.toe & self.heel


def find_stances(figure: Figure, fps: float, labels: NDArray | None) -> tuple[Stance, Stance]:
    """Return when the left and the right foot stand.

    Args:
        figure: Whose feet.
        fps: Frames per second.
        labels: ``[T, 4]`` left ankle, left toe, right ankle, right toe, if the motion has them.
    """
    names = [f"{side}_{point}" for side in SIDES for point in ("ankle", "foot")]
    paths = np.stack([figure.point(name) for name in names], axis=1)
    smooth = gaussian_filter1d(paths, _LOOK * fps, axis=0, mode="nearest")
    speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=-1) * fps
    said = _usable(labels, speed)
    factor = np.where(said, _LABELLED, _DENIED if said.any() else 1.0)
    low = np.where(said, _LOW_LABELLED, _LOW)
    balls = smooth[:, (1, 3), 2]
    floor = minimum_filter1d(balls.min(axis=1), 2 * round(_AROUND * fps) + 1, mode="nearest")
    still = [
        _spells(
            balls[:, i] < floor + low[:, toe],
            smooth[:, toe],
            speed[:, toe],
            factor[:, toe],
            said[:, toe],
            fps,
        )
        for i, toe in enumerate((1, 3))
    ]
    rise = smooth[:, (0, 2), 2] - balls
    flat_rise = _flat_rise(rise, np.stack(still, axis=1))
    found = []
    for i, heel in enumerate((0, 2)):
        over = smooth[:, heel, 2] - floor - flat_rise
        tilt = np.where(said[:, heel], _HEEL_LABELLED, _HEEL)
        may = (over < low[:, heel]) & (rise[:, i] < flat_rise + tilt)
        sure = np.minimum(factor[:, heel], _LABELLED_HEEL)
        heels = _spells(may, smooth[:, heel], speed[:, heel], sure, said[:, heel], fps)
        found.append(Stance(still[i], heels))
    return found[0], found[1]


def _usable(labels: NDArray | None, speed: NDArray) -> NDArray[np.bool_]:
    """Return labels ``[T, 4]`` without single outliers; none if they do not tell slow from fast."""
    none = np.zeros(speed.shape, dtype=bool)
    if labels is None:
        return none
    said = median_filter(np.asarray(labels, dtype=np.uint8), (_MEDIAN, 1), mode="nearest") > 0
    if said.all() or not said.any():
        return none
    return said if np.median(speed[said]) < np.median(speed[~said]) else none


def _spells(
    may: NDArray[np.bool_],
    path: NDArray,
    speed: NDArray,
    factor: NDArray,
    said: NDArray[np.bool_],
    fps: float,
) -> NDArray[np.bool_]:
    """Return the long enough runs of slow moments ``[T]`` that have a still one in them."""
    out = np.zeros(len(may), dtype=bool)
    waiting = runs(may & (speed < _MOVING * factor))
    while waiting:
        run = waiting.pop()
        if run.stop - run.start < _SHORTEST * fps or (speed[run] / factor[run]).min() >= _STILL:
            continue
        away = np.linalg.norm(path[run] - np.median(path[run], axis=0), axis=1)
        # A slide that is labelled as a stance is no hidden step.
        quick = np.where(said[run], 0.0, speed[run])
        if away.max() > _GLIDE and quick.max() > _STILL:
            waiting += _without(run, quick)
        else:
            out[run] = True
    return out


def _without(run: slice, quick: NDArray) -> list[slice]:
    """Return what is left of a run without the quick moments around its fastest."""
    fast, slow = int(np.argmax(quick)), np.flatnonzero(quick < _STILL)
    before, after = slow[slow < fast], slow[slow > fast]
    left = [slice(run.start, run.start + int(before[-1]) + 1)] if len(before) else []
    return left + ([slice(run.start + int(after[0]), run.stop)] if len(after) else [])


def _flat_rise(rise: FloatArray, standing: NDArray[np.bool_]) -> float:
    """Return how high the ankles of flat feet are above their balls, m: seldom undercut."""
    return float(np.percentile(rise[standing] if standing.any() else rise, 20))
