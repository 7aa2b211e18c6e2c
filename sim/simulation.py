"""One run of physics: steps a scene, records, notices divergence, and can go back.

A controller that plans ahead tries, rewinds and tries again, in any order. So the records of a run
form a chain, each pointing to the one before: a snapshot holds its own past, and what was tried in
vain is forgotten with it.
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
class _Moment:
    """The record of one tick, and the one before it."""

    before: _Moment | None
    qpos: FloatArray
    qvel: FloatArray
    ctrl: FloatArray
    """As set at the tick before, for the step that led here."""
    assist: FloatArray
    torque: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A state of a :class:`Simulation` to go back to, with all that led to it."""

    tick: int
    state: FloatArray
    """All that MuJoCo's next step depends on."""
    moment: _Moment


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
        assist, torque = np.zeros((2, 6)), np.zeros((2, len(scene.maps[0].targets)))
        self._moment = _Moment(
            None, data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), assist, torque
        )
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
        assist, torque = np.zeros((2, 6)), np.empty_like(self._moment.torque)
        with quiet_mujoco():
            for i in range(self._substeps):
                self._disturbance.push(data, time + i * length, length)
                mujoco.mj_step(self._model, data)
                for p, at in enumerate(self._maps):
                    if len(at.assist):
                        assist[p] += data.actuator_force[at.assist] / self._substeps
        for p, at in enumerate(self._maps):
            torque[p] = np.linalg.norm(data.actuator_force[at.targets], axis=1)
        if not _is_sane(data):
            raise _diverged("the physics", (self.tick + 1) / self._rate, self.trace())
        data.ctrl[:] = ctrl
        self._moment = _Moment(
            self._moment, data.qpos.copy(), data.qvel.copy(), ctrl, assist, torque
        )
        self.tick += 1

    def _late(self, ctrl: FloatArray) -> FloatArray:
        """Return the controls that reach the actuators now; the first ones until others do."""
        late = min(self._delay, self.tick)
        if late == 0:
            return ctrl
        moment = self._moment
        for _ in range(late - 1):
            moment = moment.before or moment
        return moment.ctrl

    def snapshot(self) -> Snapshot:
        """Return the present state, to go back to with :meth:`restore`."""
        state = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self.data, state, _STATE)
        return Snapshot(self.tick, state, self._moment)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a state of this simulation; :meth:`trace` then tells what led to it."""
        mujoco.mj_setState(self._model, self.data, snapshot.state, _STATE)
        self.tick, self._moment = snapshot.tick, snapshot.moment

    def trace(self) -> Trace:
        """Return what happened up to the present tick."""
        moments, moment = [], self._moment
        while moment is not None:
            moments.append(moment)
            moment = moment.before
        moments.reverse()

        def stacked(name: str, values: list[_Moment]) -> FloatArray:
            return np.stack([getattr(m, name) for m in values])

        # A record holds what led to its tick; nothing led to the first, and nothing is set at the
        # last. Both take their neighbour's.
        came = [*moments[1:2], *moments[1:]] or moments
        sets = [*moments[1:], *moments[-1:]]
        return Trace(
            stacked("qpos", moments),
            stacked("qvel", moments),
            stacked("ctrl", sets),
            stacked("assist", came),
            stacked("torque", came),
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
    mujoco.set_mju_user_warning(lambda message: log.warning("MuJoCo: %s", message))
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
