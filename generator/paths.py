"""Paths and parts of motions as the command line names them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from generator.given import Person, Track, cut_motion, track_of
from generator.io import read_motion
from generator.io.text import word_lines
from generator.motion import DuetMotion
from robots.errors import MotionError, MotionFileError

_PART = re.compile(r"^(?P<file>.+)@(?P<start>\d*\.?\d*):(?P<end>\d*\.?\d*)$")
_COLUMNS = "time in s, x in m, y in m"


def read_part(name: str) -> DuetMotion:
    """Return a motion file, or with ``FILE@FROM:TO`` the part of it between two times in s.

    Raises:
        MotionFileError: The file cannot be read, or the part holds fewer than two frames.
    """
    match = None if Path(name).exists() else _PART.match(name)
    motion = read_motion(match["file"] if match else name)
    if match is None:
        return motion
    start, end = (float(match[key]) if match[key] not in ("", ".") else None
                  for key in ("start", "end"))  # fmt: skip
    try:
        return cut_motion(motion, start, end)
    except MotionError as error:
        raise MotionFileError(error.what, where=name, allowed=error.allowed) from error


def read_track(name: str, person: Person) -> Track:
    """Return where a person goes: from a CSV file, or drawn from a motion file.

    A line of the CSV is a time in s and the pelvis' x and y in m, z up; a first line of words is
    skipped.

    Args:
        name: The file.
        person: Whose path to take from a motion file.

    Raises:
        MotionFileError: The file cannot be read, or holds something else.
    """
    path = Path(name)
    if path.suffix.lower() != ".csv":
        return track_of(read_part(name), person)
    rows: list[list[float]] = []
    for number, (where, words) in enumerate(word_lines(path)):
        cells = " ".join(words).replace(",", " ").replace(";", " ").split()
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            if number == 0:
                continue
            raise MotionFileError("this is not a number", where=where, allowed=_COLUMNS) from None
        if len(row) != 3:
            raise MotionFileError(f"{len(row)} columns", where=where, allowed=_COLUMNS)
        rows.append(row)
    table = np.array(rows, float).reshape(-1, 3)
    try:
        return Track(table[:, 0], table[:, 1:])
    except MotionError as error:
        raise MotionFileError(error.what, where=name, allowed=error.allowed) from error
