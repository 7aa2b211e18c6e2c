"""BVH: a skeleton and its channels as text, one person a file.

The format states the frame time, and that y is up (Biovision's definition of its world); it does
not state the unit. The frame time is often wrong after conversions, so the caller may overrule it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from generator.io.assembly import RawDuet, assemble, same_length
from generator.io.bones import MAX_BONES, BoneMap, map_bones
from generator.io.bvh_pose import BvhJoint, joint_positions
from generator.io.plausible import stature, unit_hint
from generator.io.statement import Statement
from generator.io.text import MAX_VALUES, Lines, numbers, whole_number, word_lines
from generator.motion import MAX_FRAMES, DuetMotion
from robots.errors import MotionFileError
from robots.skeleton import FloatArray

_CHANNELS = {
    f"{axis}{kind}": (axis, kind == "position")
    for axis in ("x", "y", "z")
    for kind in ("position", "rotation")
}


@dataclass(frozen=True, slots=True, eq=False)
class Bvh:
    """The content of one file."""

    joints: tuple[BvhJoint, ...]
    """Parents before children."""
    frame_time: float
    """Seconds per frame, as stated."""
    values: FloatArray
    """``[T, C]``, the channels of all joints in order; degrees and file units."""


def read_bvh_pair(paths: tuple[Path, Path], said: Statement) -> DuetMotion:
    """Return the motion of two files.

    Raises:
        MotionFileError: A file is damaged, its names fit no bone map, the two do not fit together,
            or the caller has not said the unit.
    """
    where = f"{paths[0]}, {paths[1]}"
    files = [read_bvh(path) for path in paths]
    maps = [
        map_bones([joint.name for joint in file.joints], str(path))
        for file, path in zip(files, paths, strict=True)
    ]
    if said.fps is None and not math.isclose(
        files[0].frame_time, files[1].frame_time, rel_tol=1e-3, abs_tol=1e-9
    ):
        raise MotionFileError(
            f"frame times differ: {files[0].frame_time:g} s and {files[1].frame_time:g} s",
            where=where,
            hint="give the true rate with --fps",
        )
    time = files[0].frame_time
    fps = said.settle_fps(where, 1 / time if time > 1e-9 else math.inf, correctable=True)
    values_a, values_b = same_length(files[0].values, files[1].values, where)
    a = _keypoints(files[0].joints, values_a, maps[0])
    b = _keypoints(files[1].joints, values_b, maps[1])
    return assemble(
        RawDuet(
            a,
            b,
            _tidy(fps),
            said.up or "y",
            said.settle_scale(where, None, _scale_hint(a)),
            where,
            f"BVH {paths[0].name}, {paths[1].name}",
        )
    )


def read_bvh(path: Path) -> Bvh:
    """Return the content of a file, all of it finite and bounded.

    Raises:
        MotionFileError: The file is not a whole BVH of acceptable size.
    """
    lines = word_lines(path)
    where = str(path)
    first = next(lines, (where, ["nothing"]))
    if first[1][0].upper() != "HIERARCHY":
        raise MotionFileError("a BVH starts with HIERARCHY", where=first[0])
    joints = _hierarchy(lines, where)
    place, words = next(lines, (where, []))
    if [word.lower() for word in words[:1]] != ["frames:"] or len(words) != 2:
        raise MotionFileError("expected 'Frames: N'", where=place)
    count = whole_number(words[1], place, "frames", most=MAX_FRAMES)
    place, words = next(lines, (where, []))
    if [word.lower() for word in words[:2]] != ["frame", "time:"] or len(words) != 3:
        raise MotionFileError("expected 'Frame Time: SECONDS'", where=place)
    time = float(numbers(words[2:], place)[0])
    return Bvh(joints, time, _rows(lines, count, sum(len(j.channels) for j in joints), where))


def _rows(lines: Lines, frames: int, channels: int, where: str) -> FloatArray:
    """Read the frames; memory grows with what is really there, never with what is claimed."""
    if frames * channels > MAX_VALUES:
        raise MotionFileError(
            f"claims {frames} frames of {channels} channels",
            where=where,
            allowed=f"{MAX_VALUES} numbers",
        )
    rows: list[FloatArray] = []
    for place, words in lines:
        if len(rows) == frames:
            raise MotionFileError(f"more than the {frames} frames it claims", where=place)
        if len(words) != channels:
            raise MotionFileError(
                f"frame {len(rows)} has {len(words)} numbers", where=place, allowed=str(channels)
            )
        rows.append(numbers(words, place))
    if len(rows) < max(frames, 2):
        raise MotionFileError(
            f"holds {len(rows)} of {frames} frames",
            where=where,
            allowed="all it claims, and at least 2",
            hint="the file is cut off; copy or export it again",
        )
    return np.stack(rows)


@dataclass(slots=True)
class _Node:
    """A joint under construction; ``index`` is -1 for an end site."""

    name: str
    parent: int
    index: int
    offset: FloatArray | None = None
    channels: tuple[tuple[str, bool], ...] = ()


@dataclass(slots=True)
class _Tree:
    """The state of the hierarchy's parser: finished joints and the open braces."""

    nodes: list[_Node] = field(default_factory=list)
    open: list[_Node] = field(default_factory=list)
    announced: _Node | None = None


