"""How near two people stand, solved from what they do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from scipy.optimize import brentq

from generator.choreographer.arms import extension
from generator.choreographer.clearance import LEGS, TRUNK, clearances
from generator.choreographer.pose import Pose
from generator.choreographer.role import Role
from generator.choreographer.stage import Stage
from generator.choreographer.trunk import pose_head, pose_trunk

Pair = tuple[Pose, Pose]
Attempt = Callable[[float], tuple[Stage, Pair]]
"""Plays an interaction with a given distance, up to the trunks."""

NEAREST, FARTHEST = 0.15, 1.9
"""Range of distances between pelvises that is searched, m."""
USUAL = 0.8
"""Where the search starts, m."""


@dataclass(frozen=True, slots=True)
class ByReach:
    """Stand so that the longest reach of a touch takes a given share of the arm."""

    share: float = 0.85
    """0..0.92; the style's distance changes it a little."""
    room: float = 0.18
    """Least gap between trunks and legs, m."""


@dataclass(frozen=True, slots=True)
class ByTouch:
    """Stand so that trunks or legs come as near as a given gap, but no closer."""

    gap: float = 0.0
    """Gap between the bodies, m; negative presses soft bodies together."""


@dataclass(frozen=True, slots=True)
class Apart:
    """Stand at a given distance."""

    distance: float = 1.5
    """Between the pelvises, m for people of 1.70 m; times the style's distance."""
    least: float = 0.0
    """Shortest distance whatever the style, m for people of 1.70 m."""


Spacing = ByReach | ByTouch | Apart


def solve(spacing: Spacing, attempt: Attempt) -> tuple[Stage, Pair]:
    """Return the performance at the right distance.

    Extension and gaps grow with the distance, so each question has one answer, found by Brent's
    method: the distance at which hands still meet at ease, unless bodies are then too close, or the
    distance at which bodies just touch.
    """
    play = cache(attempt)
    stage, _ = play(USUAL)
    if isinstance(spacing, Apart):
        wide = max(spacing.distance * stage.style.distance, spacing.least)
        return play(wide * stage.scale)
    if isinstance(spacing, ByTouch):
        return play(_root(lambda near: body_gap(play(near)[1]) - spacing.gap, 0.002))
    share = min(spacing.share * (1 + 0.25 * (stage.style.distance - 1)), 0.91)
    near = _root(lambda near: extension(play(near)[1]) - share, 0.008)
    if body_gap(play(near)[1]) < spacing.room:
        near = _root(lambda near: body_gap(play(near)[1]) - spacing.room, 0.008)
    return play(near)


def body_gap(pair: Pair) -> float:
    """Return the least gap between the trunks and legs of two people over time, m."""
    # Every other frame is enough: nothing moves more than a centimetre or two in between.
    first, second = ((p.role.build.skeleton, p.points[::2], p.role.build.scale) for p in pair)
    gaps = clearances((first, second), TRUNK + LEGS)
    return min(float(gap.min()) for gap in gaps.values())


def _root(excess: Callable[[float], float], tolerance: float) -> float:
    """Return the distance at which a growing function crosses zero, or the end that is nearer."""
    far_side = excess(USUAL) < 0.0
    low, high = (USUAL, FARTHEST) if far_side else (NEAREST, USUAL)
    if (excess(high) if far_side else -excess(low)) <= 0.0:
        return high if far_side else low
    return float(brentq(excess, low, high, xtol=tolerance))  # type: ignore[arg-type]


def pose_trunks(stage: Stage) -> Pair:
    """Return both bodies of a stage without arms."""
    return pose_pair(stage.people, (stage.style.energy, stage.style.energy))


def pose_pair(roles: tuple[Role, Role], energies: tuple[float, float]) -> Pair:
    """Return two bodies without arms, each of which may look at the other."""
    first, second = (pose_trunk(role, e) for role, e in zip(roles, energies, strict=True))
    pose_head(first, second)
    pose_head(second, first)
    return first, second
