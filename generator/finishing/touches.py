"""Where and when two people are meant to touch, if nobody said so.

**The problem.** Hands that come near may be about to meet, or may only hang beside each other. Two
hands are taken to be meant to touch if both are raised above the pelvis, come within the bound of
:attr:`Finishing.detect_gap` and stay so for a moment at low relative speed. A caller who knows what
the two do can name the pairs of points instead; each then touches where it comes nearest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from generator.choreographer.clearance import ARMS, LEGS, TRUNK
from generator.finishing.corrections import runs
from generator.finishing.figure import Figure
from generator.finishing.settings import Finishing
from generator.motion import LEFT_HAND, RIGHT_HAND, Contact
from robots.skeleton import FloatArray

HANDS = (LEFT_HAND, RIGHT_HAND)
HAND_GAP = 0.06
"""Distance between the knuckles of two hands that hold each other, m."""
HALF_HAND = 0.03
"""Thickness of a hand beyond its knuckle, m."""

_SLOW = 0.5
"""Relative speed below which two hands may be touching, m/s."""
_SHORTEST = 0.2
"""Shortest touch that is found, s."""
_NEAREST = 0.03
"""How much farther apart than at their nearest two points still touch, m."""
_LOOK = 0.05
"""Low-pass before speeds are judged, s."""

_OTHER = {"left": "right", "right": "left"}

Pair = tuple[str, str]
"""A point of person a and one of person b."""


class Meeting(NamedTuple):
    """Two points that are meant to touch at some time."""

    a: str
    """Point of person a."""
    b: str
    """Point of person b."""
    start: float = 0.0
    """Earliest moment, s."""
    end: float = math.inf
    """Latest moment, s."""
    either: bool = False
    """Whether their mirror images may touch instead."""

    @property
    def pair(self) -> Pair:
        """Its points."""
        return self.a, self.b

    def met_by(self, touch: Contact) -> bool:
        """Return whether a touch is of these points and in their time."""
        pairs = {self.pair, mirrored(self.pair)} if self.either else {self.pair}
        return (touch.a, touch.b) in pairs and touch.start <= self.end and self.start <= touch.end


def find_touches(
    figures: tuple[Figure, Figure], fps: float, settings: Finishing
) -> tuple[Contact, ...]:
    """Return the touches of two hands that nobody announced; no hand touches two at a time."""
    found: list[tuple[float, Contact]] = []
    for pair in product(HANDS, HANDS):
        paths = [figure.point(name) for figure, name in zip(figures, pair, strict=True)]
        between = gaussian_filter1d(paths[1] - paths[0], _LOOK * fps, axis=0, mode="nearest")
        distance = np.linalg.norm(between, axis=1)
        speed = np.linalg.norm(np.gradient(between, axis=0), axis=1) * fps
        raised = [
            path[:, 2] > figure.point("pelvis")[:, 2]
            for path, figure in zip(paths, figures, strict=True)
        ]
        near = (distance < HAND_GAP + settings.detect_gap) & (speed < _SLOW)
        for at in runs(near & raised[0] & raised[1]):
            if at.stop - at.start >= _SHORTEST * fps:
                contact = _contact(pair, distance, at, fps)
                found.append((float(distance[at].min()), contact))
    return without_conflicts([contact for _, contact in sorted(found, key=lambda f: f[0])])


def nearest_touches(
    figures: tuple[Figure, Figure], fps: float, meetings: Sequence[Meeting]
) -> tuple[Contact, ...]:
    """Return one touch for each meeting: where its points are nearest to each other."""
    touches = []
    for meeting in settled(figures, fps, meetings):
        course = _course(figures, meeting.pair, fps)
        touches.append(_contact(meeting.pair, course, _span(meeting, len(course), fps), fps))
    return tuple(touches)


def settled(
    figures: tuple[Figure, Figure], fps: float, meetings: Sequence[Meeting]
) -> tuple[Meeting, ...]:
    """Return the meetings with the question of mirror images answered.

    All meetings of one time are taken as they are, or all in the mirror: whichever way the points
    are nearer to each other. One by one, the two grips of a circle would both become the nearer.
    """

    def distance(pair: Pair, meeting: Meeting) -> float:
        course = _course(figures, pair, fps)
        return float(course[_span(meeting, len(course), fps)].min())

    surplus: dict[tuple[float, float], float] = {}
    for meeting in meetings:
        if meeting.either:
            more = distance(meeting.pair, meeting) - distance(mirrored(meeting.pair), meeting)
            time = meeting.start, meeting.end
            surplus[time] = surplus.get(time, 0.0) + more
    return tuple(
        Meeting(
            *(mirrored(m.pair) if m.either and surplus[m.start, m.end] > 0 else m.pair),
            m.start,
            m.end,
        )
        for m in meetings
    )


def _span(meeting: Meeting, frames: int, fps: float) -> slice:
    """Return the frames, one at least, in which a meeting may be."""
    last = frames - 1
    first = min(round(meeting.start * fps), last)
    return slice(first, max(first, round(min(meeting.end * fps, last))) + 1)


def _course(figures: tuple[Figure, Figure], pair: Pair, fps: float) -> FloatArray:
    """Return the distance of two points over time ``[T]`` m."""
    paths = [figure.point(name) for figure, name in zip(figures, pair, strict=True)]
    between = gaussian_filter1d(paths[1] - paths[0], _LOOK * fps, axis=0, mode="nearest")
    return np.linalg.norm(between, axis=1)


def mirrored(pair: Pair) -> Pair:
    """Return a pair of points as in a mirror."""
    return _mirrored(pair[0]), _mirrored(pair[1])


def _mirrored(name: str) -> str:
    side, _, rest = name.partition("_")
    return f"{_OTHER[side]}_{rest}" if side in _OTHER else name


def _contact(pair: Pair, distance: FloatArray, at: slice, fps: float) -> Contact:
    """Return the touch of a pair around its nearest moment within a slice of time."""
    first = at.start or 0
    course = distance[at]
    nearest = int(np.argmin(course))
    near: NDArray[np.bool_] = course < course[nearest] + _NEAREST
    spell = next(run for run in runs(near) if run.start <= nearest < run.stop)
    start, stop = first + spell.start, first + spell.stop - 1
    return Contact(*pair, start / fps, stop / fps, touching_gap(pair))


def touching_gap(pair: Pair) -> float:
    """Return how far apart two points are when a person of 1.70 m touches another there, m."""
    if pair[0] in HANDS and pair[1] in HANDS:
        return HAND_GAP
    return sum(HALF_HAND if name in HANDS else _radius(name) for name in pair)


def _radius(name: str) -> float:
    """Return the thickness of the body around a keypoint, m."""
    sizes = [c.radius for c in TRUNK + LEGS + ARMS if name in (c.start, c.end)]
    return max(sizes, default=0.08)


def without_conflicts(contacts: Sequence[Contact]) -> tuple[Contact, ...]:
    """Return the contacts, the first ones first, that leave each hand one partner at a time."""
    kept: list[Contact] = []
    for contact in contacts:
        if not any(
            (contact.a == other.a or contact.b == other.b)
            and contact.start <= other.end
            and other.start <= contact.end
            for other in kept
        ):
            kept.append(contact)
    return tuple(sorted(kept, key=lambda c: c.start))
