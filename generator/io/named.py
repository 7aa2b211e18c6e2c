"""Archives of named joints: ``a``, ``b`` (T, J, 3), ``joint_names``, ``parents``, ``fps``.

The format is in metres with y up; an entry ``up`` says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from generator.io.arrays import floats, name_entries, number_entry, text_entry
from generator.io.assembly import RawDuet, assemble, require_frames
from generator.io.bones import MAX_BONES, map_bones
from generator.io.plausible import require_sane
from generator.io.statement import Statement, up_axis
from generator.motion import DuetMotion
from robots.errors import MotionFileError

REQUIRED = frozenset({"a", "b", "joint_names"})
"""Entries by which the format is known."""


def parse_named(arrays: Mapping[str, NDArray[Any]], said: Statement, path: Path) -> DuetMotion:
    """Return the motion of an archive of named joints.

    Raises:
        MotionFileError: Shapes do not fit, no bone map fits the names, or the caller contradicts
            the file.
    """
    where = str(path)
    names = name_entries(arrays["joint_names"], f"{where}[joint_names]", most=MAX_BONES)
    people: list[NDArray[Any]] = []
    for key in ("a", "b"):
        array = arrays[key]
        if array.ndim != 3 or array.shape[1:] != (len(names), 3):
            raise MotionFileError(
                f"'{key}' has shape {array.shape}",
                where=where,
                allowed=f"(frames, {len(names)}, 3), one point per name",
            )
        require_frames(len(array), where)
        people.append(array)
    if len(people[0]) != len(people[1]):
        raise MotionFileError(
            f"person a has {len(people[0])} frames, person b {len(people[1])}", where=where
        )
    bones = map_bones(names, where)
    starts = [floats(person[:, list(bones.bones)], where) for person in people]
    for start in starts:
        require_sane(start, where)
    stated_up = text_entry(arrays, ("up",), where)
    # Without an entry the axis is the format's; who says another one corrects no statement.
    up = said.up or "y"
    if stated_up:
        up = said.settle_up(where, up_axis(stated_up, where))
    return assemble(
        RawDuet(
            bones.keypoints(starts[0]),
            bones.keypoints(starts[1]),
            said.settle_fps(where, number_entry(arrays, "fps", where)),
            up,
            said.scale or 1.0,
            where,
            f"{bones.family.title} joints {path.name}",
            text_entry(arrays, ("text",), where),
            text_entry(arrays, ("licence", "license"), where),
        )
    )
