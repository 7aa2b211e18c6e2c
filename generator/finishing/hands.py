"""Touches are closed: hands go where they should meet, and come back smoothly.

**The problem.** Hands that should meet miss each other by 5 to 30 cm. During a touch both hands of
a pair are given half of the way each; what one arm does not reach is left to the other (the two
spheres of reach are projected onto in turn), and what neither reaches to the trunk, which leans at
its lowest joint. A hand that touches a body goes there alone. Before and after, offsets come and
go over a time that grows with their size, so that hands do not dash.

The pair keeps the direction in which it was apart; where it has none, that from shoulder to
shoulder, so that each hand stays on its own side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from generator.choreographer.frames import dot
from generator.finishing.corrections import bridge
from generator.finishing.figure import Figure
from generator.finishing.limbs import move_end, smallest_turn
from generator.finishing.settings import Finishing
from generator.finishing.touches import HANDS
from generator.kinematics import unit
from generator.motion import Contact
from robots.skeleton import FloatArray

_ROUNDS = 3
_MET = 0.001
"""Miss that is left alone, m."""
_REACH = 0.97
"""Longest arm, shoulder to knuckle, as a share of the straight one."""
_SPEED = 0.6
"""Mean speed at which an offset comes and goes, m/s."""
_EASE = (0.25, 0.7)
"""Shortest and longest time in which it does, s."""
_LEAN = 0.20
"""Farthest that shoulders are moved by leaning, m per round."""
_SOFT = 0.1
"""Low-pass on leaning, s."""
_OWN_SIDE = 0.03
"""Weight of the direction from shoulder to shoulder, m, against that between the points."""


@dataclass(frozen=True, slots=True, eq=False)
class _Touch:
    """A contact on the clock of the figures."""

    contact: Contact
    at: slice
    """Frames in which it holds."""


def close_touches(
    figures: tuple[Figure, Figure], fps: float, contacts: Sequence[Contact], settings: Finishing
) -> dict[str, float]:
    """Bring the points of contacts together.

    Args:
        figures: Are changed.
        fps: Frames per second.
        contacts: Touches; those that miss by more than :attr:`Finishing.max_gap`, or that involve
            no hand, are left as they are.
        settings: Bounds.

    Returns:
        How many contacts were closed and given up, and the largest miss before and after, m.
    """
    misses = [missed_by(figures, fps, contact) for contact in contacts]
    believed = [
        _Touch(contact, frames_of(contact, fps, len(figures[0])))
        for contact, miss in zip(contacts, misses, strict=True)
        if miss <= settings.max_gap and {contact.a, contact.b} & set(HANDS)
    ]
    for _ in range(_ROUNDS):
        if max((float(np.abs(_miss(figures, t)).max()) for t in believed), default=0.0) < _MET:
            break
        for figure, goals in zip(figures, _goals(figures, believed, fps), strict=True):
            _lean(figure, goals, fps)
            for hand, goal in goals.items():
                side = hand.removesuffix("_hand")
                move_end(figure, f"{side}_shoulder", f"{side}_elbow", hand, goal)
    after = max((float(np.abs(_miss(figures, t)).max()) for t in believed), default=0.0)
    return {
        "touches": float(len(believed)),
        "given_up": float(len(contacts) - len(believed)),
        "missed": max(misses, default=0.0),
        "missing": after,
    }


def missed_by(figures: tuple[Figure, Figure], fps: float, contact: Contact) -> float:
    """Return by how much a touch is too wide or too tight at its worst moment, m."""
    touch = _Touch(contact, frames_of(contact, fps, len(figures[0])))
    return float(np.abs(_miss(figures, touch)).max())


def frames_of(contact: Contact, fps: float, count: int) -> slice:
    """Return the frames of a contact: one at least."""
    start = min(max(int(np.ceil(contact.start * fps - 1e-6)), 0), count - 1)
    return slice(start, min(max(int(contact.end * fps + 1e-6), start), count - 1) + 1)


def _miss(figures: tuple[Figure, Figure], touch: _Touch) -> FloatArray:
    """Return by how much a touch is too wide ``[K]`` m; negative if too tight."""
    a, b = figures
    apart = b.point(touch.contact.b)[touch.at] - a.point(touch.contact.a)[touch.at]
    return np.linalg.norm(apart, axis=1) - touch.contact.gap


def _goals(
    figures: tuple[Figure, Figure], touches: Sequence[_Touch], fps: float
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return where the hands of both go ``[T, 3]`` m, for those that touch something."""
    count = len(figures[0])
    offsets: tuple[dict[str, FloatArray], ...] = ({}, {})
    given: tuple[dict[str, NDArray[np.bool_]], ...] = ({}, {})
    for touch in touches:
        names = touch.contact.a, touch.contact.b
        for person, moved in enumerate(_meeting(figures, touch, fps)):
            if names[person] not in HANDS:
                continue
            own = offsets[person].setdefault(names[person], np.zeros((count, 3)))
            held = given[person].setdefault(names[person], np.zeros(count, dtype=bool))
            own[touch.at], held[touch.at] = moved, True
    goals: tuple[dict[str, FloatArray], dict[str, FloatArray]] = ({}, {})
    for person, figure in enumerate(figures):
        for hand, offset in offsets[person].items():
            farthest = float(np.linalg.norm(offset, axis=1).max())
            ease = round(float(np.clip(farthest / _SPEED, *_EASE)) * fps)
            goals[person][hand] = figure.point(hand) + bridge(offset, given[person][hand], ease)
    return goals


