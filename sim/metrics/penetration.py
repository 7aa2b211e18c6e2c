"""How deep people are inside each other and the floor, by MuJoCo's own collision detection."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray
from sim.scene import Scene
from sim.simulation import quiet_mujoco


@dataclass(frozen=True, slots=True, eq=False)
class Overlap:
    """Where bodies overlap, over time."""

    depth: FloatArray
    """``[N]`` m: deepest penetration between the two people; 0 where they do not touch."""
    pair: NDArray[np.intp]
    """``[N, 2]``: keypoints of a and b whose bodies penetrate deepest; -1 where none do."""
    lowest: FloatArray
    """``[N, 2]`` m: height of the lowest point of each body."""


def overlap(scene: Scene, qpos: NDArray) -> Overlap:
    """Return where the bodies of poses ``[N, nq]`` overlap.

    Depth is the largest negative distance of MuJoCo's contacts between a geom of a and one of b,
    after positions and collision only (no dynamics). It is exact for capsules; for the boxes of the
    feet it is MuJoCo's box depth.
    """
    model = copy(scene.model)
    # The floor is dealt with below, all moments at once: contacts are then rare and between people.
    model.geom_contype[model.geom("floor").id] = 0
    model.geom_conaffinity[model.geom("floor").id] = 0
    data = mujoco.MjData(model)
    owner = np.full((model.ngeom, 2), -1)
    for p, at in enumerate(scene.maps):
        owner[at.geoms, 0] = p
        owner[at.geoms, 1] = np.arange(len(at.geoms))
    depth, pair = np.zeros(len(qpos)), np.full((len(qpos), 2), -1)
    positions = np.empty((len(qpos), model.ngeom))
    upward = np.empty((len(qpos), model.ngeom, 3))
    with quiet_mujoco():
        for t, pose in enumerate(qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            positions[t], upward[t] = data.geom_xpos[:, 2], data.geom_xmat[:, 6:]
            if data.ncon:
                geoms = data.contact.geom
                between = (owner[geoms, 0] >= 0).all(axis=1) & (
                    owner[geoms[:, 0], 0] != owner[geoms[:, 1], 0]
                )
                if between.any():
                    rows = np.flatnonzero(between)
                    row = rows[np.argmin(data.contact.dist[rows])]
                    one, other = sorted(owner[geoms[row]].tolist())
                    depth[t] = max(0.0, -float(data.contact.dist[row]))
                    pair[t] = one[1], other[1]
    return Overlap(depth, pair, _lowest(scene, positions, upward))


def _lowest(scene: Scene, heights: NDArray, upward: NDArray) -> FloatArray:
    """Return the height ``[N, 2]`` m of the lowest point of each person's capsules and boxes.

    Args:
        scene: Whose geoms.
        heights: ``[N, G]`` m of their centres.
        upward: ``[N, G, 3]``, the vertical component of their three axes.
    """
    sizes = scene.model.geom_size
    box = scene.model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    below = np.where(
        box,
        (np.abs(upward) * sizes).sum(axis=-1),
        np.abs(upward[..., 2]) * sizes[:, 1] + sizes[:, 0],
    )
    low = heights - below
    return np.stack([low[:, m.geoms].min(axis=1) for m in scene.maps], axis=1)
