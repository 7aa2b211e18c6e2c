"""Bone maps: which bones of a foreign skeleton stand for the 22 keypoints (``bones.toml``)."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.errors import MotionFileError
from robots.skeleton import FloatArray, human_skeleton

MAX_BONES = 1000
"""Most bones of a skeleton that is read."""

_Choice = tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Family:
    """One family of bone names."""

    title: str
    """Name for people."""
    prefixes: tuple[str, ...]
    """Prefixes that its exporters put before every name, lower case."""
    requires: tuple[str, ...]
    """Bones by which it is told from a family with the same names."""
    adds_root_positions: bool
    """Whether position channels of a BVH add to OFFSET, instead of standing in its place."""
    choices: tuple[tuple[_Choice, ...], ...]
    """Per keypoint, the weighted bones that can stand for it, best first."""


@dataclass(frozen=True, slots=True, eq=False)
class BoneMap:
    """How the bones of one file make the 22 keypoints."""

    family: Family
    """The family its names belong to."""
    bones: tuple[int, ...]
    """Indices of the bones used, each once."""
    weights: FloatArray
    """``[22, B]``, rows sum to 1: keypoints as weighted means of the bones used."""

    def keypoints(self, starts: NDArray) -> FloatArray:
        """Return keypoints ``[T, 22, 3]`` from the starts ``[T, B, 3]`` of :attr:`bones`."""
        return np.einsum("kb,tbi->tki", self.weights, starts)


@cache
def families() -> tuple[Family, ...]:
    """Return the known families, in the order in which they are tried."""
    text = resources.files("generator.io").joinpath("bones.toml").read_text("utf-8")
    return tuple(_family(table) for table in tomllib.loads(text).values())


def _family(table: dict[str, Any]) -> Family:
    def choice(entry: str | dict[str, float]) -> _Choice:
        return ((entry, 1.0),) if isinstance(entry, str) else tuple(entry.items())

    return Family(
        table["title"],
        tuple(table["prefixes"]),
        tuple(table.get("requires", ())),
        table.get("root_positions") == "added",
        tuple(tuple(choice(entry) for entry in table[name]) for name in human_skeleton()),
    )


def map_bones(names: Sequence[str], where: str) -> BoneMap:
    """Return the bone map for a file's bone names.

    Raises:
        MotionFileError: Too many bones, a name twice, or no family has a bone for every keypoint.
    """
    if len(names) > MAX_BONES:
        raise MotionFileError(f"{len(names)} bones", where=where, allowed=f"at most {MAX_BONES}")
    best: tuple[int, Family, list[str]] | None = None
    for family in families():
        index = _index(names, family, where)
        found = [_first(choices, index) for choices in family.choices]
        if all(name in index for name in family.requires):
            if all(found):
                return _bone_map(family, [f for f in found if f], index)
            missing = [n for n, f in zip(human_skeleton(), found, strict=True) if not f]
            if best is None or len(missing) < best[0]:
                best = (len(missing), family, missing)
    raise _unknown(best, len(names), where)


def _index(names: Sequence[str], family: Family, where: str) -> dict[str, int]:
    index: dict[str, int] = {}
    for i, name in enumerate(names):
        short = name.rsplit(":", 1)[-1].strip().lower()
        for prefix in family.prefixes:
            if short.startswith(prefix):
                short = short.removeprefix(prefix)
                break
        if index.setdefault(short, i) != i:
            raise MotionFileError(f"two bones are called '{name[:40]}'", where=where)
    return index


def _first(choices: tuple[_Choice, ...], index: dict[str, int]) -> _Choice | None:
    return next((c for c in choices if all(bone in index for bone, _ in c)), None)


def _bone_map(family: Family, found: list[_Choice], index: dict[str, int]) -> BoneMap:
    bones = tuple(sorted({index[bone] for choice in found for bone, _ in choice}))
    weights = np.zeros((len(found), len(bones)))
    for k, choice in enumerate(found):
        for bone, weight in choice:
            weights[k, bones.index(index[bone])] += weight
    return BoneMap(family, bones, weights)


def _unknown(best: tuple[int, Family, list[str]] | None, count: int, where: str) -> MotionFileError:
    known = ", ".join(family.title for family in families())
    if best is None or best[0] > 15:
        return MotionFileError(
            f"none of the known skeletons fits its {count} bones", where=where, allowed=known
        )
    _, family, missing = best
    return MotionFileError(
        f"it looks most like a {family.title} skeleton but has no bone for {', '.join(missing)}",
        where=where,
        allowed=known,
        hint="export the whole body under the names of one of these",
    )
