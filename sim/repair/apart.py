"""People inside each other are pushed apart, and hands that should meet are brought together.

**The problem.** Generated and re-staged duets interpenetrate by 7 to 17 cm, and hands that should
touch miss by as much. Physics does not allow the first and nothing repairs the second once both
people only follow their own reference. Wanted is the smallest change of keypoints, smooth in time,
that leaves every overlap shallow and every labelled touch within a centimetre of its intended gap.

Per moment this is a least-squares step. With ``R`` the rate at which each overlap closes (or each
touch gains distance) per degree of freedom, ``e`` what is wanted and ``W`` how far a degree of
freedom may go for one unit of change of keypoints,

    x = W R^T (R W R^T + damping)^-1 e

The degrees of freedom are the pelvis along the floor, lower spine, neck, shoulders and elbows; as a
pelvis takes 22 keypoints along and an elbow two, arms yield first and people step aside only where
trunks meet. In time, every change is spread over its neighbourhood and smoothed; what that blurs or
what the next contact adds is left to the next of a few rounds.

Example: a hand 4 cm inside the partner's back comes out by bending the arm, in two rounds; a hug
6 cm too tight puts both people 3 cm apart and leaves hands on backs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial.transform import Rotation

from generator.kinematics import continuous, from_wxyz, to_wxyz, unit
from generator.motion import LEFT_HAND, RIGHT_HAND, Contact
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.scene import Scene, build_scene

TOLERATED = 0.005
"""Depth, m, that is left alone."""
LEFT_OVER = 0.002
"""Depth, m, that an overlap is reduced to: people who touch should go on touching."""
MISSED = 0.01
"""Miss of a labelled touch, m, that is left alone."""
FAR = 0.12
"""Miss, m, from which a label is not believed."""
MAX_STEP = 0.10
"""Most that a pelvis is moved, m."""
MAX_BEND = 0.5
"""Most that a joint is bent, rad."""

_ROUNDS = 5
_REACH = 0.10
"""Time to either side over which a change is spread, s."""
_SOFT = 0.06
"""Standard deviation of the smoothing over time, s."""
_DAMPING = 0.03
_UPRIGHT = 0.7
"""Vertical part of a normal from which two feet are taken to be one above the other."""
_YIELD = {
    # joint: change of angle, rad, per unit of squared change of keypoints (metres)
    "spine1": 0.4,
    "neck": 8.0,
    "left_shoulder": 3.0,
    "right_shoulder": 3.0,
    "left_elbow": 12.0,
    "right_elbow": 12.0,
}
_YIELD_PELVIS = 1 / 22


@dataclass(frozen=True, slots=True, eq=False)
class _Freedom:
    """One person's degrees of freedom that may yield."""

    joints: NDArray[np.intp]
    """``[K]`` keypoint indices."""
    dofs: NDArray[np.intp]
    """``[2 + 3 K]`` addresses in ``qvel``: pelvis x and y, then the joints."""
    weights: FloatArray
    """``[2 + 3 K]``."""


def push_apart(
    bodies: tuple[HumanBody, HumanBody],
    root: NDArray,
    rotations: NDArray,
    contacts: Sequence[Contact],
    rate: float,
) -> tuple[FloatArray, FloatArray]:
    """Return ``root [N, 2, 3]`` and ``rotations [N, 2, J, 4]`` of people who do not overlap.

    Args:
        bodies: The two people.
        root: ``[N, 2, 3]`` m.
        rotations: ``[N, 2, J, 4]`` wxyz.
        contacts: Intended touches.
        rate: Samples per second.
    """
    scene = build_scene(bodies)
    freedoms = [_freedom(scene, p) for p in range(2)]
    total = [np.zeros((len(root), len(f.dofs))) for f in freedoms]
    made = root, rotations
    for _ in range(_ROUNDS):
        steps = _wanted(scene, freedoms, scene.qpos(*made), contacts, rate)
        if steps is None:
            break
        for whole, step in zip(total, steps, strict=True):
            whole += _spread(step, rate)
        made = _moved(root, rotations, freedoms, total)
    return made


def _freedom(scene: Scene, person: int) -> _Freedom:
    skeleton, at = scene.bodies[person].skeleton, scene.maps[person]
    joints = np.array([skeleton.index(name) for name in _YIELD])
    dofs = np.concatenate([[at.root_dof, at.root_dof + 1], at.dofs[joints].ravel()])
    weights = np.concatenate([[_YIELD_PELVIS] * 2, np.repeat(list(_YIELD.values()), 3)])
    return _Freedom(joints, dofs, weights)


