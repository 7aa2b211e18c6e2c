"""The project's own motion file: an ``.npz`` with a JSON header that states everything."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard, cast

from numpy.typing import NDArray

from generator.io.arrays import floats
from generator.io.plausible import require_sane
from generator.io.statement import Statement
from generator.kinematics import fit_rotations
from generator.motion import LEFT_HAND, RIGHT_HAND, Contact, DuetMotion, Motion
from robots.errors import MotionFileError
from robots.files import write_archive
from robots.skeleton import Skeleton, human_skeleton

SCHEMA = "pasdedeux.motion/1"
"""Value of ``schema`` in the header; the number grows when old readers cannot read new files."""

_CONVENTIONS = {"up": "z", "unit": "m", "quaternions": "wxyz"}
"""Written into every file for its readers elsewhere; another value is not this format."""

_KINDS = ("reference", "simulated")
_POINTS = (*human_skeleton().names, LEFT_HAND, RIGHT_HAND)


def write_motion(motion: DuetMotion, path: str | Path) -> None:
    """Write a motion as ``.npz``, whole or not at all; equal motions give equal bytes.

    Raises:
        MotionFileError: The place cannot be written to, or the name does not end in ``.npz``.
    """
    if Path(path).suffix.lower() != ".npz":
        raise MotionFileError(
            "motions are written as .npz", where=str(path), hint="choose a name ending in .npz"
        )
    a = motion.a.skeleton
    header = {
        "schema": SCHEMA,
        "fps": motion.fps,
        **_CONVENTIONS,
        "names": list(a.names),
        "parents": list(a.parents),
        "hand_per_forearm": [person.skeleton.hand_per_forearm for person in motion.people],
        "text": motion.text,
        "seed": motion.seed,
        "source": motion.source,
        "licence": motion.licence,
        "interaction": motion.interaction,
        "kind": motion.kind,
        "contacts": [
            {"a": c.a, "b": c.b, "start": c.start, "end": c.end, "gap": c.gap}
            for c in motion.contacts
        ],
    }
    arrays: dict[str, NDArray[Any]] = {}
    for name, person in zip("ab", motion.people, strict=True):
        arrays[f"keypoints_{name}"] = person.keypoints
        arrays[f"offsets_{name}"] = person.skeleton.offsets
        if person.rotations is not None:
            arrays[f"rotations_{name}"] = person.rotations
        if person.foot_contacts is not None:
            arrays[f"foot_contacts_{name}"] = person.foot_contacts
    write_archive(path, header, arrays)


def parse_motion(
    header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], said: Statement, where: str
) -> DuetMotion:
    """Return the motion of an archive that :func:`write_motion` wrote.

    Rotations are fitted where the file has none.

    Raises:
        MotionFileError: Something is missing, of the wrong kind, or contradicts the caller.
        MotionError: The arrays break a promise of the motion types.
    """
    entry = _Header(header, where)
    entry.require_conventions()
    said.settle_up(where, "z")
    said.settle_scale(where, 1.0)
    fps = said.settle_fps(where, entry.number("fps"))
    skeleton = human_skeleton()
    if (entry.names(), entry.parents()) != (skeleton.names, skeleton.parents):
        raise MotionFileError(
            "its keypoints are not the 22 of this version in their order",
            where=where,
            allowed=", ".join(skeleton.names),
        )
    a, b = (
        _person(name, fps, arrays, hand, where)
        for name, hand in zip("ab", entry.hands(), strict=True)
    )
    return DuetMotion(
        a,
        b,
        text=entry.text("text"),
        seed=entry.seed(),
        source=entry.text("source"),
        licence=entry.text("licence"),
        contacts=entry.contacts(),
        interaction=entry.text("interaction"),
        kind=entry.kind(),
    )


def _person(
    name: str, fps: float, arrays: Mapping[str, NDArray[Any]], hand: float, where: str
) -> Motion:
    for key in (f"keypoints_{name}", f"offsets_{name}"):
        if key not in arrays:
            raise MotionFileError(f"the array '{key}' is missing", where=where)
    rest = human_skeleton()
    offsets = floats(arrays[f"offsets_{name}"], where)
    skeleton = Skeleton(rest.names, rest.parents, offsets, hand)
    keypoints = floats(arrays[f"keypoints_{name}"], where)
    foot_contacts = arrays.get(f"foot_contacts_{name}")
    if foot_contacts is not None and foot_contacts.dtype.kind != "b":
        raise MotionFileError(f"'foot_contacts_{name}' holds no truth values", where=where)
    if f"rotations_{name}" in arrays:
        rotations = floats(arrays[f"rotations_{name}"], where)
        return Motion(fps, keypoints, rotations, foot_contacts, skeleton)
    Motion(fps, keypoints, None, foot_contacts, skeleton)  # validates before the fit
    require_sane(keypoints, where)
    return Motion(fps, keypoints, fit_rotations(skeleton, keypoints), foot_contacts, skeleton)


class _Header:
    """Entries of a header, each checked for its kind."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self._values = values
        self._where = where

    def _wrong(self, key: str, allowed: str) -> MotionFileError:
        what = "is wrong" if key in self._values else "is missing"
        return MotionFileError(f"'{key}' in the header {what}", where=self._where, allowed=allowed)

    def require_conventions(self) -> None:
        for key, value in _CONVENTIONS.items():
            if self._values.get(key) != value:
                raise self._wrong(key, value)

    def number(self, key: str) -> float:
        value = self._values.get(key)
        if not _is_number(value):
            raise self._wrong(key, "a number")
        return float(value)

    def text(self, key: str) -> str:
        value = self._values.get(key)
        if not isinstance(value, str) or any("\ud800" <= c <= "\udfff" for c in value):
            raise self._wrong(key, "a text")
        return value

    def seed(self) -> int | None:
        value = self._values.get("seed", "missing")
        if value is not None and (not isinstance(value, int) or isinstance(value, bool)):
            raise self._wrong("seed", "a whole number or null")
        return value

    def kind(self) -> Any:
        value = self._values.get("kind")
        if value not in _KINDS:
            raise self._wrong("kind", ", ".join(_KINDS))
        return value

    def names(self) -> tuple[str, ...]:
        value = self._values.get("names")
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            raise self._wrong("names", "a list of names")
        return tuple(value)

    def parents(self) -> tuple[int, ...]:
        value = self._values.get("parents")
        if not isinstance(value, list) or not all(isinstance(parent, int) for parent in value):
            raise self._wrong("parents", "a list of indices")
        return tuple(value)

    def hands(self) -> tuple[float, float]:
        value = self._values.get("hand_per_forearm")
        if not isinstance(value, list) or len(value) != 2:
            raise self._wrong("hand_per_forearm", "two numbers from 0 to 1")
        if not all(_is_number(share) and 0 <= share <= 1 for share in value):
            raise self._wrong("hand_per_forearm", "two numbers from 0 to 1")
        return cast(tuple[float, float], tuple(map(float, value)))

    def contacts(self) -> tuple[Contact, ...]:
        value = self._values.get("contacts")
        if not isinstance(value, list):
            raise self._wrong("contacts", "a list")
        return tuple(self._contact(entry) for entry in value)

    def _contact(self, entry: Any) -> Contact:
        if not isinstance(entry, dict) or set(entry) != {"a", "b", "start", "end", "gap"}:
            raise self._wrong("contacts", "entries with a, b, start, end, gap")
        if entry["a"] not in _POINTS or entry["b"] not in _POINTS:
            raise self._wrong("contacts", "points: " + ", ".join(_POINTS))
        times = [entry[key] for key in ("start", "end", "gap")]
        if not all(map(_is_number, times)) or times[0] > times[1]:
            raise self._wrong("contacts", "numbers, start before end")
        return Contact(entry["a"], entry["b"], *map(float, times))


def _is_number(value: Any) -> TypeGuard[float]:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) < 1e300 and math.isfinite(value)
