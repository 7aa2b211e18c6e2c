"""Plain keypoint arrays ``(T, 2, 22, 3)``: an ``.npy``, or an ``.npz`` that holds one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from generator.io.arrays import floats, number_entry, text_entry
from generator.io.assembly import RawDuet, assemble, require_frames
from generator.io.statement import Statement, up_axis
from generator.motion import DuetMotion
from robots.errors import MotionFileError

KEYS = ("joints", "keypoints")
"""Names of the array in an ``.npz``; a single array of any name is taken, too."""


def parse_joints(array: NDArray[Any], said: Statement, path: Path) -> DuetMotion:
    """Return the motion of a bare array; it says nothing, so the caller says fps and up.

    Raises:
        MotionFileError: The shape does not fit, or the caller has not said what the file cannot.
    """
    return _motion(array, {}, said, path)


def parse_joints_archive(
    arrays: Mapping[str, NDArray[Any]], said: Statement, path: Path
) -> DuetMotion:
    """Return the motion of an archive with one keypoint array.

    Entries ``fps``, ``up``, ``text`` and ``licence`` (or ``license``) are used where it has them.

    Raises:
        MotionFileError: No array can be the keypoints, or see :func:`parse_joints`.
    """
    extras = {"fps", "up", "text", "licence", "license"}
    others = [key for key in arrays if key not in extras]
    key = next((key for key in KEYS if key in arrays), others[0] if len(others) == 1 else None)
    if key is None:
        raise MotionFileError(
            f"holds {', '.join(others)[:200] or 'no array'}",
            where=str(path),
            allowed="'joints' or 'keypoints' (T, 2, 22, 3); a, b, joint_names, parents, fps; or"
            " global_joint_positions, height",
        )
    return _motion(arrays[key], arrays, said, path)


def _motion(
    array: NDArray[Any], arrays: Mapping[str, NDArray[Any]], said: Statement, path: Path
) -> DuetMotion:
    where = str(path)
    if array.ndim != 4 or array.shape[1:] != (2, 22, 3):
        hint = ""
        if array.shape[:1] == (2,) and array.shape[-2:] == (22, 3):
            hint = "the axes are in another order: numpy.swapaxes(x, 0, 1)"
        elif array.ndim == 3 and array.shape[-1:] == (3,):
            hint = "this holds one person; both are needed"
        raise MotionFileError(
            f"keypoints have shape {array.shape}",
            where=where,
            allowed="(frames, 2, 22, 3)",
            hint=hint,
        )
    require_frames(len(array), where)
    points = floats(array, where)
    stated_up = text_entry(arrays, ("up",), where)
    return assemble(
        RawDuet(
            points[:, 0],
            points[:, 1],
            said.settle_fps(where, number_entry(arrays, "fps", where)),
            said.settle_up(where, up_axis(stated_up, where) if stated_up else None),
            said.scale or 1.0,
            where,
            f"keypoints {path.name}",
            text_entry(arrays, ("text",), where),
            text_entry(arrays, ("licence", "license"), where),
        )
    )