def _wanted(
    scene: Scene,
    freedoms: Sequence[_Freedom],
    qpos: NDArray,
    contacts: Sequence[Contact],
    rate: float,
) -> list[FloatArray] | None:
    """Return per person the changes ``[N, D]`` that each moment asks for; none if none does."""
    model, data = scene.model, mujoco.MjData(scene.model)
    owner = np.full(model.nbody, -1)
    for p, at in enumerate(scene.maps):
        owner[at.bodies] = p
    count = len(freedoms[0].dofs)
    dofs = np.concatenate([f.dofs for f in freedoms])
    weights = np.concatenate([f.weights for f in freedoms])
    steps, any_row = np.zeros((len(qpos), 2 * count)), False
    for t, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        rows = _overlaps(model, data, owner) + _misses(scene, data, contacts, t / rate)
        if rows:
            any_row = True
            rates, wanted = np.array([r[0][dofs] for r in rows]), np.array([r[1] for r in rows])
            eased = rates * weights
            steps[t] = eased.T @ np.linalg.solve(
                eased @ rates.T + _DAMPING * np.eye(len(rows)), wanted
            )
    return [steps[:, :count], steps[:, count:]] if any_row else None


def _overlaps(model: Any, data: Any, owner: NDArray) -> list[tuple[FloatArray, float]]:
    """Return for each deep contact the rate ``[nv]`` at which it opens, and by how much to, m."""
    rows = []
    if not data.ncon:
        return rows
    bodies = model.geom_bodyid[data.contact.geom]
    owners = owner[bodies]
    deep = (owners >= 0).all(axis=1) & (owners[:, 0] != owners[:, 1])
    deep &= data.contact.dist < -TOLERATED
    for c in np.flatnonzero(deep):
        normal, place = data.contact.frame[c, :3], data.contact.pos[c]
        if (model.geom_type[data.contact.geom[c]] == mujoco.mjtGeom.mjGEOM_BOX).all():
            # Flat boxes are least deep upwards, but a foot does not leave another by climbing it.
            between = np.subtract(*data.geom_xpos[data.contact.geom[c, ::-1]]) * (1.0, 1.0, 0.0)
            normal = unit(between) if np.abs(normal[2]) > _UPRIGHT else normal
        opens = _jacobian(model, data, bodies[c, 1], place) - _jacobian(
            model, data, bodies[c, 0], place
        )
        rows.append((normal @ opens, float(-data.contact.dist[c] - LEFT_OVER)))
    return rows


def _misses(
    scene: Scene, data: Any, contacts: Sequence[Contact], time: float
) -> list[tuple[FloatArray, float]]:
    """Return for each missed touch the rate ``[nv]`` at which it closes, and by how much to, m."""
    rows = []
    for contact in contacts:
        if not contact.start <= time <= contact.end:
            continue
        ends = [_point(scene, data, p, n) for p, n in enumerate((contact.a, contact.b))]
        apart = ends[1][1] - ends[0][1]
        distance = float(np.linalg.norm(apart))
        miss = distance - contact.gap
        if MISSED < miss < FAR:
            closes = _jacobian(scene.model, data, *ends[0]) - _jacobian(scene.model, data, *ends[1])
            rows.append((apart / distance @ closes, miss - MISSED / 2))
    return rows


def _point(scene: Scene, data: Any, person: int, name: str) -> tuple[int, FloatArray]:
    """Return the body of a labelled point and its place ``[3]`` m."""
    skeleton, bodies = scene.bodies[person].skeleton, scene.maps[person].bodies
    if name not in (LEFT_HAND, RIGHT_HAND):
        body = int(bodies[skeleton.index(name)])
        return body, data.xpos[body].copy()
    side = name.removesuffix("_hand")
    elbow, wrist = (int(bodies[skeleton.index(f"{side}_{n}")]) for n in ("elbow", "wrist"))
    forearm = data.xpos[wrist] - data.xpos[elbow]
    return elbow, data.xpos[wrist] + forearm * skeleton.hand_per_forearm


def _jacobian(model: Any, data: Any, body: int, place: NDArray) -> FloatArray:
    out = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, out, None, place, int(body))
    return out


def _spread(step: NDArray, rate: float) -> FloatArray:
    """Return changes ``[N, D]`` spread over their neighbourhood in time, and smoothed."""
    size = 2 * round(_REACH * rate) + 1
    up = maximum_filter1d(np.maximum(step, 0.0), size, axis=0, mode="nearest")
    down = maximum_filter1d(np.maximum(-step, 0.0), size, axis=0, mode="nearest")
    return gaussian_filter1d(up - down, _SOFT * rate, axis=0, mode="nearest")


def _moved(
    root: NDArray, rotations: NDArray, freedoms: Sequence[_Freedom], total: Sequence[NDArray]
) -> tuple[FloatArray, FloatArray]:
    """Return poses after changes ``[N, D]`` per person, each within its bound."""
    root, rotations = np.array(root), np.array(rotations)
    for p, (freedom, change) in enumerate(zip(freedoms, total, strict=True)):
        root[:, p, :2] += _bounded(change[:, :2], MAX_STEP)
        for k, j in enumerate(freedom.joints):
            bend = _bounded(change[:, 2 + 3 * k : 5 + 3 * k], MAX_BEND)
            turned = from_wxyz(rotations[:, p, j]) * Rotation.from_rotvec(bend)
            rotations[:, p, j] = to_wxyz(turned)
    return root, continuous(rotations)


def _bounded(vectors: NDArray, most: float) -> FloatArray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors * np.minimum(1.0, most / np.maximum(length, 1e-9))
