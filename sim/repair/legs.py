"""Put a foot somewhere else by bending the leg."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.kinematics import forward_kinematics, global_rotations, to_wxyz, unit
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray

SIDES = ("left", "right")


def move_foot(
    body: HumanBody,
    root: NDArray,
    rotations: NDArray,
    side: str,
    shift: NDArray,
    turn: Rotation | None = None,
) -> FloatArray:
    """Return rotations ``[T, J, 4]`` with one ankle moved by ``shift [T, 3]`` m.

    Two-bone inverse kinematics: the knee bends about the axis it is bent about (the body's own
    hinge where the leg is straight) until hip and ankle are as far apart as they should be; then
    the leg turns about the hip until the ankle is where it should be. An ankle that is asked
    further away than the leg is long stays short of it.

    Args:
        body: Whose leg.
        root: ``[T, 3]`` m.
        rotations: ``[T, J, 4]`` wxyz.
        side: ``left`` or ``right``.
        shift: ``[T, 3]`` m, world.
        turn: Rotations, world, that the foot makes; without, it keeps its orientation.
    """
    skeleton = body.skeleton
    hip, knee, ankle = (skeleton.index(f"{side}_{n}") for n in ("hip", "knee", "ankle"))
    points = forward_kinematics(skeleton, root, rotations)
    frames = global_rotations(skeleton, rotations)
    thigh, shank = points[:, knee] - points[:, hip], points[:, ankle] - points[:, knee]
    goal = thigh + shank + shift
    axis = np.cross(thigh, shank)
    hinge = frames[hip].apply([0.0, 1.0, 0.0])
    sine = np.linalg.norm(np.cross(unit(thigh), unit(shank)), axis=1)
    clear = smoothstep(sine / 0.1)[:, None]
    axis = unit(unit(axis) * clear + hinge * (1 - clear))
    a, b = np.linalg.norm(thigh, axis=1), np.linalg.norm(shank, axis=1)
    reach = np.clip(np.linalg.norm(goal, axis=1), np.abs(a - b) + 1e-6, a + b - 1e-6)
    bend = np.pi - np.arccos(np.clip((a**2 + b**2 - reach**2) / (2 * a * b), -1, 1))
    now = np.arctan2(
        np.linalg.norm(np.cross(thigh, shank), axis=1), np.einsum("ti,ti->t", thigh, shank)
    )
    fold = Rotation.from_rotvec(axis * (bend - now)[:, None])
    ends = thigh + fold.apply(shank)
    across = np.cross(unit(ends), unit(goal))
    sine = np.linalg.norm(across, axis=1, keepdims=True)
    swing = Rotation.from_rotvec(unit(across) * np.arcsin(np.clip(sine, 0, 1)))
    upper, lower = swing * frames[hip], swing * fold * frames[knee]
    foot = frames[ankle] if turn is None else turn * frames[ankle]
    out = np.array(rotations)
    out[:, hip] = to_wxyz(frames[0].inv() * upper)
    out[:, knee] = to_wxyz(upper.inv() * lower)
    out[:, ankle] = to_wxyz(lower.inv() * foot)
    return out


def smoothstep(x: NDArray) -> FloatArray:
    """Return 0 below 0, 1 above 1, and a smooth rise between."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)
