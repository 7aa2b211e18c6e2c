"""Derivatives of one step of physics.

**The problem.** A plan needs ``A = dx'/dx`` and ``B = dx'/du`` of ``mj_step`` at each of its knots,
and they were nine tenths of its cost. MuJoCo's ``mjd_transitionFD`` steps once per column, 202
times, and each time solves for the contact forces anew.

The solution need not be found again to know how it moves. Under the ``discrete`` integrator a step
is ``v' = v + h a``, ``q' = q + h v'``, where the acceleration makes inverse dynamics agree with the
actuators::

    F(q, v, a) = f(q, v, u)        F: mj_inverse, in the implicit metric and with contacts

so by the implicit function theorem::

    F_a da = -(F - f)_q dq - (F - f)_v dv + f_u du

``mjd_inverseFD`` gives ``F_a`` and both brackets. It evaluates an explicit formula, so all of this
costs less than a third, and as no solver's tolerance disturbs it, its perturbation can be so small
that its one-sided differences come 30 times nearer to the truth than those of whole steps.

The state is the position in tangent space and the velocity, ``x = (dq [nv], v [nv])``; the input is
``ctrl [nu]``. Rotations perturb and move from the right: ``q' = q exp(h w')``.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from robots.errors import SpecError
from robots.skeleton import FloatArray

_STEP, _WIDE_STEP = 1e-5, 3e-4
"""Perturbations of differences of a whole step; wide for states on the edge of a contact."""
_INVERSE_STEP = 1e-7
"""Perturbation of differences of inverse dynamics."""
_INPUT_STEP = 1e-5
"""Perturbation of controls, rad."""
_BOUND = 1000.0
"""Largest entry that a step without a jump produces."""


class Linearizer:
    """Derivatives of one step of a model about states, on one thread. Not thread-safe: one each."""

    def __init__(self, model: Any, *, exact: bool = False) -> None:
        """Prepare for a model.

        Args:
            model: ``mujoco.MjModel`` without activations; forces applied from outside must not
                depend on the state.
            exact: Step once per column, in any integrator.

        Raises:
            SpecError: The integrator is not ``discrete`` and ``exact`` is not set.
        """
        if not exact and model.opt.integrator != mujoco.mjtIntegrator.mjINT_DISCRETE:
            raise SpecError(
                f"integrator {model.opt.integrator}", allowed="discrete, or exact derivatives"
            )
        self._model, self._exact = model, exact
        nv, nout = model.nv, model.nout
        self._of_q, self._of_v, self._of_a = np.empty((3, nv, nv))
        self._moment, self._force_of_input = np.empty((nout, nv)), np.zeros((nout, model.nu))
        self.update = PositionUpdate(model)
        self._input_axes = [
            (model.actuator_ctrladr + k)[model.actuator_ctrlnum > k]
            for k in range(int(model.actuator_ctrlnum.max(initial=0)))
        ]
        owner = np.repeat(np.arange(len(model.actuator_outnum)), model.actuator_outnum)
        inputs = np.repeat(np.arange(len(model.actuator_ctrlnum)), model.actuator_ctrlnum)
        self._own = owner[:, None] == inputs

    def __call__(self, data: Any) -> tuple[FloatArray, bool]:
        """Return the derivative of the next velocity.

        That of the next position follows from it; see :class:`PositionUpdate` and
        :func:`transition`.

        Args:
            data: ``mujoco.MjData`` at the state, with ``ctrl``, mocap poses and
                ``qacc_warmstart`` set. State, inputs and warm start are as before on return.

        Returns:
            ``[nv, 2 nv + nu]``: ``dv'/d(q, v, u)``; and whether it is as found. It is not if an
            entry was over 1000: then it was taken again over a wide step and clipped.
        """
        change = self._whole_step(data, _STEP) if self._exact else self._implicit(data)
        if np.abs(change).max() <= _BOUND:
            return change, True
        change = self._whole_step(data, _WIDE_STEP, centred=True)
        return np.clip(np.nan_to_num(change, copy=False), -_BOUND, _BOUND), False

    def _whole_step(self, data: Any, step: float, *, centred: bool = False) -> FloatArray:
        nv, nu = self._model.nv, self._model.nu
        A, B = np.empty((2 * nv, 2 * nv)), np.empty((2 * nv, nu))
        mujoco.mjd_transitionFD(self._model, data, step, centred, A, B, None, None)
        return np.concatenate([A[nv:], B[nv:]], axis=1)

    def _implicit(self, data: Any) -> FloatArray:
        """Return the derivative by the implicit function theorem."""
        model = self._model
        nv, h = model.nv, model.opt.timestep
        mujoco.mj_forward(model, data)
        of_u = self._actuation(data)
        # Row i of what mjd_inverseFD writes belongs to the i-th perturbed coordinate.
        of_q, of_v, of_a = self._of_q, self._of_v, self._of_a
        mujoco.mjd_inverseFD(
            model, data, _INVERSE_STEP, True, of_q, of_v, of_a, None, None, None, None
        )
        # A product with the inverse takes half the time of a solution for so many columns.
        change = h * (np.linalg.inv(of_a.T) @ np.concatenate([-of_q.T, -of_v.T, of_u], axis=1))
        change[:, nv : 2 * nv] += np.eye(nv)
        return change

    def _actuation(self, data: Any) -> FloatArray:
        """Return the derivative ``[nv, nu]`` of the joint forces of the actuators by the controls.

        An actuator's forces depend on its own inputs alone, so all actuators are perturbed at once.
        """
        model, slopes = self._model, self._force_of_input
        control, force = data.ctrl.copy(), data.actuator_force.copy()
        for inputs in self._input_axes:
            data.ctrl[inputs] += _INPUT_STEP
            mujoco.mj_fwdActuation(model, data)
            slopes[:, inputs] = ((data.actuator_force - force) / _INPUT_STEP)[:, None]
            data.ctrl[:] = control
        slopes *= self._own
        mujoco.mju_sparse2dense(
            self._moment,
            data.actuator_moment,
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind,
        )
        return self._moment.T @ slopes


class PositionUpdate:
    """How a new position follows from the old one and the new velocity, ``q' = q exp(h v')``."""

    def __init__(self, model: Any) -> None:
        """Prepare for a ``mujoco.MjModel``."""
        self._timestep, self._nv = model.opt.timestep, model.nv
        self._turning, self._sliding = _rotational_dofs(model)

    def __call__(self, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of new positions, block diagonal.

        Args:
            velocity: ``[..., nv]`` new velocities, m/s and rad/s.

        Returns:
            ``[..., nv, nv]`` by the new velocity, and by the old position.
        """
        h, turning, sliding = self._timestep, self._turning, self._sliding
        transport, jacobian = _rotation_derivatives(h * velocity[..., turning])
        by_velocity, by_position = np.zeros((2, *velocity.shape, self._nv))
        by_velocity[..., sliding, sliding], by_position[..., sliding, sliding] = h, 1.0
        rows, columns = turning[:, :, None], turning[:, None, :]
        by_velocity[..., rows, columns], by_position[..., rows, columns] = h * jacobian, transport
        return by_velocity, by_position


