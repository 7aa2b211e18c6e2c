"""Moves the end of a limb of two bones by bending what is there.

**The problem.** Posing a limb anew from where its ends are loses how it was spun and jumps wherever
it is straight. So the limb is changed by two turns: the middle folds about the axis that it is bent
about already (the body's own hinge where the limb is straight), until the ends are as far apart as
they should be; then the whole turns by the smallest rotation that brings the end to its place. No
change of place is no change of pose, and small ones are small.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.choreographer.frames import apply, dot
from generator.finishing.figure import Figure, turn_about
from generator.kinematics import unit
from robots.skeleton import FloatArray

HINGES = {
    "left_hip": (0.0, 1.0, 0.0),
    "right_hip": (0.0, 1.0, 0.0),
    "left_shoulder": (0.0, 0.0, -1.0),
    "right_shoulder": (0.0, 0.0, 1.0),
}
"""Axis about which the middle of a limb bends, in the rest frame of its upper bone."""

_FOLDS, _FOLDED = 4, 1e-7
"""Folds at most, and the angle, rad, that needs none: about a hinge across the limb's own plane one
fold comes short."""
_CLEAR = 0.15
"""Sine of the bend from which the limb's own plane counts alone."""


def move_end(figure: Figure, upper: str, middle: str, end: str, goal: NDArray) -> None:
    """Bring the end of a limb to ``goal [T, 3]`` m, or as near as the limb reaches.

    Args:
        figure: Whose limb; what hangs on its end keeps its angle to the lower bone.
        upper: Keypoint where the limb hangs.
        middle: Keypoint where it bends.
        end: A keypoint, or ``left_hand`` / ``right_hand``, in line with the lower bone.
        goal: World.
    """
    wanted = goal - figure.point(upper)
    distance = np.linalg.norm(wanted, axis=1)
    for _ in range(_FOLDS):
        first = figure.point(middle) - figure.point(upper)
        second = figure.point(end) - figure.point(middle)
        hinge = apply(figure.frame(upper), HINGES[upper])
        axis, angle = _fold(first, second, hinge, distance)
        if np.abs(angle).max() < _FOLDED:
            break
        figure.bend(middle, turn_about(axis * angle[:, None]))
    span = figure.point(end) - figure.point(upper)
    figure.bend(upper, smallest_turn(span, wanted))


def _fold(
    first: NDArray, second: NDArray, hinge: NDArray, distance: NDArray
) -> tuple[FloatArray, FloatArray]:
    """Return axis ``[T, 3]`` and angle ``[T]`` rad that make the ends be a distance apart."""
    a, b = np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)
    normal = np.cross(first, second)
    sine = np.linalg.norm(normal, axis=1) / np.maximum(a * b, 1e-12)
    share = np.clip(sine / _CLEAR, 0.0, 1.0)[:, None]
    share = share * share * (3 - 2 * share)
    axis = unit(normal) * share + hinge * (1 - share)
    along = unit(first)
    axis = unit(axis - along * dot(axis, along)[:, None])
    reach = np.clip(distance, np.abs(a - b) + 1e-6, a + b - 1e-6)
    square = np.maximum(2 * a * b, 1e-12)  # a limb of no length has no bend
    bend = np.arccos(np.clip((reach**2 - a**2 - b**2) / square, -1.0, 1.0))
    now = np.arctan2(sine * a * b, dot(first, second))
    return axis, bend - now


def smallest_turn(start: NDArray, end: NDArray) -> FloatArray:
    """Return the smallest rotations ``[T, 3, 3]`` that take directions to directions."""
    start, end = unit(start), unit(end)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, dot(start, end))
    return turn_about(unit(axis) * angle[:, None])
