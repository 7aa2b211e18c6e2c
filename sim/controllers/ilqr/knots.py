"""The derivatives along a plan, taken anew only where the plan has moved.

**The problem.** A plan of 30 knots made 15 times a second takes derivatives at each moment seven
times over, and they are most of the cost. But most of these states differ from the last plan's by
less than a degree, and so do most from the one a tick before; what they share is the linear map. So
derivatives are kept, and serve their tick and the ones beside it until the state, velocity or
control there is too far from where they were taken, or other bodies touch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray
from sim.controllers.ilqr.linearize import Linearizer
from sim.controllers.ilqr.person import PersonModel
from sim.controllers.ilqr.riccati import Dynamics

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
    touching: list[bytes]
    """``[H]``: which geoms touch; see :func:`touching`."""
    cost: float
    pull: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """``[H+1, 2 nv]``: gradient of the cost of the states, without touches."""
    push: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """``[H, 2]`` N: level force on a ghost that yields."""


_Change = NDArray[np.float32]

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
        self._kept: dict[int, tuple[FloatArray, FloatArray, FloatArray, bytes, _Change]] = {}

    def along(self, tick: int, path: Path, prepare: Prepare) -> Dynamics:
        """Return the linear dynamics along a path from a tick on."""
        H = len(path.control)
        change = [self._at(tick + h, h, path, prepare) for h in range(H)]
        self.asked += H
        self._kept = {t: kept for t, kept in self._kept.items() if t >= tick - 1}
        by_velocity, by_position = self._linearize.update(path.qvel[1:])
        return Dynamics(change, by_velocity.astype(np.float32), by_position.astype(np.float32))

    def forget(self) -> None:
        """Take everything anew from now on."""
        self._kept.clear()

    def _at(self, tick: int, h: int, path: Path, prepare: Prepare) -> _Change:
        qpos, qvel, control = path.qpos[h], path.qvel[h], path.control[h]
        for neighbour in (tick, tick - 1, tick + 1) if self.tolerance > 0 else ():
            kept = self._kept.get(neighbour)
            if kept is None or kept[3] != path.touching[h]:
                continue
            moved = (
                np.abs(now - then).max() / unit
                for now, then, unit in zip((qpos, qvel, control), kept[:3], _MOVED, strict=True)
            )
            if all(m < self.tolerance for m in moved):
                self._kept[tick] = kept
                return kept[4]
        made = self._take(tick, h, path, prepare)
        if self.tolerance > 0:
            self._kept[tick] = (qpos, qvel, control, path.touching[h], made)
        return made

    def _take(self, tick: int, h: int, path: Path, prepare: Prepare) -> _Change:
        person, data = self._person, self._data
        nv = person.nv
        data.qpos[:], data.qvel[:] = path.qpos[h], path.qvel[h]
        prepare(data, tick)
        data.ctrl[person.targets] = path.control[h]
        data.qacc_warmstart[:] = path.warmstart[h]
        self.taken += 1
        change, as_found = self._linearize(data)
        self.repaired += not as_found
        columns = np.concatenate([np.arange(2 * nv), 2 * nv + person.targets])
        return change[:, columns].astype(np.float32)


def touching(data: Any) -> bytes:
    """Return which geoms touch, as something to compare.

    How many contact points a pair has does not count: the force at one that appears or vanishes
    grows from zero, and feet on the floor gain and lose points all the time.
    """
    pairs = {(a, b) for a, b in data.contact.geom.tolist()} if data.ncon else set()
    return np.array(sorted(pairs), dtype=np.int32).tobytes()
