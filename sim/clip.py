"""A MuJoCo scene in motion: what a picture, a video or a viewer needs, whatever it shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from robots.errors import SimDiverged
from robots.skeleton import FloatArray, read_only
from sim.camera import CameraPath, follow


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Poses of two bodies over time.

    Raises:
        SimDiverged: Shapes do not fit the model, or a pose is not finite.
    """

    model: Any
    """The ``mujoco.MjModel`` shown; bodies of a and b carry the prefixes ``a/`` and ``b/``."""
    qpos: FloatArray
    """``[N, nq]``, one pose per frame."""
    fps: float
    """Frames per second."""
    title: str = ""
    """What a person reads above it."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        poses = np.asarray(self.qpos)
        if poses.ndim != 2 or poses.shape[1] != self.model.nq or not len(poses):
            raise SimDiverged(f"poses have shape {poses.shape}", allowed=f"(N, {self.model.nq})")
        if not np.isfinite(poses).all():
            raise SimDiverged("a pose to be shown is not finite")
        object.__setattr__(self, "qpos", read_only(poses))

    def at_rate(self, fps: float) -> Clip:
        """Return this clip with the nearest poses at another frame rate."""
        count = int(np.floor((len(self.qpos) - 1) / self.fps * fps)) + 1
        index = np.rint(np.arange(count) * self.fps / fps).astype(int)
        return Clip(self.model, self.qpos[np.minimum(index, len(self.qpos) - 1)], fps, self.title)

    def points(self, prefix: str) -> FloatArray:
        """Return world corners ``[N, 2K, 3]`` m that enclose the geoms of bodies named so."""
        data = mujoco.MjData(self.model)
        bodies = self.model.geom_bodyid
        ids = [
            g for g in range(self.model.ngeom) if self.model.body(bodies[g]).name.startswith(prefix)
        ]
        radius = self.model.geom_rbound[ids][:, None]
        points = np.empty((len(self.qpos), 2 * len(ids), 3))
        for t, pose in enumerate(self.qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(self.model, data)
            centres = data.geom_xpos[ids]
            points[t] = np.concatenate([centres - 0.6 * radius, centres + 0.6 * radius])
        return points

    def camera(self, *, aspect: float) -> CameraPath:
        """Return a camera that keeps both bodies in a picture of the given width over height."""
        return follow(self.points("a/"), self.points("b/"), fps=self.fps, aspect=aspect)
