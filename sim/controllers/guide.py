"""Where the hand that helps each pelvis pulls to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray
from sim.reference import Reference
from sim.scene import PersonMap, Scene


class AssistGuide:
    """Sets the root assist along a reference, in the scene or in a model cut out of it.

    The assist is a spring with damping at each pelvis (:mod:`sim.scene`). A damper brakes towards
    rest, so the goal is put ahead by what it brakes.
    """

    def __init__(self, scene: Scene, reference: Reference) -> None:
        """Prepare the goals of both people; without an assist in the scene there are none."""
        linear, angular = reference.steps()
        self.helped = [p for p, at in enumerate(scene.maps) if len(at.assist)]
        self._turns = reference.rotations[1:, :, 0]
        self._goals = np.zeros((len(linear), 2, 6))
        for p in self.helped:
            velocity = np.concatenate([linear[:, p], angular[:, p, 0]], axis=1)
            self._goals[:, p] = _lead(scene, scene.maps[p].assist) * velocity
            self._goals[:, p, :3] += reference.root[1:, p]

    def set(self, data: Any, tick: int, p: int, at: PersonMap) -> None:
        """Set the assist of person ``p`` for the step that begins at a tick.

        Args:
            data: ``mujoco.MjData`` of the scene or of the person's own model.
            tick: Of the reference; beyond its end the last one holds.
            p: 0 or 1.
            at: Where the person's numbers lie in that model.
        """
        i = min(tick, len(self._goals) - 1)
        data.ctrl[at.assist] = self._goals[i, p]
        data.mocap_quat[at.mocap] = self._turns[i, p]


def _lead(scene: Scene, addresses: NDArray) -> FloatArray:
    """Return damping over stiffness ``[6]``, s, of a person's assist actuators."""
    model = scene.model
    ids = np.searchsorted(model.actuator_ctrladr, addresses)
    kp, kv = model.actuator_gainprm[ids, 0], -model.actuator_biasprm[ids, 2]
    return np.divide(kv, kp, out=np.zeros(len(kp)), where=kp > 0)
