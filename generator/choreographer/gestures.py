"""Gestures that several interactions share: talking hands, clapping, patting, a hand on a hip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.choreographer.curves import through, window
from generator.choreographer.role import ELBOW_DOWN, Role, Spot
from generator.choreographer.stage import Span, Stage
from generator.choreographer.style import SIDES, Side

ELBOW_OUT = (-0.1, 1.0, -0.3)
"""Where the elbow points while the hand is before the own chest or face."""
Knots = Sequence[tuple[float, ArrayLike]]


def follow(
    stage: Stage,
    role: Role,
    side: Side,
    knots: Knots,
    weight: NDArray,
    *,
    point: str = "spine3",
    elbow: ArrayLike = ELBOW_DOWN,
) -> None:
    """Lead a hand through places by the own body: ``(s, [forward, outward, up] m)``."""
    role.gesture(side, through(stage.times, knots), weight, point=point, elbow=elbow)


def hand_on_hip(role: Role, side: Side, weight: NDArray) -> None:
    """Put a hand on the own hip, elbow out."""
    role.gesture(side, (0.02, 0.21, 0.02), weight, point="pelvis", elbow=(-0.6, 1.0, 0.0))


def talk(stage: Stage, role: Role, on: Span, sides: Sequence[Side] = SIDES) -> None:
    """Let hands underline what is said: beats of random size and place, eased into each other."""
    size = stage.style.amplitude
    start, end = on.start - 0.35, on.end + 0.45
    weight = window(stage.times, start, on.start + 0.15, on.end - 0.1, end)
    beat = 0.55 / (stage.style.speed * (0.75 + 0.25 * stage.style.energy))
    count = max(2, round(on.length / beat))
    moments = np.linspace(on.start, on.end, count)
    for side in sides:
        low = np.array([0.24, 0.08, -0.22])
        high = low + np.array([0.12, 0.10 + 0.10 * size, 0.08 + 0.16 * size])
        knots = [(float(m), stage.rng.uniform(low, high)) for m in moments]
        follow(stage, role, side, knots, weight, elbow=(-0.4, 0.5, -1.0))
    nods = [(float(m), stage.pick(-0.05, 0.10)) for m in moments]
    role.nod += weight * through(stage.times, nods)
    turns = [(float(m), stage.pick(-0.10, 0.10) * size) for m in moments]
    role.twist += weight * through(stage.times, turns)


def nod_along(stage: Stage, role: Role, on: Span, times_nodded: int = 2) -> None:
    """Let somebody nod a few times."""
    for moment in np.linspace(on.start, on.end, times_nodded + 2)[1:-1]:
        role.nod += 0.16 * window(stage.times, moment - 0.22, moment, moment, moment + 0.26)


def clap(stage: Stage, role: Role, on: Span, start: float, end: float, height: float) -> None:
    """Let somebody clap the own hands before the chest.

    Args:
        stage: The stage.
        role: Who.
        on: Time of clapping.
        start: Hands leave, s.
        end: Hands are back, s.
        height: Above the upper spine, m.
    """
    weight = window(stage.times, start, on.start, on.end, end)
    beat = np.abs(stage.rhythm(on, 1.25, 0.065))
    for side in SIDES:
        rises = (height - 0.02 if side == "left" else height + 0.02) + 0.25 * beat
        spot = np.column_stack([np.full(len(beat), 0.29), 0.035 + beat, rises])
        role.gesture(side, spot, weight, elbow=(-0.2, 0.8, -0.9))


def pat(
    stage: Stage,
    role: Role,
    side: Side,
    point: str,
    offset: ArrayLike,
    *,
    moments: Sequence[float],
    start: float,
    end: float,
    lift: ArrayLike,
    elbow: ArrayLike = ELBOW_DOWN,
) -> None:
    """Let a hand hover over a place of the partner's body and pat it, labelled.

    Args:
        stage: The stage.
        role: Whose hand.
        side: Which hand.
        point: Keypoint of the partner.
        offset: ``[3]`` m from it, forward, left, up.
        moments: Beginnings of the touches, s; at least 0.3 s apart.
        start: Hand leaves, s.
        end: Hand is back, s.
        lift: ``[3]`` m, how far the hand hovers from the place.
        elbow: Where the elbow points: forward, outward, up.
    """
    away = np.asarray(offset, dtype=float)
    hover = Spot("partner", away + np.asarray(lift, dtype=float), point)
    first, last = moments[0], moments[-1]
    weight = window(stage.times, start, first - 0.1, last + 0.2, end)
    role.reach(side, hover, weight, elbow=elbow)
    for moment in moments:
        on = Span(moment, moment + 0.1)
        stage.lay_on(
            role, side, point, away, on=on, start=moment - 0.17, end=moment + 0.3, elbow=elbow
        )


def circling(stage: Stage, on: Span, offset: ArrayLike, radius: float, hertz: float) -> NDArray:
    """Return places ``[T, 3]`` m that circle over the back of a body at a constant distance.

    Args:
        stage: The stage.
        on: When; before and after, the hand rests.
        offset: ``[3]`` m, middle of the circle, mostly along x.
        radius: Of the circle, m at ordinary amplitude.
        hertz: Circles a second at ordinary tempo.
    """
    middle = np.asarray(offset, dtype=float)
    across = stage.rhythm(on, hertz, radius)
    along = np.roll(across, max(1, round(0.25 * 30 / hertz)))
    places = middle + np.column_stack([np.zeros(len(across)), across, along])
    return places * (np.linalg.norm(middle) / np.linalg.norm(places, axis=1))[:, None]
