"""Joint targets that follow a reference if nothing disturbs, for controllers that add to them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.kinematics import from_wxyz
from robots.humanoid import body_plan
from robots.skeleton import FloatArray
from sim.inverse import inverse_dynamics
from sim.reference import Reference
from sim.scene import Scene


def nominal_targets(scene: Scene, reference: Reference, feed_forward: float = 1.0) -> FloatArray:
    """Return joint targets ``[N-1, 2, J-1, 3]``, rotation vectors, for each step of a reference.

    The pose at the end of the step, ahead by what damping will brake and by the torque that the
    pose demands; the reasons are in :mod:`sim.controllers.assist`. The vectors do not jump, so that
    deviations may be added to them.

    Args:
        scene: Whom to control.
        reference: What to follow.
        feed_forward: Share of the torque of inverse dynamics that is given.
    """
    _, angular = reference.steps()
    ahead = angular[:, :, 1:] * body_plan().damping_ratio
    if feed_forward > 0:
        stiffness = np.array([[b.stiffness(n) for n in b.skeleton.names[1:]] for b in scene.bodies])
        offset = inverse_dynamics(scene, reference).torque / stiffness[..., None]
        ahead = ahead + feed_forward * (offset[1:] + offset[:-1]) / 2
    local = from_wxyz(reference.rotations[1:, :, 1:].reshape(-1, 4))
    turns = (local * Rotation.from_rotvec(ahead.reshape(-1, 3))).as_rotvec()
    return unwrapped(turns.reshape(ahead.shape))


def unwrapped(turns: NDArray) -> FloatArray:
    """Return rotation vectors ``[N, ..., 3]`` that go on beyond pi rather than jump to -pi."""
    out = turns.copy()
    for before, now in pairwise(out):
        size = np.linalg.norm(now, axis=-1, keepdims=True)
        axis = now / np.maximum(size, 1e-9)
        missing = (before * axis).sum(axis=-1, keepdims=True) - size
        now += axis * np.round(missing / (2 * np.pi)) * 2 * np.pi
    return out
