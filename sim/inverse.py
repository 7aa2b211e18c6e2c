"""What a motion demands of a body: joint torques, floor forces, and what no floor could give.

**The problem.** A person moves only by pushing on the floor. From poses and their accelerations,
inverse dynamics gives the wrench that something must apply to the pelvis, were it not for the feet.
The feet may push (not pull) within their friction cones, where soles are near the floor and still.
The best such forces ``f >= 0`` (coefficients on the edges of a friction pyramid at every sole
corner) minimise

    |W (A f - w)|^2 + sum_i c_i f_i^2

with ``w`` the wrench, ``A f`` what the forces give about the pelvis, ``W`` scaling by body weight
and a lever of 0.2 m, and ``c_i`` small but growing with a corner's height and speed. All frames are
solved at once by accelerated projected gradient (FISTA). What remains, ``w - A f``, is the
*residual wrench*: 0 for a person who stands, 100 % of body weight for one who hovers. Joint torques
follow from inverse dynamics less what the floor forces do at each joint.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from generator.kinematics import forward_kinematics, global_rotations
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.footing import FOOT_BODIES, sole_corners
from sim.reference import Reference
from sim.scene import GRAVITY, Scene
from sim.simulation import quiet_mujoco, reference_qvel

FRICTION = 0.8
"""Friction coefficient that the feet may use; a little less than the scene's."""
_LEVER = 0.2
_REACH = 0.04
"""Height above the floor, m, up to which a sole corner may push."""
_ITERATIONS = 150
_BLOCK = 128
"""Moments whose floor forces are solved at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Demand:
    """What the motion of two people asks for."""

    torque: FloatArray
    """``[N, 2, J-1, 3]`` N m at the joints, in the frame of the joint's own body."""
    residual: FloatArray
    """``[N, 2, 6]`` force N and torque N m about the pelvis, world, that no floor could give."""
    support: FloatArray
    """``[N, 2]`` N, vertical force of the floor."""


def inverse_dynamics(scene: Scene, reference: Reference, smoothing: float = 0.03) -> Demand:
    """Return what a reference demands; the two people do not push each other.

    Args:
        scene: A scene of the reference's bodies.
        reference: Poses over time.
        smoothing: Standard deviation of the low-pass on accelerations and torques, s.
    """
    sigma = smoothing * reference.rate
    qpos = scene.qpos(reference.root, reference.rotations)
    qvel = reference_qvel(scene, reference)
    qacc = gaussian_filter1d(np.gradient(qvel, axis=0) * reference.rate, sigma, axis=0)
    generalised = _free_forces(scene, qpos, qvel, qacc)
    torques, residuals, supports = [], [], []
    for p, (body, at) in enumerate(zip(scene.bodies, scene.maps, strict=True)):
        frames = global_rotations(body.skeleton, reference.rotations[:, p])
        root, turns = reference.root[:, p], reference.rotations[:, p]
        points = forward_kinematics(body.skeleton, root, turns)
        force = generalised[:, at.root_dof : at.root_dof + 3]
        moment = frames[0].apply(generalised[:, at.dofs[0]])
        corners = sole_corners(body, root, turns).reshape(len(root), -1, 3)
        pushes = _floor_forces(
            corners - points[:, :1],
            np.concatenate([force, moment], axis=1),
            _cost(corners, reference.rate),
            body.weight * GRAVITY,
        )
        torque = generalised[:, at.dofs[1:]]
        torque = torque - _felt_at_joints(body, points, frames, corners, pushes)
        lever = np.cross(corners - points[:, :1], pushes)
        residual = np.concatenate([force - pushes.sum(axis=1), moment - lever.sum(axis=1)], axis=1)
        torques.append(gaussian_filter1d(torque, sigma, axis=0))
        residuals.append(residual)
        supports.append(pushes[:, :, 2].sum(axis=1))
    return Demand(np.stack(torques, 1), np.stack(residuals, 1), np.stack(supports, 1))


