"""Where two people stand to each other, other than face to face: in a file, side by side."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise
from generator.choreographer.stage import CALM, TOP_SPEED, Stage


def in_file(stage: Stage, arrive: float, travel: tuple[float, float] = (0.3, 0.7)) -> None:
    """Let the first role come up behind the second, who stands with the back to it.

    Args:
        stage: The stage.
        arrive: Moment the first is there, s.
        travel: Range from which the walk is drawn, m.
    """
    first, second = stage.people
    walk = _walk(stage, arrive, travel)
    first.path[:, 0] -= 0.5 * stage.near + walk * (1.0 - rise(stage.times, CALM, arrive))
    second.path[:, 0] += 0.5 * stage.near


def side_by_side(
    stage: Stage,
    arrive: float,
    travel: tuple[float, float] = (0.0, 0.0),
    turned: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Let the first role come to the left of the second; both look the same way.

    Args:
        stage: The stage.
        arrive: Moment the first is there, s.
        travel: Range from which the first's walk, from the left, is drawn, m.
        turned: How far each turns towards the other, rad.
    """
    first, second = stage.people
    walk = _walk(stage, arrive, travel)
    first.path[:, 1] += 0.5 * stage.near + walk * (1.0 - rise(stage.times, CALM, arrive))
    second.path[:, 1] -= 0.5 * stage.near
    first.heading -= turned[0]
    second.heading += turned[1]


def stagger(stage: Stage, start: float, end: float, stride: float = 0.14) -> None:
    """Let both put one foot forward and the other back for a while, m at 1.70 m."""
    times = stage.times
    on = rise(times, start, start + 0.3) - rise(times, end - 0.3, end)
    for role in stage.people:
        ahead, behind = ("left", "right")
        nothing = np.zeros(len(times))
        role.footing[ahead] = np.column_stack([stride * on, nothing, nothing])
        role.footing[behind] = np.column_stack([-stride * on, 0.02 * on, 0.25 * on])


def _walk(stage: Stage, arrive: float, travel: tuple[float, float]) -> float:
    """Return how far somebody comes to be there in time at a human pace, m."""
    return min(stage.pick(*travel), TOP_SPEED * (arrive - CALM) / 1.875)
