"""Forward kinematics of BVH channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robots.skeleton import FloatArray

CHUNK = 1024
"""Frames that are computed at once: it bounds the memory that 1000 joints take."""


@dataclass(frozen=True, slots=True, eq=False)
class BvhJoint:
    """One joint of a BVH hierarchy."""

    name: str
    """As in the file."""
    parent: int
    """Index of the parent; -1 for the root."""
    offset: FloatArray
    """``[3]``, from the parent's start, in file units."""
    channels: tuple[tuple[str, bool], ...]
    """Axis (``x``, ``y``, ``z``) and whether it is a position, in the order of the numbers."""


def joint_positions(
    joints: Sequence[BvhJoint], values: NDArray, wanted: Sequence[int], adds_root_positions: bool
) -> FloatArray:
    """Return world positions ``[T, W, 3]`` of the starts of some joints, in file units.

    Rotation channels turn about moving axes in the order in which they stand. Position channels
    stand in the place of OFFSET, or add to it at the root if ``adds_root_positions``.

    Args:
        joints: Parents before children.
        values: ``[T, C]``, channels of all joints in order, degrees and file units.
        wanted: Indices of the joints that are asked for.
        adds_root_positions: See above.
    """
    needed: set[int] = set()
    for joint in wanted:
        while joint >= 0 and joint not in needed:
            needed.add(joint)
            joint = joints[joint].parent
    points = np.empty((len(values), len(wanted), 3))
    for start in range(0, len(values), CHUNK):
        part = values[start : start + CHUNK]
        positions = _chunk_positions(joints, part, needed, adds_root_positions)
        for column, joint in enumerate(wanted):
            points[start : start + CHUNK, column] = positions[joint]
    return points


def _chunk_positions(
    joints: Sequence[BvhJoint], values: NDArray, needed: set[int], adds_root_positions: bool
) -> dict[int, FloatArray]:
    frames: dict[int, Rotation] = {}
    positions: dict[int, FloatArray] = {}
    column = 0
    for j, joint in enumerate(joints):
        own = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        if j not in needed:
            continue
        local = _local_position(joint, own, adds_root_positions and joint.parent < 0)
        turn = _local_rotation(joint, own)
        if joint.parent < 0:
            positions[j], frames[j] = local, turn
        else:
            above = frames[joint.parent]
            positions[j] = positions[joint.parent] + above.apply(local)
            frames[j] = above * turn
    return positions


def _local_position(joint: BvhJoint, values: NDArray, adds: bool) -> FloatArray:
    local = np.tile(joint.offset, (len(values), 1))
    for column, (axis, is_position) in enumerate(joint.channels):
        if is_position:
            i = "xyz".index(axis)
            local[:, i] = values[:, column] + (local[:, i] if adds else 0.0)
    return local


def _local_rotation(joint: BvhJoint, values: NDArray) -> Rotation:
    columns = [i for i, (_, is_position) in enumerate(joint.channels) if not is_position]
    if not columns:
        return Rotation.identity(len(values))
    order = "".join(joint.channels[i][0] for i in columns).upper()
    return Rotation.from_euler(order, values[:, columns], degrees=True)
