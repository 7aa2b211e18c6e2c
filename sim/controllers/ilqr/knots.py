"""The derivatives along a plan, taken anew only where the plan has moved.

**The problem.** A plan of 30 knots made 15 times a second takes derivatives at each moment seven
times over, and they are nine tenths of the cost. Most of these states differ from the last plan's
by less than a degree; what they share with it is the linear map. So a knot's derivatives are kept
for its tick until its state, velocity or control has moved too far, or other bodies touch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from robots.skeleton import FloatArray
from sim.controllers.ilqr.linearize import Linearizer
from sim.controllers.ilqr.person import PersonModel

_MOVED = 0.01, 0.3, 0.05
"""Unit of change of qpos (m or half rad), qvel (m/s, rad/s) and controls (rad)."""


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """States and controls along a plan; H knots and the state they lead to."""

    qpos: FloatArray
    """``[H+1, nq]``."""
    qvel: FloatArray
    """``[H+1, nv]``."""
    control: FloatArray
    """``[H, nu]``."""
    warmstart: FloatArray
    """``[H, nv]`` accelerations that the constraint solver starts from."""
    touching: list[int]
    """``[H]``: a number that changes when other bodies touch."""
    cost: float
    push: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """``[H, 2]`` N: level force on a ghost that yields."""


Prepare = Callable[[Any, int], None]
"""Given ``mujoco.MjData`` and a tick, sets what of the world changes by itself."""


class KnotDerivatives:
    """Derivatives per tick, kept while they hold."""

    def __init__(self, person: PersonModel, tolerance: float, *, exact: bool) -> None:
        """Prepare.

        Args:
            person: Whose step.
            tolerance: How far a knot may move; see ``IlqrSettings.cache``.
            exact: Passed to :class:`Linearizer`.
        """
        self.tolerance = tolerance
        self.asked = self.taken = self.repaired = 0
        self._person = person
        self._data = mujoco.MjData(person.model)
        self._linearize = Linearizer(person.model, exact=exact)
        self._kept: dict[int, tuple[FloatArray, FloatArray, FloatArray, int, FloatArray]] = {}

    def along(self, tick: int, path: Path, prepare: Prepare) -> FloatArray:
        """Return ``[A B]`` as one array ``[H, 2 nv, 2 nv + nu]`` of a path from a tick on."""
        nv, nu = self._person.nv, self._person.nu
        out = np.empty((len(path.control), 2 * nv, 2 * nv + nu))
        for h in range(len(path.control)):
            out[h] = self._at(tick + h, h, path, prepare)
        self.asked += len(path.control)
        self._kept = {t: kept for t, kept in self._kept.items() if t >= tick}
        return out

    def forget(self) -> None:
        """Take everything anew from now on."""
        self._kept.clear()

    def _at(self, tick: int, h: int, path: Path, prepare: Prepare) -> FloatArray:
        qpos, qvel, control = path.qpos[h], path.qvel[h], path.control[h]
        kept = self._kept.get(tick) if self.tolerance > 0 else None
        if kept is not None and kept[3] == path.touching[h]:
            moved = (
                np.abs(now - then).max() / unit
                for now, then, unit in zip((qpos, qvel, control), kept[:3], _MOVED, strict=True)
            )
            if all(m < self.tolerance for m in moved):
                return kept[4]
        made = self._take(tick, h, path, prepare)
        if self.tolerance > 0:
            self._kept[tick] = (qpos, qvel, control, path.touching[h], made)
        return made

    def _take(self, tick: int, h: int, path: Path, prepare: Prepare) -> FloatArray:
        person, data = self._person, self._data
        nv = person.nv
        data.qpos[:], data.qvel[:] = path.qpos[h], path.qvel[h]
        prepare(data, tick)
        data.ctrl[person.targets] = path.control[h]
        data.qacc_warmstart[:] = path.warmstart[h]
        A, B = np.empty((2 * nv, 2 * nv)), np.empty((2 * nv, person.model.nu))
        self.taken += 1
        if not self._linearize(data, A, B):
            self.repaired += 1
        return np.concatenate([A, B[:, person.targets]], axis=1)


def touching(data: Any) -> int:
    """Return a number that changes when other bodies touch."""
    return data.ncon * 4096 + (int(data.contact.geom.sum()) if data.ncon else 0)
