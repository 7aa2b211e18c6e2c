"""From keypoint positions to joint rotations and back.

A pose is a root position plus one rotation per keypoint. With ``G`` the rotation from the rest
frame to the world, ``q`` local rotations and ``o`` rest offsets:

    G_root = q_root,   G_j = G_parent(j) q_j,   x_j = x_parent(j) + G_parent(j) o_j

**The problem of the other direction.** Positions do not determine rotations: a bone may spin about
itself unseen, and a frame computed from scratch per time step flips. So :func:`fit_rotations` asks
only what positions can answer, and takes the rest from the parent. A keypoint with several children
(pelvis, upper spine) gets the best-fitting rigid rotation of their directions (Kabsch, batched over
time). A keypoint with one child is swung from its parent's frame by the smallest rotation. Thigh
and upper arm are then spun about themselves so that the knee and the elbow bend about the body's
own hinge axis, in proportion to how clearly the limb is bent.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robots.skeleton import FloatArray, Skeleton

_HINGES = {
    # upper keypoint: (middle, end, hinge axis in the rest frame: upper x lower for forward bend)
    "left_hip": ("left_knee", "left_ankle", (0.0, 1.0, 0.0)),
    "right_hip": ("right_knee", "right_ankle", (0.0, 1.0, 0.0)),
    "left_shoulder": ("left_elbow", "left_wrist", (0.0, 0.0, -1.0)),
    "right_shoulder": ("right_elbow", "right_wrist", (0.0, 0.0, 1.0)),
}


def to_wxyz(rotation: Rotation) -> FloatArray:
    """Return quaternions ``[..., 4]`` wxyz of a scipy rotation."""
    return rotation.as_quat(scalar_first=True)


def from_wxyz(quaternions: NDArray) -> Rotation:
    """Return the scipy rotation of quaternions ``[N, 4]`` wxyz."""
    return Rotation.from_quat(quaternions, scalar_first=True)


def forward_kinematics(skeleton: Skeleton, root: NDArray, rotations: NDArray) -> FloatArray:
    """Return keypoints ``[T, J, 3]`` m in the world frame.

    Args:
        skeleton: Rest offsets.
        root: ``[T, 3]`` m, world position of the root keypoint.
        rotations: ``[T, J, 4]`` wxyz, root to world and others local to the parent.
    """
    points = np.empty((len(root), len(skeleton), 3))
    frames = global_rotations(skeleton, rotations)
    offsets = skeleton.offsets.copy()  # scipy 1.17's apply() refuses read-only arrays
    points[:, 0] = root
    for j, parent in enumerate(skeleton.parents[1:], start=1):
        points[:, j] = points[:, parent] + frames[parent].apply(offsets[j])
    return points


def global_rotations(skeleton: Skeleton, rotations: NDArray) -> list[Rotation]:
    """Return, per keypoint, the rotations from the rest frame to the world over time."""
    frames = [from_wxyz(rotations[:, 0])]
    for j, parent in enumerate(skeleton.parents[1:], start=1):
        frames.append(frames[parent] * from_wxyz(rotations[:, j]))
    return frames


def fit_skeleton(skeleton: Skeleton, keypoints: NDArray) -> Skeleton:
    """Return ``skeleton`` with the bone lengths of a motion ``[T, J, 3]`` m (median over time)."""
    bones = keypoints[:, 1:] - keypoints[:, list(skeleton.parents[1:])]
    lengths = np.median(np.linalg.norm(bones, axis=-1), axis=0)
    return skeleton.with_bone_lengths(np.concatenate([[0.0], lengths]))


def fit_rotations(
    skeleton: Skeleton, keypoints: NDArray, near: NDArray | None = None
) -> FloatArray:
    """Return rotations ``[T, J, 4]`` wxyz that turn the rest pose into given keypoints.

    Directions of bones are met, not their lengths. Signs are continuous over time.

    Args:
        skeleton: Rest pose.
        keypoints: ``[T, J, 3]`` m, world frame.
        near: Rotations ``[T, J, 4]`` wxyz that say what positions do not: the spin of bones about
            themselves and how hands, feet and head are turned. Without, see the top of this file.
    """
    given = [] if near is None else global_rotations(skeleton, near)
    count = len(skeleton)
    children: list[list[int]] = [[] for _ in range(count)]
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            children[parent].append(j)
    frames: list[Rotation] = []
    for j in range(count):
        parent = skeleton.parents[j]
        base = frames[parent] if parent >= 0 else Rotation.identity(len(keypoints))
        rest = skeleton.offsets[children[j]]
        seen = keypoints[:, children[j]] - keypoints[:, j : j + 1]
        if near is not None and parent >= 0:
            base = given[j] if children[j] else base * from_wxyz(near[:, j])
        if not children[j]:
            frame = base
        elif len(children[j]) > 1:
            frame = _rigid_fit(rest, seen)
        else:
            frame = _swing(base.apply(rest[0]), seen[:, 0]) * base
            if near is None and skeleton.names[j] in _HINGES:
                frame = _turn_to_hinge(skeleton, keypoints, j, frame)
        frames.append(frame)
    rotations = np.empty((len(keypoints), count, 4))
    for j, parent in enumerate(skeleton.parents):
        local = frames[j] if parent < 0 else frames[parent].inv() * frames[j]
        rotations[:, j] = to_wxyz(local)
    return continuous(rotations)


def continuous(rotations: NDArray) -> FloatArray:
    """Return quaternions ``[T, ..., 4]`` with signs chosen so that neighbours in time are close."""
    dots = np.einsum("t...i,t...i->t...", rotations[1:], rotations[:-1])
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    out = np.array(rotations, dtype=float)
    out[1:] *= signs[..., None]
    return out


def unit(vectors: NDArray) -> FloatArray:
    """Return vectors ``[..., 3]`` scaled to length 1 (zero vectors stay zero)."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros(vectors.shape), where=length > 1e-12)


