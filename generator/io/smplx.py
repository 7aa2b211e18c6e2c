"""Pairs of ``smplx`` archives as holosoma and OmniRetarget use them: one person a file.

``global_joint_positions`` (T, J, 3), metres, z up, of which the first 22 are the body, and
``height``, the person's body height. The frame rate is not in the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from generator.io.arrays import floats, number_entry
from generator.io.assembly import RawDuet, assemble, require_frames, same_length
from generator.io.plausible import STATURE_RANGE
from generator.io.statement import Statement
from generator.motion import DuetMotion
from robots.errors import MotionFileError
from robots.files import read_archive
from robots.skeleton import FloatArray

POSITIONS = "global_joint_positions"
"""Entry by which the format is known."""


def read_smplx(paths: tuple[Path, Path], said: Statement) -> DuetMotion:
    """Return the motion of two archives.

    Raises:
        MotionFileError: A file does not fit, or the caller has not said the frame rate.
    """
    where = f"{paths[0]}, {paths[1]}"
    rates: list[float | None] = []
    people = []
    for path in paths:
        _, arrays = read_archive(path)
        people.append(_positions(arrays, str(path)))
        rates.append(number_entry(arrays, "fps", str(path)))
    if rates[0] != rates[1]:
        raise MotionFileError("the two files state different frame rates", where=where)
    a, b = same_length(people[0], people[1], where)
    return assemble(
        RawDuet(
            a,
            b,
            said.settle_fps(where, rates[0]),
            said.settle_up(where, "z"),
            said.settle_scale(where, 1.0),
            where,
            f"SMPL-X joints {paths[0].name}, {paths[1].name}",
        )
    )


def _positions(arrays: Mapping[str, NDArray[Any]], where: str) -> FloatArray:
    if POSITIONS not in arrays:
        raise MotionFileError(f"has no '{POSITIONS}'", where=where)
    array = arrays[POSITIONS]
    if array.ndim != 3 or array.shape[1] < 22 or array.shape[2] != 3:
        raise MotionFileError(
            f"'{POSITIONS}' has shape {array.shape}", where=where, allowed="(frames, 22, 3)"
        )
    require_frames(len(array), where)
    height = number_entry(arrays, "height", where)
    if height is not None and not STATURE_RANGE[0] <= height <= STATURE_RANGE[1]:
        raise MotionFileError(
            f"states a body height of {height:g} m",
            where=where,
            allowed=f"{STATURE_RANGE[0]} to {STATURE_RANGE[1]} m",
        )
    return floats(array[:, :22], where)
