"""What a controller is, and what controllers share.

A controller owns its whole run (:class:`sim.simulation.Simulation`), because one that plans ahead
may rewind and try again. One that is a mere policy uses :func:`simulate`. All hand back a
:class:`Trace`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim.disturbance import NONE, Disturbance
from sim.reference import Reference
from sim.rollout import FALL_DISTANCE
from sim.scene import Scene
from sim.simulation import Simulation, Trace, quiet_mujoco, reference_qvel, substeps_per_tick

__all__ = [
    "Controller", "Policy", "Progress", "Trace", "quiet_mujoco", "reference_qvel", "simulate",
    "substeps_per_tick", "within_effort",
]  # fmt: skip

Progress = Callable[[float], None]
"""Told the share of the work that is done, 0 to 1."""

Policy = Callable[[Any, int], None]
"""Given ``mujoco.MjData`` and a tick k, sets the controls that lead to tick k + 1."""

_AFTER_FALL = 0.5
"""How long a fall is shown before the run ends, s."""


class Controller(Protocol):
    """Something that makes the people in a scene follow a reference."""

    @property
    def name(self) -> str:
        """What ``TrackSettings.controller`` calls it."""
        ...

    def run(
        self,
        scene: Scene,
        reference: Reference,
        progress: Progress | None = None,
        *,
        disturbance: Disturbance = NONE,
    ) -> Trace:
        """Simulate the reference; to its end unless somebody falls whom nothing saves.

        Args:
            scene: What the controller believes the world to be.
            reference: What to follow.
            progress: Told the share of the work that is done, 0 to 1.
            disturbance: What the simulated world has otherwise; not to be looked at, only handed
                to :class:`sim.simulation.Simulation`.

        Raises:
            SimDiverged: The physics produced non-finite or absurd numbers.
        """
        ...


def simulate(
    scene: Scene,
    reference: Reference,
    policy: Policy,
    progress: Progress | None = None,
    *,
    disturbance: Disturbance = NONE,
) -> Trace:
    """Return the trace of following a policy from the first pose of the reference to its end.

    Ends early, half a second after a person fell; ``facts["ended"]`` then says so.

    Raises:
        SimDiverged: A state is not finite or absurdly fast.
    """
    run = Simulation(scene, reference, disturbance)
    goal = scene.keypoints(scene.qpos(reference.root, reference.rotations))
    fallen: int | None = None
    while not run.done:
        off = np.linalg.norm(run.keypoints() - goal[run.tick], axis=-1)
        if fallen is None and (off.mean(axis=-1) > FALL_DISTANCE).any():
            fallen = run.tick
        if fallen is not None and run.tick >= fallen + _AFTER_FALL * reference.rate:
            why = f"a person fell at {fallen / reference.rate:.2f} s"
            ended = {"time": run.tick / reference.rate, "why": why}
            return replace(run.trace(), facts={"ended": ended})
        policy(run.data, run.tick)
        run.step()
        if progress is not None:
            progress(run.tick / (len(reference.root) - 1))
    return run.trace()


def within_effort(
    target: Rotation, now: Rotation, velocity: NDArray, damping_ratio: float, most: NDArray
) -> Rotation:
    """Return targets that keep the torque of spring and damper within bounds.

    Effort is limited here and not by the actuator. The torque is ``kp (turn - ratio velocity)``, so
    the turn from now to the target may differ from ``ratio velocity`` by ``effort / kp``.

    Args:
        target: Wanted rotations of J joints.
        now: Present ones.
        velocity: ``[J, 3]`` rad/s, present, in the frame of the joint's body.
        damping_ratio: kv / kp, s.
        most: ``[J]`` rad, effort / kp.
    """
    coast = damping_ratio * velocity
    pull = (now.inv() * target).as_rotvec() - coast
    size = np.linalg.norm(pull, axis=1)
    scale = np.minimum(1.0, most / np.maximum(size, 1e-12))
    return now * Rotation.from_rotvec(coast + pull * scale[:, None])
