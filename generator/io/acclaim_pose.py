"""Forward kinematics of an Acclaim skeleton.

**The problem.** A bone's rest direction is given in *world* axes, its degrees of freedom turn about
the bone's *own* axes, and those are given by three angles ``C`` in world axes. So with ``M`` the
turn of the degrees of freedom, a bone's local rotation seen in world axes is ``C M C^-1``, and

    G_bone = G_parent C M C^-1,   end = start + G_bone direction length.

All angle triples turn about fixed axes in the order in which they stand (x first in ``XYZ``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.io.acclaim_skeleton import AsfSkeleton
from generator.io.bvh_pose import CHUNK
from robots.skeleton import FloatArray


def bone_starts(skeleton: AsfSkeleton, values: NDArray, wanted: Sequence[int]) -> FloatArray:
    """Return world positions ``[T, W, 3]`` where some bones start, in file units.

    Args:
        skeleton: The bones.
        values: ``[T, D]``, all degrees of freedom in the order of :meth:`AsfSkeleton.slots`.
        wanted: Indices of the bones that are asked for.
    """
    points = np.empty((len(values), len(wanted), 3))
    for begin in range(0, len(values), CHUNK):
        starts = _chunk_starts(skeleton, values[begin : begin + CHUNK])
        for column, bone in enumerate(wanted):
            points[begin : begin + CHUNK, column] = starts[bone]
    return points


def _chunk_starts(skeleton: AsfSkeleton, values: NDArray) -> list[FloatArray]:
    slots = skeleton.slots()
    order = skeleton.root_order
    position = values[:, [order.index(key) for key in ("tx", "ty", "tz")]]
    root = skeleton.bones[0]
    columns = [order.index(f"r{axis}") for axis in root.axis_order]
    frames = [Rotation.from_euler(root.axis_order, values[:, columns], degrees=skeleton.degrees)]
    starts, ends = [position], [position]
    for bone in skeleton.bones[1:]:
        frame = frames[bone.parent]
        if bone.turns:
            first, size = slots[bone.name]
            own = Rotation.from_euler(bone.axis_order, bone.axis, degrees=skeleton.degrees)
            turn = Rotation.from_euler(
                bone.turns, values[:, first : first + size], degrees=skeleton.degrees
            )
            frame = frame * own * turn * own.inv()
        frames.append(frame)
        starts.append(ends[bone.parent])
        ends.append(starts[-1] + frame.apply(bone.vector))
    return starts