def _rigid_fit(rest: NDArray, seen: NDArray) -> Rotation:
    """Kabsch: the rotations that best take directions ``rest [C,3]`` to ``seen [T,C,3]``."""
    covariance = np.einsum("tci,cj->tij", unit(seen), unit(rest))
    u, _, vt = np.linalg.svd(covariance)
    u[..., -1] *= np.sign(np.linalg.det(u @ vt))[:, None]
    return Rotation.from_matrix(u @ vt)


def _swing(start: NDArray, end: NDArray) -> Rotation:
    """Return the smallest rotations that take directions ``start [T,3]`` to ``end [T,3]``."""
    start, end = unit(start), unit(end)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.einsum("ti,ti->t", start, end))
    # Opposite directions leave the axis open: any one across the start will do.
    across = unit(np.cross(start, np.roll(start, 1, axis=1) * (1.0, -1.0, 1.0) + (0.0, 0.0, 1e-3)))
    axis = np.where(sine[:, None] > 1e-9, unit(axis), across)
    return Rotation.from_rotvec(axis * angle[:, None])


def _turn_to_hinge(skeleton: Skeleton, keypoints: NDArray, j: int, frame: Rotation) -> Rotation:
    """Spin an upper limb about itself so that its hinge axis is normal to the bent limb."""
    middle, end, rest_axis = _HINGES[skeleton.names[j]]
    upper = keypoints[:, skeleton.index(middle)] - keypoints[:, j]
    lower = keypoints[:, skeleton.index(end)] - keypoints[:, skeleton.index(middle)]
    bone = unit(upper)
    normal = np.cross(bone, unit(lower))
    bend = np.linalg.norm(normal, axis=1)
    hinge = frame.apply(rest_axis)
    hinge = unit(hinge - bone * np.einsum("ti,ti->t", bone, hinge)[:, None])
    sine = np.einsum("ti,ti->t", np.cross(hinge, unit(normal)), bone)
    cosine = np.einsum("ti,ti->t", hinge, unit(normal))
    clarity = np.clip((bend - 0.1) / 0.3, 0.0, 1.0)
    angle = np.arctan2(sine, cosine) * clarity * clarity * (3 - 2 * clarity)
    return Rotation.from_rotvec(bone * angle[:, None]) * frame
