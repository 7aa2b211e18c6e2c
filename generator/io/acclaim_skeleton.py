"""Parses an Acclaim skeleton (``.asf``)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from generator.io.bones import MAX_BONES
from generator.io.text import numbers, word_lines
from robots.errors import MotionFileError
from robots.skeleton import FloatArray

ROOT = "root"
_AXES = {"rx": "x", "ry": "y", "rz": "z"}


@dataclass(frozen=True, slots=True, eq=False)
class AsfBone:
    """One bone; the root is a bone without length."""

    name: str
    """As in the file."""
    parent: int
    """Index of the parent; -1 for the root."""
    vector: FloatArray
    """``[3]``, from its start to its end in the rest pose, world axes, file units."""
    axis: FloatArray
    """``[3]`` angles of its own frame in the rest pose, file angle unit."""
    axis_order: str
    """Axes about which :attr:`axis` turns, fixed axes, for example ``xyz``."""
    turns: str
    """Axes of its degrees of freedom in the order of the AMC's numbers, for example ``xz``."""


@dataclass(frozen=True, slots=True, eq=False)
class AsfSkeleton:
    """The bones of one file."""

    bones: tuple[AsfBone, ...]
    """Root first, parents before children."""
    length: float
    """``length`` under ``:units``; CMU's unit of length is an inch divided by it."""
    degrees: bool
    """Whether angles are in degrees."""
    root_order: tuple[str, ...]
    """Order of the root's six numbers, for example ``tx ty tz rx ry rz``."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the bones."""
        return tuple(bone.name for bone in self.bones)

    def slots(self) -> dict[str, tuple[int, int]]:
        """Return, per moving bone, its first column and its number of columns in an AMC."""
        slots = {ROOT: (0, len(self.root_order))}
        column = len(self.root_order)
        for bone in self.bones[1:]:
            if bone.turns:
                slots[bone.name] = (column, len(bone.turns))
                column += len(bone.turns)
        return slots


@dataclass(slots=True)
class _Draft:
    """What has been read so far."""

    length: float | None = None
    degrees: bool = True
    root_order: tuple[str, ...] = ()
    root: dict[str, list[str]] = field(default_factory=dict)
    bones: list[dict[str, list[str]]] = field(default_factory=list)
    children: dict[str, list[str]] = field(default_factory=dict)
    inside: bool = False


def read_asf(path: Path) -> AsfSkeleton:
    """Return the skeleton of a file.

    Raises:
        MotionFileError: The file is damaged, or uses a feature that is not read (stretching bones).
    """
    where = str(path)
    draft = _Draft()
    section = ""
    for place, words in word_lines(path):
        if words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            if draft.inside:
                raise MotionFileError("'end' is missing", where=place)
            section = words[0].lower()
        elif section == ":units":
            _units_line(draft, words, place)
        elif section == ":root":
            draft.root[words[0].lower()] = words[1:]
        elif section == ":bonedata":
            _bone_line(draft, words, place)
        elif section == ":hierarchy":
            _hierarchy_line(draft, words, place)
    return _skeleton(draft, where)


def _units_line(draft: _Draft, words: list[str], place: str) -> None:
    key = words[0].lower()
    if key == "length" and len(words) == 2:
        draft.length = float(numbers(words[1:], place)[0])
    elif key == "angle" and len(words) == 2:
        if words[1].lower() not in ("deg", "rad"):
            raise MotionFileError(f"angle '{words[1][:20]}'", where=place, allowed="deg, rad")
        draft.degrees = words[1].lower() == "deg"


def _bone_line(draft: _Draft, words: list[str], place: str) -> None:
    key = words[0].lower()
    if key == "begin":
        if draft.inside or len(draft.bones) >= MAX_BONES:
            raise MotionFileError(
                "a bone begins inside a bone, or there are too many",
                where=place,
                allowed=f"at most {MAX_BONES} bones",
            )
        draft.inside = True
        draft.bones.append({})
    elif key == "end" and draft.inside:
        draft.inside = False
    elif draft.inside:
        draft.bones[-1].setdefault(key, [*words[1:], place])
    else:
        raise MotionFileError("expected 'begin'", where=place)


