"""People who are too far apart for what they are meant to touch come nearer, each as a whole.

**The problem.** A network puts people a decimetre or two off their places. Arms can make up for
that, but two people who hold hands at arms' length, or lean to, look as if they could not reach.
So what hands miss each other by along the floor, beyond what arms are left to close, is taken from
the places of the people, half each. They are moved by one and the same way all the time, so that
nobody slides. Of several touches, and of the moments of a long one, the worst is served, then the
worst of what is left: projections onto the places from which each can be closed.

Example: at a handshake the hands miss each other by 30 cm, all of it along the floor. Both people
are moved by 9 cm towards each other; arms close the remaining 12 cm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from generator.finishing.apart import TOLERATED, overlap
from generator.finishing.figure import Figure
from generator.finishing.hands import frames_of
from generator.finishing.settings import Finishing
from generator.finishing.touches import HANDS
from generator.kinematics import unit
from generator.motion import Contact
from robots.skeleton import FloatArray

_ARMS = 0.12
"""Miss along the floor that arms and trunk are left to close, m."""
_ROUNDS = 20
_ENOUGH = 0.001
"""Step that is not worth while, m."""
_SHARES = (1.0, 0.75, 0.5, 0.25)
"""Of the way that is tried before it would bring bodies into each other."""


def step_nearer(
    figures: tuple[Figure, Figure], fps: float, contacts: Sequence[Contact], settings: Finishing
) -> float:
    """Move two people towards each other for touches, and return how far each was moved, m.

    Args:
        figures: Are changed.
        fps: Frames per second.
        contacts: Touches; those without hands, and those that miss by more than people may be
            moved and hands may close, are left out.
        settings: Bounds.
    """
    most = 2 * settings.max_step
    between, gaps = [], []
    for contact in contacts:
        at = frames_of(contact, fps, len(figures[0]))
        apart = figures[1].point(contact.b)[at] - figures[0].point(contact.a)[at]
        miss = np.linalg.norm(apart, axis=1) - contact.gap
        if {contact.a, contact.b} & set(HANDS) and miss.max() <= settings.max_gap + most:
            between.append(apart)
            gaps.append(np.full(len(apart), contact.gap))
    if not between:
        return 0.0
    way = _way(np.concatenate(between), np.concatenate(gaps), most)
    if np.linalg.norm(way) < _ENOUGH:
        return 0.0
    allowed = max(TOLERATED, float(overlap(figures).max()))
    for share in _SHARES:
        moved = _moved(figures, 0.5 * share * way)
        if overlap(moved).max() <= allowed:
            for figure, other in zip(figures, moved, strict=True):
                figure.points = other.points
            return float(0.5 * share * np.linalg.norm(way))
    return 0.0


def _way(between: FloatArray, gaps: FloatArray, most: float) -> FloatArray:
    """Return by how much b moves against a ``[2]`` m along the floor.

    Args:
        between: ``[K, 3]`` m, from points of a to those of b that are to be ``gaps [K]`` m apart.
        gaps: See there.
        most: Longest way, m.
    """
    way, best, least = np.zeros(2), np.zeros(2), np.inf
    for _ in range(_ROUNDS):
        needs = _needs(between + np.append(way, 0.0), gaps)
        sizes = np.linalg.norm(needs, axis=1)
        worst = int(np.argmax(sizes))
        if sizes[worst] < least - _ENOUGH:
            best, least = way, float(sizes[worst])
        if sizes[worst] < _ENOUGH:
            break
        way = way + needs[worst]
        way = way * min(1.0, most / max(float(np.linalg.norm(way)), 1e-9))
    return best


def _needs(between: FloatArray, gaps: FloatArray) -> FloatArray:
    """Return by how much b should still come nearer ``[K, 2]`` m at each moment."""
    wide = np.maximum(np.linalg.norm(between, axis=1) - gaps, 0.0)
    level = -(wide[:, None] * unit(between))[:, :2]
    size = np.linalg.norm(level, axis=1)
    return level * (np.maximum(size - _ARMS, 0.0) / np.maximum(size, 1e-9))[:, None]


def _moved(figures: tuple[Figure, Figure], half: FloatArray) -> tuple[Figure, Figure]:
    """Return the two people where they would stand: b moved by ``half [2]`` m, a against it."""
    a, b = (figure.copy() for figure in figures)
    step = np.tile(np.append(half, 0.0), (len(a), 1))
    a.shift(-step)
    b.shift(step)
    return a, b
