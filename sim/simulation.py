"""One run of physics: steps a scene, records, notices divergence, and can go back.

A controller that plans ahead tries, goes back and tries again. The record is one block, made when
the run begins, which the next try writes over: small pieces put between a planner's large and
short-lived ones would let memory grow six times faster than the record.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from robots.errors import SimDiverged
from robots.skeleton import FloatArray
from sim.disturbance import NONE, Disturbance
from sim.reference import Reference
from sim.scene import Scene

log = logging.getLogger(__name__)

MAX_SPEED = 1e3
"""Generalised speed, m/s or rad/s, beyond which the physics has diverged."""

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


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


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A state of a :class:`Simulation` to go back to."""

    tick: int
    state: FloatArray
    """All that MuJoCo's next step depends on."""
    steps: int
    """How many steps had been made, those in vain included."""


class Simulation:
    """One run of a scene along a reference, from the first pose on."""

    data: Any
    """``mujoco.MjData`` of the simulated model. Derived quantities, such as ``xpos``, are those of
    the start of the last integration step."""
    tick: int
    """Index of the present sample of the reference; 0 at the start."""

    def __init__(self, scene: Scene, reference: Reference, disturbance: Disturbance = NONE) -> None:
        """Put the people on the first pose, at its speed.

        Args:
            scene: As the controller believes it to be.
            reference: What is to be followed; its rate is that of the ticks.
            disturbance: What the simulated world has otherwise.

        Raises:
            SimDiverged: The first pose is not finite, or faster than :data:`MAX_SPEED`.
        """
        self._model = disturbance.applied_to(scene.model)
        self._maps = scene.maps
        self._disturbance = disturbance
        self._rate = reference.rate
        self._last = len(reference.root) - 1
        self._substeps = substeps_per_tick(scene, reference.rate)
        self._delay = disturbance.ticks_late(reference.rate)
        self._muscles = np.concatenate([m.targets.ravel() for m in scene.maps])
        self.data = data = mujoco.MjData(self._model)
        self._posed = mujoco.MjData(self._model)
        self.tick = 0
        data.qpos[:] = scene.qpos(reference.root[:1], reference.rotations[:1])[0]
        data.qvel[:] = reference_qvel(scene, reference)[0]
        ticks, joints = self._last + 1, len(scene.maps[0].targets)
        self._qpos, self._qvel = (
            np.zeros((ticks, data.qpos.size)),
            np.zeros((ticks, data.qvel.size)),
        )
        # Of the step that leads away from a tick.
        self._ctrl = np.zeros((ticks, data.ctrl.size))
        self._assist, self._torque = np.zeros((ticks, 2, 6)), np.zeros((ticks, 2, joints))
        self._qpos[0], self._qvel[0], self._ctrl[0] = data.qpos, data.qvel, data.ctrl
        self._steps = 0
        self._returns: list[tuple[int, int]] = []
        """When, in steps, the run went back, and to which tick."""
        if not _is_sane(data):
            raise _diverged("the physics", 0.0, None)
        with quiet_mujoco():
            mujoco.mj_forward(self._model, data)

    @property
    def done(self) -> bool:
        """Whether the reference is at its end."""
        return self.tick == self._last

    def keypoints(self) -> FloatArray:
        """Return where the keypoints ``[2, J, 3]`` m are now."""
        self._posed.qpos[:] = self.data.qpos
        mujoco.mj_kinematics(self._model, self._posed)
        return np.stack([self._posed.xpos[at.bodies] for at in self._maps])

    def step(self) -> None:
        """Advance by one tick under the controls in ``data.ctrl`` and ``data.mocap_quat``.

        ``data.ctrl`` is as before on return.

        Raises:
            SimDiverged: The control or the next state is not finite, or the state is faster than
                :data:`MAX_SPEED`. ``trace`` is what happened until then.
        """
        if self.done:
            raise ValueError("the reference has ended")
        data, time, length = self.data, self.tick / self._rate, self._model.opt.timestep
        ctrl = data.ctrl.copy()
        if not np.isfinite(ctrl).all():
            raise _diverged("the control", time, self.trace())
        data.ctrl[self._muscles] = self._late(ctrl)[self._muscles]
        assist = np.zeros((2, 6))
        with quiet_mujoco():
            for i in range(self._substeps):
                self._disturbance.push(data, time + i * length, length)
                mujoco.mj_step(self._model, data)
                for p, at in enumerate(self._maps):
                    if len(at.assist):
                        assist[p] += data.actuator_force[at.assist] / self._substeps
        if not _is_sane(data):
            raise _diverged("the physics", (self.tick + 1) / self._rate, self.trace())
        data.ctrl[:] = ctrl
        self._ctrl[self.tick], self._assist[self.tick] = ctrl, assist
        for p, at in enumerate(self._maps):
            force = data.actuator_force[at.targets]
            self._torque[self.tick, p] = np.linalg.norm(force, axis=1)
        self.tick += 1
        self._steps += 1
        self._qpos[self.tick], self._qvel[self.tick] = data.qpos, data.qvel

    def _late(self, ctrl: FloatArray) -> FloatArray:
        """Return the controls that reach the actuators now; the first ones until others do."""
        late = min(self._delay, self.tick)
        return self._ctrl[self.tick - late] if late else ctrl

    def snapshot(self) -> Snapshot:
        """Return the present state, to go back to with :meth:`restore`."""
        state = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self.data, state, _STATE)
        return Snapshot(self.tick, state, self._steps)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to an earlier state; what happened since is forgotten.

        Args:
            snapshot: Of this run, from before now.

        Raises:
            ValueError: It belongs to what was forgotten.
        """
        if any(snapshot.steps <= at and tick < snapshot.tick for at, tick in self._returns):
            raise ValueError("what led to this snapshot was forgotten when the run went back")
        mujoco.mj_setState(self._model, self.data, snapshot.state, _STATE)
        self.tick = snapshot.tick
        self._returns.append((self._steps, snapshot.tick))

    def trace(self) -> Trace:
        """Return what happened up to the present tick."""
        n = self.tick
        # A record holds what led to its tick, and what was set at it; nothing led to the first, and
        # nothing is set at the last. Both take their neighbour's.
        came = [0, *range(n)] if n else [0]
        sets = [*range(n), n - 1] if n else [0]
        return Trace(
            self._qpos[: n + 1].copy(),
            self._qvel[: n + 1].copy(),
            self._ctrl[sets],
            self._assist[came],
            self._torque[came],
        )


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


def _is_sane(data: Any) -> bool:
    return bool(np.isfinite(data.qpos).all() and np.abs(data.qvel).max() < MAX_SPEED)


def _diverged(what: str, time: float, trace: Trace | None) -> SimDiverged:
    return SimDiverged(
        f"{what} diverged at {time:.3f} s",
        hint="check the motion there: a jump or people deep inside each other",
        time=time,
        trace=trace,
    )


@contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Send MuJoCo's warnings to the log instead of the terminal and ``MUJOCO_LOG.TXT``."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: log.info("MuJoCo: %s", message))
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
