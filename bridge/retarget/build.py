"""How a robot is built, measured on its model in the zero pose: limb lengths and where they hang.

All lengths are of the robot; directions of limbs come from the human. Robots without legs have no
legs here either.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from bridge.retarget.stage import Actor, Stage
from robots.errors import SpecError
from robots.skeleton import FloatArray

SIDES = ("left", "right")
ARM = ("shoulder", "elbow", "hand")
LEG = ("hip", "knee", "ankle")


@dataclass(frozen=True, slots=True, eq=False)
class Build:
    """Measures of one robot."""

    arm: tuple[float, float]
    """Upper arm and forearm to the hand landmark, m."""
    leg: tuple[float, float] | None
    """Thigh and shank, m; ``None`` without legs."""
    shoulders: dict[str, FloatArray]
    """``[3]`` m per side: shoulder in the frame of the torso."""
    torso_from_base: FloatArray
    """``[3]`` m: origin of the torso body in the frame of the base, in the zero pose."""
    hips: dict[str, FloatArray]
    """``[3]`` m per side: hip in the frame of the base."""
    ankle_height: float
    """Of the ankle landmark above the sole, m."""
    foot_reach: float
    """From the ankle to the furthest end of the sole, fore or aft, m."""
    radii: dict[str, float]
    """Thickness of each landmark, m."""
    torso: str
    """Name of the body that carries the shoulders (``chest`` landmark)."""

    @property
    def arm_length(self) -> float:
        """Shoulder to hand, stretched, m."""
        return sum(self.arm)

    @property
    def leg_length(self) -> float:
        """Hip to ankle, stretched, m; 0 without legs."""
        return sum(self.leg) if self.leg else 0.0


def measure(stage: Stage, actor: Actor) -> Build:
    """Return the measures of a robot.

    Raises:
        SpecError: A landmark that every dancer needs is missing.
    """
    needed = ["chest", *(f"{side}_{part}" for side in SIDES for part in ARM)]
    missing = [name for name in needed if name not in actor.sites]
    if missing:
        raise SpecError(
            f"has no landmark {', '.join(missing)}",
            where=actor.robot.name,
            hint="retargeting needs a chest and two arms",
        )
    model = stage.model
    data = mujoco.MjData(model)
    if actor.free:
        data.qpos[actor.base_qpos : actor.base_qpos + 7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(model, data)
    at = {name: data.site_xpos[site].copy() for name, site in actor.sites.items()}
    root = data.xpos[actor.root]
    torso = model.site_bodyid[actor.sites["chest"]]
    has_legs = all(f"{side}_{part}" in at for side in SIDES for part in LEG)
    legs = _limb(at, LEG) if has_legs else None
    return Build(
        arm=_limb(at, ARM),
        leg=legs,
        shoulders={side: at[f"{side}_shoulder"] - data.xpos[torso] for side in SIDES},
        torso_from_base=data.xpos[torso] - root,
        hips={side: at[f"{side}_hip"] - root for side in SIDES} if has_legs else {},
        ankle_height=_ankle_height(actor, at) if has_legs else 0.0,
        foot_reach=_foot_reach(model, actor) if has_legs else 0.0,
        radii={name: landmark.radius for name, landmark in actor.robot.landmarks.items()},
        torso=model.body(torso).name,
    )


def _limb(at: dict[str, FloatArray], parts: tuple[str, str, str]) -> tuple[float, float]:
    """Return the two lengths of a limb, mean of both sides."""
    lengths = np.array(
        [
            [np.linalg.norm(at[f"{s}_{end}"] - at[f"{s}_{start}"]) for s in SIDES]
            for start, end in pairwise(parts)
        ]
    ).mean(axis=1)
    return float(lengths[0]), float(lengths[1])


def _ankle_height(actor: Actor, at: dict[str, FloatArray]) -> float:
    if "left_foot" not in at:
        return 0.0
    sole = at["left_foot"][2] - actor.robot.landmarks["left_foot"].radius
    return float(at["left_ankle"][2] - sole)


def _foot_reach(model: Any, actor: Actor) -> float:
    body = model.site_bodyid[actor.sites["left_ankle"]]
    geoms = np.flatnonzero(model.geom_bodyid == body)
    ends = np.abs(model.geom_pos[geoms, 0]) + model.geom_aabb[geoms, 3]
    return float(ends.max())
