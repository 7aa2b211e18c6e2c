"""Turns joints back that are bent further than joints go.

**The problem.** A network that is to follow a word more than it has seen people do overshoots: the
back of a *deep* bow was bent by 30 degrees beyond what backs do, and the report's gate refused it.
So each joint of :data:`robots.ranges.RANGES` that is out of range is turned back to the end of it,
about the axis that it is bent about; what hangs on it goes along.
"""

from __future__ import annotations

import numpy as np

from generator.finishing.figure import Figure, turn_about
from robots.ranges import RANGES, bones_at


def unbend(figure: Figure) -> float:
    """Change a body so that no joint is out of range; return the largest turn, degrees."""
    largest = 0.0
    for name, (_, most) in RANGES.items():  # from the pelvis outwards
        before, after, angle = bones_at(figure.points, figure.skeleton, name)
        excess = np.maximum(angle - most, 0.0)
        if not excess.any():
            continue
        axis = np.cross(after, before)
        axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
        figure.bend(name, turn_about(np.radians(excess)[:, None] * axis))
        largest = max(largest, float(excess.max()))
    return largest
