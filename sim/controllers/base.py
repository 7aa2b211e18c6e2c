"""What a controller is, and what all controllers share: stepping, recording, noticing divergence.

A controller owns its whole run, because one that plans ahead may rewind and try again. It uses
:func:`simulate` to step with a policy, and hands back a :class:`Trace`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robots.errors import SimDiverged
from robots.skeleton import FloatArray
from sim.reference import Reference
from sim.scene import Scene

log = logging.getLogger(__name__)

Progress = Callable[[float], None]
"""Told the share of the work that is done, 0 to 1."""

Policy = Callable[[Any, int], None]
"""Given ``mujoco.MjData`` and a tick k, sets the controls that lead to tick k + 1."""

MAX_SPEED = 1e3
"""Generalised speed, m/s or rad/s, beyond which the physics has diverged."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """What happened, per tick of the control clock."""

    qpos: FloatArray
    """``[N, nq]``."""
    qvel: FloatArray
    """``[N, nv]``."""
    ctrl: FloatArray
    """``[N, nu]``: set at the tick (the last is that of the tick before)."""
    assist: FloatArray
    """``[N, 2, 6]``: force N (world) and torque N m (frame of the reference pelvis), mean over the
    step that led to the tick."""
    torque: FloatArray
    """``[N, 2, J-1]``: size of each joint's actuator torque, N m, at the end of that step."""
    facts: dict[str, Any] = field(default_factory=dict)
    """What the controller has to say about the run, as plain JSON (such as ``recoveries``); becomes
    part of the rollout's metadata."""


class Controller(Protocol):
    """Something that makes the people in a scene follow a reference."""

    @property
    def name(self) -> str:
        """What ``TrackSettings.controller`` calls it."""
        ...

    def run(self, scene: Scene, reference: Reference, progress: Progress | None = None) -> Trace:
        """Simulate the whole reference.

        Raises:
            SimDiverged: The physics produced non-finite or absurd numbers.
        """
        ...


def simulate(
    scene: Scene, reference: Reference, policy: Policy, progress: Progress | None = None
) -> Trace:
    """Return the trace of following a policy from the first pose of the reference to its end.

    Raises:
        SimDiverged: A state is not finite, or faster than :data:`MAX_SPEED`.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    count = len(reference.root)
    substeps = substeps_per_tick(scene, reference.rate)
    data.qpos[:] = scene.qpos(reference.root[:1], reference.rotations[:1])[0]
    data.qvel[:] = reference_qvel(scene, reference)[0]
    qpos, qvel = np.empty((count, model.nq)), np.empty((count, model.nv))
    ctrl, assist = np.empty((count, model.nu)), np.zeros((count, 2, 6))
    torque = np.zeros((count, 2, len(scene.maps[0].targets)))
    with quiet_mujoco():
        mujoco.mj_forward(model, data)
        for k in range(count):
            qpos[k], qvel[k] = data.qpos, data.qvel
            _require_sane(data, k / reference.rate)
            if k == count - 1:
                break
            policy(data, k)
            ctrl[k] = data.ctrl
            for _ in range(substeps):
                mujoco.mj_step(model, data)
                for p, at in enumerate(scene.maps):
                    if len(at.assist):
                        assist[k + 1, p] += data.actuator_force[at.assist] / substeps
            for p, at in enumerate(scene.maps):
                torque[k + 1, p] = np.linalg.norm(data.actuator_force[at.targets], axis=1)
            if progress is not None:
                progress((k + 1) / (count - 1))
    ctrl[-1] = ctrl[-2]
    assist[0], torque[0] = assist[1], torque[1]
    return Trace(qpos, qvel, ctrl, assist, torque)


def substeps_per_tick(scene: Scene, rate: float) -> int:
    """Return how many integration steps lie between two ticks."""
    return round(1 / (rate * scene.model.opt.timestep))


def reference_qvel(scene: Scene, reference: Reference) -> FloatArray:
    """Return ``qvel [N, nv]`` of the reference."""
    linear, angular = reference.velocities()
    out = np.zeros((len(linear), scene.model.nv))
    for p, at in enumerate(scene.maps):
        out[:, at.root_dof : at.root_dof + 3] = linear[:, p]
        out[:, at.dofs] = angular[:, p]
    return out


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


def _require_sane(data: Any, time: float) -> None:
    speed = np.abs(data.qvel).max()
    if not np.isfinite(data.qpos).all() or not speed < MAX_SPEED:
        raise SimDiverged(
            f"the physics diverged at {time:.3f} s",
            hint="check the motion there: a jump or people deep inside each other",
        )


@contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Send MuJoCo's warnings to the log instead of the terminal and ``MUJOCO_LOG.TXT``."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: log.warning("MuJoCo: %s", message))
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