def _meeting(
    figures: tuple[Figure, Figure], touch: _Touch, fps: float
) -> tuple[FloatArray, FloatArray]:
    """Return by how much the two points of a touch move ``[K, 3]`` m each."""
    names = touch.contact.a, touch.contact.b
    points = [f.point(n)[touch.at] for f, n in zip(figures, names, strict=True)]
    limits = [_reach(f, n, touch.at) for f, n in zip(figures, names, strict=True)]
    between = gaussian_filter1d(
        figures[1].point(names[1]) - figures[0].point(names[0]), 0.1 * fps, axis=0, mode="nearest"
    )[touch.at]
    if limits[0] and limits[1]:
        between = between + _OWN_SIDE * unit(limits[1][0] - limits[0][0])
    gap = touch.contact.gap * unit(between)
    miss = points[1] - points[0] - gap
    share = 0.5 if limits[0] and limits[1] else float(limits[0] is not None)
    first = points[0] + share * miss
    if limits[0] and limits[1]:
        for _ in range(4):
            second = _within(first + gap, *limits[1])
            first = _within(second - gap, *limits[0])
        # What is still missing is shared: each leans for a half of it.
        left = _within(first + gap, *limits[1]) - first - gap
        first = first + 0.5 * left
    return first - points[0], first + gap - points[1]


def _reach(figure: Figure, name: str, at: slice) -> tuple[FloatArray, FloatArray] | None:
    """Return shoulder ``[K, 3]`` m and reach ``[K]`` m of the arm of a hand."""
    if name not in HANDS:
        return None
    shoulder = figure.point(f"{name.removesuffix('_hand')}_shoulder")[at]
    extended = np.linalg.norm(figure.point(name)[at] - shoulder, axis=1)
    return shoulder, np.maximum(_REACH * _arm(figure, name), extended)


def _arm(figure: Figure, hand: str) -> float:
    """Return the length of a straight arm, shoulder to knuckle, m."""
    side, lengths = hand.removesuffix("_hand"), figure.skeleton.bone_lengths
    upper, lower = (lengths[figure.skeleton.index(f"{side}_{n}")] for n in ("elbow", "wrist"))
    return float(upper + lower * (1 + figure.skeleton.hand_per_forearm))


def _within(goal: NDArray, shoulder: NDArray, reach: NDArray) -> FloatArray:
    """Return goals ``[K, 3]`` m drawn back to the sphere that an arm reaches."""
    span = goal - shoulder
    length = np.linalg.norm(span, axis=1)
    return shoulder + span * np.minimum(1.0, reach / np.maximum(length, 1e-9))[:, None]


def _lean(figure: Figure, goals: dict[str, FloatArray], fps: float) -> None:
    """Bend the trunk towards hands that do not reach their goals."""
    wanted = np.zeros((len(figure), 3))
    for hand, goal in goals.items():
        span = goal - figure.point(f"{hand.removesuffix('_hand')}_shoulder")
        length = np.linalg.norm(span, axis=1)
        reach = np.maximum(_REACH * _arm(figure, hand), _extension(figure, hand))
        short = np.clip(length - reach, 0.0, _LEAN)
        size = 2 * round(_SOFT * fps) + 1
        short = maximum_filter1d(short, size, mode="nearest")
        wanted += gaussian_filter1d(short, 0.5 * _SOFT * fps, mode="nearest")[:, None] * unit(span)
    if not wanted.any():
        return
    spine = figure.point("neck") - figure.point("spine1")
    figure.bend("spine1", smallest_turn(spine, spine + wanted))


def _extension(figure: Figure, hand: str) -> FloatArray:
    span = figure.point(hand) - figure.point(f"{hand.removesuffix('_hand')}_shoulder")
    return np.sqrt(dot(span, span))
