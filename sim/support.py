"""Whether people stand over their own feet, or lean on each other.

**The problem.** A plan that sees the partner as a body knows what it can lean on; but in people who
stand by themselves and only touch, that body gets in the way wherever the reference has the two in
each other a little, and the plan spends its effort on evading it. Which of the two it is can be
read off the reference: somebody whose centre of mass stays outside the own soles falls, unless held
(the static stability margin, measured with both soles, so that steps do not count).
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, minimum_filter1d
from scipy.spatial import ConvexHull

from robots.skeleton import FloatArray
from sim.footing import sole_corners
from sim.reference import Reference
from sim.scene import Scene

LEANS = 0.02
"""Distance outside the soles, m, at which a person counts as leaning. Duets of
``benchmarks.tracking.leaning`` have 0.05 to 0.09; of 54 captured, choreographed and spoilt ones the
most is 0.003."""
LONG = 0.3
"""How long that must last, s."""
_RATE = 20.0
"""Samples per second that are looked at."""
_SMOOTH = 0.1
"""Standard deviation of the Gaussian over the centre of mass, s."""


def leaning(scene: Scene, reference: Reference) -> tuple[float, float]:
    """Return how far outside the own soles each person's centre of mass stays for :data:`LONG`.

    Metres, level, at the worst such moment; negative is inside the hull of both soles.
    """
    every = max(1, round(reference.rate / _RATE))
    rate = reference.rate / every
    root, rotations = reference.root[::every], reference.rotations[::every]
    masses = _centres_of_mass(scene, scene.qpos(root, rotations))
    worst = []
    for p in range(2):
        soles = sole_corners(reference.bodies[p], root[:, p], rotations[:, p])
        hulls = soles.reshape(len(root), -1, 3)[..., :2]
        path = gaussian_filter1d(masses[:, p], _SMOOTH * rate, axis=0, mode="nearest")
        outside = [_outside(hulls[t], path[t]) for t in range(len(root))]
        worst.append(float(minimum_filter1d(outside, max(1, round(LONG * rate))).max()))
    return worst[0], worst[1]


def _centres_of_mass(scene: Scene, qpos: NDArray) -> FloatArray:
    """Return ``[N, 2, 2]`` m, level, of both people."""
    data = mujoco.MjData(scene.model)
    centres = np.empty((len(qpos), 2, 2))
    for t, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(scene.model, data)
        mujoco.mj_comPos(scene.model, data)
        for p, at in enumerate(scene.maps):
            centres[t, p] = data.subtree_com[at.bodies[0], :2]
    return centres


def _outside(points: NDArray, place: NDArray) -> float:
    """Return how far ``place [2]`` is outside the convex hull of ``points [N, 2]``, m.

    Outside a corner it is a little less than the distance: that from the nearest side's line.
    """
    sides = ConvexHull(points, qhull_options="QJ").equations
    return float((sides[:, :2] @ place + sides[:, 2]).max())