def _hierarchy(lines: Lines, where: str) -> tuple[BvhJoint, ...]:
    """Parse up to and including the line MOTION, without recursion."""
    tree = _Tree()
    for place, words in lines:
        if words[0].upper() == "MOTION":
            if tree.open or tree.announced or not tree.nodes:
                raise MotionFileError("the hierarchy is not closed before MOTION", where=place)
            return tuple(_joint(node, where) for node in tree.nodes)
        opens = len(words) > 1 and words[-1] == "{"
        _hierarchy_line(tree, words[:-1] if opens else words, place)
        if opens:
            _hierarchy_line(tree, ["{"], place)
    raise MotionFileError("ends before MOTION", where=where, hint="the file is cut off")


def _hierarchy_line(tree: _Tree, words: list[str], place: str) -> None:
    key = words[0].upper()
    if key in ("ROOT", "JOINT", "END"):
        _announce(tree, key, " ".join(words[1:]), place)
    elif key == "{" and tree.announced and len(words) == 1:
        tree.open.append(tree.announced)
        tree.announced = None
    elif key == "}" and tree.open and not tree.announced and len(words) == 1:
        tree.open.pop()
    elif key == "OFFSET" and tree.open and len(words) == 4:
        tree.open[-1].offset = numbers(words[1:], place)
    elif key == "CHANNELS" and tree.open and tree.open[-1].index >= 0 and len(words) > 1:
        tree.open[-1].channels = _channels(words, place)
    else:
        raise MotionFileError(
            f"'{' '.join(words)[:40]}' is not expected here", where=place, hint="is this a BVH?"
        )


def _announce(tree: _Tree, key: str, name: str, place: str) -> None:
    if tree.announced or (key == "ROOT") != (not tree.open):
        raise MotionFileError(f"{key} is not expected here", where=place)
    if key == "ROOT" and tree.nodes:
        raise MotionFileError("holds two skeletons", where=place, allowed="one person a file")
    parent = tree.open[-1].index if tree.open else -1
    if tree.open and parent < 0:
        raise MotionFileError("an end site has no children", where=place)
    if key == "END":
        tree.announced = _Node(name, parent, -1)
        return
    if not name:
        raise MotionFileError("a joint needs a name", where=place)
    if len(tree.nodes) >= MAX_BONES:
        raise MotionFileError("too many joints", where=place, allowed=f"at most {MAX_BONES}")
    tree.announced = _Node(name, parent, len(tree.nodes))
    tree.nodes.append(tree.announced)


def _channels(words: list[str], place: str) -> tuple[tuple[str, bool], ...]:
    names = [word.lower() for word in words[2:]]
    count = whole_number(words[1], place, "channels", most=6)
    if count != len(names) or len(set(names)) != count or not set(names) <= set(_CHANNELS):
        raise MotionFileError(
            f"channels '{' '.join(words[1:])[:60]}'",
            where=place,
            allowed="a count and as many different of Xposition Yposition Zposition Xrotation"
            " Yrotation Zrotation",
        )
    return tuple(_CHANNELS[name] for name in names)


def _joint(node: _Node, where: str) -> BvhJoint:
    if node.offset is None:
        raise MotionFileError(f"joint '{node.name[:40]}' has no OFFSET", where=where)
    return BvhJoint(node.name, node.parent, node.offset, node.channels)


def _keypoints(joints: tuple[BvhJoint, ...], values: FloatArray, bones: BoneMap) -> FloatArray:
    starts = joint_positions(joints, values, bones.bones, bones.family.adds_root_positions)
    return bones.keypoints(starts)


def _scale_hint(keypoints: FloatArray) -> str:
    hint = unit_hint(stature(keypoints))
    if hint:
        return f"give {hint}"
    return "give --scale METRES_PER_UNIT, for example --scale 0.01 for centimetres"


def _tidy(fps: float) -> float:
    """Return the whole or NTSC rate that a frame time in few digits stands for (1/0.033333 s)."""
    for rate in (round(fps), round(fps * 1.001) / 1.001):
        if rate and abs(fps / rate - 1) < 2e-4:
            return float(rate)
    return fps
