"""Acclaim skeletons and motions (ASF/AMC), as the CMU database publishes them; one person a file.

The skeleton states its unit (``length 0.45`` means 0.0254 m / 0.45 = 0.056444 m) and CMU's world
has y up. The frame rate is in neither file; for files named as CMU's trials it is the database's:
120 Hz, and 60 Hz for the subjects 33, 34, 60 and 61.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from generator.io.acclaim_pose import bone_starts
from generator.io.acclaim_skeleton import AsfSkeleton, read_asf
from generator.io.assembly import RawDuet, assemble, same_length
from generator.io.bones import map_bones
from generator.io.pairs import CMU_NAME
from generator.io.plausible import stature, unit_hint
from generator.io.statement import Statement
from generator.io.text import MAX_VALUES, numbers, word_lines
from generator.motion import MAX_FRAMES, DuetMotion
from robots.errors import MotionFileError
from robots.skeleton import FloatArray

CMU_LENGTH = 0.45
"""``length`` of CMU's skeletons: their unit is an inch divided by it."""

SLOW_SUBJECTS = (33, 34, 60, 61)
"""CMU subjects that were recorded at 60 Hz instead of 120."""

CMU_LICENCE = (
    "CMU Graphics Lab Motion Capture Database: free for all uses, may not be resold"
    " (mocap.cs.cmu.edu, funded by NSF EIA-0196217)"
)

_INCH = 0.0254


def read_acclaim(paths: tuple[Path, Path], said: Statement) -> DuetMotion:
    """Return the motion of two AMC files; their skeletons lie beside them.

    The skeleton of ``18_01.amc`` is ``18.asf``, else ``18_01.asf``, else the folder's only one.

    Raises:
        MotionFileError: A file is damaged or missing, the two do not fit together, or the caller
            has not said what the files cannot.
    """
    where = f"{paths[0]}, {paths[1]}"
    people, units = [], []
    for path in paths:
        skeleton = read_asf(skeleton_path(path))
        values = read_amc(path, skeleton)
        bones = map_bones(skeleton.names, str(path))
        people.append(bones.keypoints(bone_starts(skeleton, values, bones.bones)))
        units.append(_INCH / CMU_LENGTH if math.isclose(skeleton.length, CMU_LENGTH) else None)
    if units[0] != units[1]:
        raise MotionFileError("the two skeletons have different units", where=where)
    a, b = same_length(people[0], people[1], where)
    rates = {_database_rate(path) for path in paths}
    if len(rates) > 1:
        raise MotionFileError("the two trials have different frame rates", where=where)
    rate = rates.pop()
    hint = unit_hint(stature(a))
    return assemble(
        RawDuet(
            a,
            b,
            said.settle_fps(where, rate),
            said.settle_up(where, "y" if rate else None),
            said.settle_scale(where, units[0], f"give {hint}" if hint else ""),
            where,
            f"Acclaim {paths[0].name}, {paths[1].name}",
            licence=CMU_LICENCE if rate else "",
        )
    )


def skeleton_path(path: Path) -> Path:
    """Return the ASF file that belongs to an AMC file.

    Raises:
        MotionFileError: There is none, or more than one could be it.
    """
    subject = path.stem.rpartition("_")[0] or path.stem
    named = [path.with_name(f"{name}.asf") for name in (subject, path.stem)]
    for candidate in named:
        if candidate.is_file():
            return candidate
    beside = sorted(p for p in path.parent.glob("*.[aA][sS][fF]") if p.is_file())
    if len(beside) != 1:
        raise MotionFileError(
            f"its skeleton is not there ({len(beside)} other .asf files are)",
            where=str(path),
            allowed=" or ".join(p.name for p in named) + " in the same folder",
        )
    return beside[0]


def read_amc(path: Path, skeleton: AsfSkeleton) -> FloatArray:
    """Return the values ``[T, D]`` of all degrees of freedom, in the skeleton's order.

    Raises:
        MotionFileError: The file is damaged, too large, or does not fit the skeleton.
    """
    where = str(path)
    slots = skeleton.slots()
    width = sum(size for _, size in slots.values())
    rows: list[FloatArray] = []
    seen: set[str] = set()
    for place, words in word_lines(path):
        key = words[0]
        if key.startswith(("#", ":")):
            _require_units(words, skeleton, place)
        elif len(words) == 1 and key.isascii() and key.isdigit():
            _require_whole(rows, seen, slots, place)
            if len(rows) >= MAX_FRAMES or len(rows) * width > MAX_VALUES:
                raise MotionFileError("too many frames", where=place, allowed=f"{MAX_FRAMES}")
            rows.append(np.zeros(width))
            seen = set()
        elif not rows:
            raise MotionFileError("expected the number of a frame", where=place)
        elif key not in slots or key in seen:
            what = "appears twice in a frame" if key in seen else "does not move in the skeleton"
            raise MotionFileError(f"bone '{key[:40]}' {what}", where=place)
        else:
            first, size = slots[key]
            if len(words) != size + 1:
                raise MotionFileError(
                    f"'{key}' has {len(words) - 1} numbers", where=place, allowed=str(size)
                )
            rows[-1][first : first + size] = numbers(words[1:], place)
            seen.add(key)
    _require_whole(rows, seen, slots, where)
    if len(rows) < 2:
        raise MotionFileError(f"holds {len(rows)} frames", where=where, allowed="at least 2")
    return np.stack(rows)


def _require_whole(
    rows: list[FloatArray], seen: set[str], slots: dict[str, tuple[int, int]], place: str
) -> None:
    missing = [name for name in slots if name not in seen]
    if rows and missing:
        raise MotionFileError(
            f"frame {len(rows) - 1} has no '{missing[0]}'",
            where=place,
            hint="the file is cut off, or belongs to another skeleton",
        )


def _require_units(words: list[str], skeleton: AsfSkeleton, place: str) -> None:
    flag = words[0].lower()
    if flag in (":degrees", ":radians") and (flag == ":degrees") != skeleton.degrees:
        raise MotionFileError(f"{words[0]} contradicts the skeleton's angle", where=place)


def _database_rate(path: Path) -> float | None:
    match = CMU_NAME.match(path.stem)
    if not match:
        return None
    return 60.0 if int(match[1]) in SLOW_SUBJECTS else 120.0
