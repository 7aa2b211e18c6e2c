"""Two robots keep out of each other: a task that pushes overlapping bodies apart."""

from __future__ import annotations

from typing import Any

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

ROWS = 16
"""Deepest overlaps that are looked at in one solve."""


class AvoidTask(mink.Task):
    """Keeps geoms of one robot a distance away from those of the other.

    MuJoCo finds the near pairs. With ``n`` the contact's normal from the first to the second body
    and ``d`` their distance, the error is ``max(0, clearance - d)`` and its derivative
    ``-n (J_second - J_first)`` at the contact's point. A soft task, not a limit: hands that are
    meant to touch may, and there is always a solution.
    """

    def __init__(self, model: Any, clearance: float, cost: float) -> None:
        """Look at geoms nearer than ``clearance`` m with a cost in 1/m."""
        super().__init__(cost=np.full(ROWS, cost))
        self._clearance = clearance
        self._owner = model.body_rootid[model.geom_bodyid]
        # A margin makes MuJoCo report pairs before they touch; the sum of both counts.
        robots = self._owner > 0
        model.geom_margin[robots] = np.maximum(model.geom_margin[robots], clearance)
        self._rows: list[tuple[float, NDArray, NDArray, int, int]] = []

    def compute_error(self, configuration: mink.Configuration) -> NDArray:
        """Return how much each of the nearest pairs lacks of the clearance ``[ROWS]`` m."""
        model, data = configuration.model, configuration.data
        mujoco.mj_collision(model, data)
        found = []
        for contact in data.contact[: data.ncon]:
            one, other = self._owner[contact.geom1], self._owner[contact.geom2]
            if one and other and one != other and contact.dist < self._clearance:
                bodies = model.geom_bodyid[[contact.geom1, contact.geom2]]
                lack = self._clearance - contact.dist
                found.append((lack, contact.frame[:3].copy(), contact.pos.copy(), *bodies))
        self._rows = sorted(found, key=lambda row: -row[0])[:ROWS]
        error = np.zeros(ROWS)
        error[: len(self._rows)] = [row[0] for row in self._rows]
        return error

    def compute_jacobian(self, configuration: mink.Configuration) -> NDArray:
        """Return the derivative ``[ROWS, nv]`` of the error of the same pairs."""
        model, data = configuration.model, configuration.data
        out = np.zeros((ROWS, model.nv))
        first, second = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for row, (_, normal, point, one, other) in enumerate(self._rows):
            mujoco.mj_jac(model, data, first, None, point, one)
            mujoco.mj_jac(model, data, second, None, point, other)
            out[row] = -normal @ (second - first)
        return out