def _hierarchy_line(draft: _Draft, words: list[str], place: str) -> None:
    if words in (["begin"], ["end"]):
        draft.inside = words == ["begin"]
        return
    if words[0] in draft.children or len(draft.children) > MAX_BONES:
        raise MotionFileError(f"'{words[0][:40]}' is listed twice", where=place)
    draft.children[words[0]] = words[1:]


def _skeleton(draft: _Draft, where: str) -> AsfSkeleton:
    if draft.length is None or not draft.length > 0:
        raise MotionFileError("states no 'length' under :units", where=where)
    order = tuple(word.lower() for word in draft.root.get("order", ()))
    if sorted(order) != ["rx", "ry", "rz", "tx", "ty", "tz"]:
        raise MotionFileError("the root has no six-number 'order'", where=where)
    root_axis = (draft.root.get("axis") or ["XYZ"])[0].lower()
    for key in ("position", "orientation"):
        words = draft.root.get(key, [])
        if words and numbers(words, where).any():
            raise MotionFileError(f"the root's {key} is not zero, which is not read", where=where)
    if sorted(root_axis) != ["x", "y", "z"]:
        raise MotionFileError(f"the root's axis is '{root_axis[:20]}'", where=where)
    table: dict[str, dict[str, list[str]]] = {}
    for entry in draft.bones:
        name = (entry.get("name") or [""])[0]
        if len(entry.get("name", ())) != 2 or name in table or name == ROOT:
            raise MotionFileError(f"a bone has no name of its own: '{name[:40]}'", where=where)
        table[name] = entry
    turns = "".join(_AXES[word] for word in order if word in _AXES)
    root = AsfBone(ROOT, -1, np.zeros(3), np.zeros(3), root_axis, turns)
    bones = _walk(root, table, draft.children, where)
    return AsfSkeleton(tuple(bones), draft.length, draft.degrees, order)


def _walk(
    root: AsfBone,
    table: dict[str, dict[str, list[str]]],
    children: dict[str, list[str]],
    where: str,
) -> list[AsfBone]:
    """Return the bones that hang from the root, parents first; each at most once, so no cycles."""
    bones = [root]
    placed = {ROOT}
    for parent, bone in enumerate(bones):  # grows while it is walked
        for name in children.get(bone.name, ()):
            if name in placed or name not in table:
                raise MotionFileError(
                    f"the hierarchy has an unknown or repeated bone '{name[:40]}'", where=where
                )
            placed.add(name)
            bones.append(_bone(name, parent, table[name], where))
    return bones


def _bone(name: str, parent: int, entry: dict[str, list[str]], where: str) -> AsfBone:
    def words(key: str, count: int) -> list[str]:
        found = entry.get(key, [""])[:-1]
        if len(found) != count:
            raise MotionFileError(f"bone '{name[:40]}' needs '{key}'", where=where)
        return found

    place = f"{where}, bone {name[:40]}"
    direction = numbers(words("direction", 3), place)
    length = float(numbers(words("length", 1), place)[0])
    *angles, order = words("axis", 4)
    order = order.lower()
    freedoms = [word.lower() for word in entry.get("dof", [""])[:-1]]
    if sorted(order) != ["x", "y", "z"]:
        raise MotionFileError(f"the axis order is '{order[:20]}'", where=place)
    if not set(freedoms) <= set(_AXES) or len(set(freedoms)) != len(freedoms):
        raise MotionFileError(
            f"degrees of freedom '{' '.join(freedoms)[:40]}'", where=place, allowed="rx ry rz"
        )
    turns = "".join(_AXES[freedom] for freedom in freedoms)
    return AsfBone(name, parent, direction * length, numbers(angles, place), order, turns)
