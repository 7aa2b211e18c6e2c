"""What a plan is to keep small: a quadratic of the distance from the reference.

The error is ``e = (qpos - reference in tangent space, qvel - reference)``, ``[2 nv]``, and the cost
of a knot is ``1/2 e' Q e`` with a Q made, per tick, from the Jacobians of keypoints, centre of mass
and angular momentum at the reference pose; positions and velocities do not mix in it. A body that
is a few centimetres off is thus charged as if the map from joints to keypoints were straight, which
is what Gauss-Newton would do, at a price that is paid once per tick and not once per plan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.humanoid import body_plan
from robots.skeleton import FloatArray
from sim.controllers.ilqr.person import PersonModel
from sim.controllers.ilqr.settings import Weights

_FEET = ("left_ankle", "right_ankle", "left_foot", "right_foot")


class TrackingCost:
    """The cost of being away from the reference, for one person."""

    def __init__(self, person: PersonModel, qpos: NDArray, qvel: NDArray, weights: Weights) -> None:
        """Prepare.

        Args:
            person: Whose.
            qpos: ``[N, nq]`` of the reference.
            qvel: ``[N, nv]`` of the reference.
            weights: Of its parts.
        """
        self.qpos, self.qvel = person.padded(qpos), person.padded(qvel)
        self._person, self._weights = person, weights
        self._data = mujoco.MjData(person.model)
        self._hessians: dict[int, NDArray[np.float32]] = {}
        names = person.body.skeleton.names
        share = [_of(n, weights.keypoint_share, 1.0) for n in names]
        self._share = np.sqrt(weights.body * np.array(share) / len(names))
        self._feet = [person.body.skeleton.index(n) for n in _FEET]
        scale = [_of(n, weights.control_scale, 1.0) for n in names[1:]]
        self.control = np.repeat(weights.control / np.square(scale), 3)
        """``[nu]`` weights of the controls' distance from their nominal values."""
        self.terminal = weights.terminal

    def clip(self, tick: int) -> int:
        """Return the tick, or the last one: beyond its end, the reference stands still."""
        return min(tick, len(self.qpos) - 1)

    def error(self, tick: int, qpos: NDArray, qvel: NDArray) -> FloatArray:
        """Return the error ``[2 nv]`` of a state at a tick."""
        i, nv = self.clip(tick), self._person.nv
        out = np.empty(2 * nv)
        mujoco.mj_differentiatePos(self._person.model, out[:nv], 1.0, self.qpos[i], qpos)
        np.subtract(qvel, self.qvel[i], out=out[nv:])
        return out

    def hessians(self, ticks: Sequence[int]) -> NDArray[np.float32]:
        """Return Q of ticks, ``[H, 2, nv, nv]``: of positions, and of velocities."""
        for i in map(self.clip, ticks):
            if i not in self._hessians:
                self._hessians[i] = self._made(i).astype(np.float32)
        return np.stack([self._hessians[self.clip(tick)] for tick in ticks])

    def forget(self, tick: int) -> None:
        """Free what was kept for ticks before this one; it is made anew if asked for."""
        for old in [i for i in self._hessians if i < tick and i < len(self.qpos) - 1]:
            del self._hessians[old]

    def _made(self, i: int) -> FloatArray:
        model, data, w = self._person.model, self._data, self._weights
        at, nv = self._person.at, self._person.nv
        data.qpos[:], data.qvel[:] = self.qpos[i], self.qvel[i]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        position, velocity = [], []
        for j, body in enumerate(at.bodies):
            linear, turning = np.empty((3, nv)), np.empty((3, nv))
            mujoco.mj_jacBody(model, data, linear, turning, body)
            position.append(self._share[j] * linear)
            if j in self._feet:
                position.append(np.sqrt(w.foot_rotation) * turning)
                velocity.append(np.sqrt(w.foot_velocity) * linear)
        com, momentum = np.empty((3, nv)), np.empty((3, nv))
        mujoco.mj_jacSubtreeCom(model, data, com, at.bodies[0])
        mujoco.mj_angmomMat(model, data, momentum, at.bodies[0])
        position.append(np.sqrt(w.com) * com)
        velocity += [np.sqrt(w.com_velocity) * com, np.sqrt(w.angular_momentum) * momentum]
        out = np.empty((2, nv, nv))
        for block, rows in zip(out, (position, velocity), strict=True):
            stacked = np.concatenate(rows)
            block[:] = stacked.T @ stacked
        diagonal = np.full((2, nv), w.joint_velocity)
        diagonal[0] = w.joint
        diagonal[0, at.root_dof : at.root_dof + 3] = w.root_position
        diagonal[0, at.dofs[0]] = w.root_rotation
        out[:, np.arange(nv), np.arange(nv)] += diagonal
        return out


def _of(keypoint: str, table: Mapping[str, float], default: float) -> float:
    """Return a table's value for a keypoint, by its segment's name (without the side)."""
    return table.get(body_plan().segment(keypoint).name, default)