def transition(change: FloatArray, update: PositionUpdate, velocity: FloatArray) -> FloatArray:
    """Return the derivative of the whole next state.

    Args:
        change: ``[nv, 2 nv + nu]``: that of the next velocity.
        update: Of the same model.
        velocity: ``[nv]``: the next velocity.

    Returns:
        ``[2 nv, 2 nv + nu]``: ``[A B]``.
    """
    by_velocity, by_position = update(velocity)
    moved = by_velocity @ change
    moved[:, : len(moved)] += by_position
    return np.concatenate([moved, change])


def _rotational_dofs(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the dofs ``[n, 3]`` of free rotations, and all others."""
    start = {mujoco.mjtJoint.mjJNT_FREE: 3, mujoco.mjtJoint.mjJNT_BALL: 0}
    first = [
        address + start[mujoco.mjtJoint(kind)]
        for kind, address in zip(model.jnt_type, model.jnt_dofadr, strict=True)
        if mujoco.mjtJoint(kind) in start
    ]
    turning = np.array(first, dtype=np.intp)[:, None] + np.arange(3)
    return turning, np.setdiff1d(np.arange(model.nv), turning)


def _rotation_derivatives(turns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how ``q exp(turn)`` turns with ``q``, and with the turn; both ``[..., 3, 3]``.

    All rotations are vectors in the body's frame. The first is ``exp(turn)`` transposed, the second
    the right Jacobian of SO(3).
    """
    x, y, z = np.moveaxis(turns, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1)
    cross = cross.reshape(*x.shape, 3, 3)
    square = cross @ cross
    angle = np.maximum(np.linalg.norm(turns, axis=-1), 1e-4)[..., None, None]
    sine = np.sin(angle) / angle
    cosine = (1 - np.cos(angle)) / angle**2
    rest = (1 - sine) / angle**2
    identity = np.eye(3)
    return identity - sine * cross + cosine * square, identity - cosine * cross + rest * square