def _free_forces(scene: Scene, qpos: NDArray, qvel: NDArray, qacc: NDArray) -> FloatArray:
    """Return the generalised forces ``[N, nv]`` of a motion without contact and actuators."""
    model = copy(scene.model)
    data = mujoco.MjData(model)
    # The ``discrete`` integrator would mix the actuators' stiffness into inverse dynamics.
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    out = np.empty_like(qvel)
    with quiet_mujoco():
        for t in range(len(qpos)):
            data.qpos[:], data.qvel[:], data.qacc[:] = qpos[t], qvel[t], qacc[t]
            mujoco.mj_inverse(model, data)
            out[t] = data.qfrc_inverse
    return out


def _cost(corners: NDArray, rate: float) -> FloatArray:
    """Return the reluctance ``[N, 16]`` of sole corners to push; infinite out of reach."""
    speed = np.linalg.norm(np.gradient(corners, axis=0), axis=-1) * rate
    height = np.maximum(corners[..., 2], 0.0)
    cost = 1e-3 * (1 + (height / 0.01) ** 2 + (speed / 0.3) ** 2)
    return np.where(corners[..., 2] < _REACH, cost, np.inf)


def _floor_forces(arms: NDArray, wrench: NDArray, cost: NDArray, weight: float) -> FloatArray:
    """Return the forces ``[N, C, 3]`` N at sole corners that best give a wrench at the pelvis.

    Moments are independent of each other; a block of them at a time stays in the processor's cache,
    and the memory taken does not grow with the motion.

    Args:
        arms: ``[N, C, 3]`` m, from the pelvis to the corners.
        wrench: ``[N, 6]`` wanted force N and torque N m.
        cost: ``[N, C]`` reluctance; infinite where no push is possible.
        weight: Body weight, N.
    """
    blocks = [slice(at, at + _BLOCK) for at in range(0, len(arms), _BLOCK)]
    return np.concatenate([_pushes(arms[b], wrench[b], cost[b], weight) for b in blocks])


def _pushes(arms: NDArray, wrench: NDArray, cost: NDArray, weight: float) -> FloatArray:
    """Return the same for one block."""
    edges = np.array([[FRICTION, 0, 1], [-FRICTION, 0, 1], [0, FRICTION, 1], [0, -FRICTION, 1]])
    forces = np.broadcast_to(edges, (*arms.shape[:2], 4, 3))
    columns = np.concatenate([forces, np.cross(arms[:, :, None], forces) / _LEVER], axis=-1)
    possible = np.isfinite(cost)[..., None, None]
    columns = np.where(possible, columns, 0.0).reshape(len(arms), -1, 6)
    ridge = np.repeat(np.where(np.isfinite(cost), cost, 1.0), 4, axis=1)
    wanted = wrench / weight
    wanted[:, 3:] /= _LEVER
    gram = columns.transpose(0, 2, 1) @ columns
    step = 1 / (np.linalg.eigvalsh(gram)[:, -1:] + ridge.max(axis=1, keepdims=True))
    push = np.zeros(ridge.shape)
    ahead, momentum = push, 1.0
    for _ in range(_ITERATIONS):
        miss = (ahead[:, None] @ columns)[:, 0] - wanted
        slope = (columns @ miss[..., None])[..., 0] + ridge * ahead
        after = np.maximum(ahead - step * slope, 0.0)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = after + (momentum - 1) / following * (after - push)
        push, momentum = after, following
    push = np.where(possible[..., 0], push.reshape(*arms.shape[:2], 4), 0.0)
    return push @ edges * weight


def _felt_at_joints(
    body: HumanBody,
    points: NDArray,
    frames: list,
    corners: NDArray,
    pushes: NDArray,
) -> FloatArray:
    """Return the torques ``[N, J-1, 3]`` N m that floor forces exert at the joints above them."""
    out = np.zeros((len(points), len(body.skeleton) - 1, 3))
    for c in range(corners.shape[1]):
        j = body.skeleton.index(FOOT_BODIES[c // 4])
        while j > 0:
            out[:, j - 1] += np.cross(corners[:, c] - points[:, j], pushes[:, c])
            j = body.skeleton.parents[j]
    for j in range(1, len(body.skeleton)):
        if out[:, j - 1].any():
            out[:, j - 1] = frames[j].inv().apply(out[:, j - 1])
    return out
