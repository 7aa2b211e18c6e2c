"""Finds the second file of a duet that comes as one file a person.

**What a person may give**, for every format with one file a person:

- two paths with a comma: ``A.bvh,B.bvh`` (a is the first);
- a folder with exactly two such files (a is the first by name);
- one of two files that are named as a pair, whose partner lies where the rule says:
  ``x_a.bvh`` / ``x_b.bvh`` (also ``-`` or ``.`` before the letter, or the letter alone),
  ``x_person1`` / ``x_person2`` (also ``p1`` / ``p2``), InterHuman's ``person1/x.npy`` /
  ``person2/x.npy``, and the two-subject trials of the CMU database ``18_01`` / ``19_01``, side by
  side or in one folder a subject. Person a is then the first by that rule, whichever is given.

Numbers alone (``x_1.bvh`` / ``x_2.bvh``) are no pair: they are more often two takes of one person.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from robots.errors import MotionFileError

CMU_PARTNERS = {18: 19, 20: 21, 22: 23, 33: 34, 60: 61}
"""Subjects of the CMU database that were recorded together."""

FOLDER_SUFFIXES = (".bvh", ".amc")
"""Formats of which a folder with two files is a duet."""

_LETTER = re.compile(r"^(|.*[-_. ])([abAB])$")
_PERSON = re.compile(r"^(|.*?)(person[-_ ]?|p)([12])$", re.IGNORECASE)
CMU_NAME = re.compile(r"^(\d{1,3})_(\d{1,3})$")
"""File stem of a trial of the CMU database: subject and trial."""


def split_path(path: str | Path) -> tuple[Path, ...]:
    """Return the one or two files that a path means: ``A,B``, a folder with two, or a file.

    Raises:
        MotionFileError: There is no such file, or the folder does not hold exactly two.
    """
    text = os.fspath(path)
    if not text or "\0" in text:
        raise MotionFileError("this is no file name", where=repr(text)[:80])
    single = Path(text)
    if not _exists(single) and text.count(",") == 1 and all(text.split(",")):
        first, second = (Path(part.strip()) for part in text.split(","))
        for part in (first, second):
            if not _exists(part):
                raise MotionFileError("there is no such file", where=str(part))
        return first, second
    if not _exists(single):
        raise MotionFileError("there is no such file", where=text)
    if not single.is_dir():
        return (single,)
    try:
        inside = sorted(p for p in single.iterdir() if p.suffix.lower() in FOLDER_SUFFIXES)
    except OSError as error:
        raise MotionFileError(f"cannot be read: {error.strerror}", where=text) from error
    if len(inside) != 2 or inside[0].suffix.lower() != inside[1].suffix.lower():
        raise MotionFileError(
            f"the folder holds {len(inside)} motion files",
            where=text,
            allowed="exactly two .bvh or two .amc, one a person",
            hint="name two with a comma: A.bvh,B.bvh",
        )
    return inside[0], inside[1]


def with_partner(path: Path) -> tuple[Path, Path]:
    """Return a person's file and the partner's, person a first.

    Raises:
        MotionFileError: The name says no partner, or the partner is not there.
    """
    candidates = _partners(path)
    for a, b in candidates:
        if _exists(a) and _exists(b):
            return a, b
    sought = next((str(p) for pair in candidates for p in pair if p != path), "")
    raise MotionFileError(
        "this file holds one person, and the partner's file "
        + (f"{sought} is not there" if sought else "does not follow from its name"),
        where=str(path),
        hint=f"give both with a comma: {path.name},OTHER{path.suffix}",
    )


def _partners(path: Path) -> list[tuple[Path, Path]]:
    pairs = []
    stem = path.stem
    if match := _LETTER.match(stem):
        a, b = ("a", "b") if match[2].islower() else ("A", "B")
        pairs.append(tuple(path.with_name(match[1] + letter + path.suffix) for letter in (a, b)))
    if match := _PERSON.match(stem):
        pairs.append(
            tuple(path.with_name(match[1] + match[2] + n + path.suffix) for n in ("1", "2"))
        )
    if match := _PERSON.match(path.parent.name):
        folder = path.parent
        pairs.append(
            tuple(folder.with_name(match[1] + match[2] + n) / path.name for n in ("1", "2"))
        )
    return pairs + _cmu_partners(path)


def _cmu_partners(path: Path) -> list[tuple[Path, Path]]:
    match = CMU_NAME.match(path.stem)
    if not match:
        return []
    own, width = int(match[1]), len(match[1])
    for first, second in CMU_PARTNERS.items():
        if own in (first, second):
            other = second if own == first else first
            number = f"{other:0{width}d}"
            name = f"{number}_{match[2]}{path.suffix}"
            places = [path.with_name(name)]
            if path.parent.name:
                places.append(path.parent.with_name(number) / name)
            return [(path, p) if own == first else (p, path) for p in places]
    return []


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):
        return False
