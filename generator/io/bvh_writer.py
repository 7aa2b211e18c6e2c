"""Writes a duet as two BVH files, for animation tools: y up, centimetres."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from generator.io.assembly import fit_body, to_y_up
from generator.kinematics import from_wxyz
from generator.motion import DuetMotion, Motion
from robots.files import whole_file
from robots.skeleton import FloatArray, Skeleton

_CM = 100.0
_ORDER = "ZXY"
"""Order of the rotation channels, about moving axes: heading last, away from the singular pose."""

_CAPS = {
    # Length of the bone beyond a leaf keypoint, m, along the named rest direction.
    "head": (0.0, 0.0, 0.18),
    "left_foot": (0.07, 0.0, 0.0),
    "right_foot": (0.07, 0.0, 0.0),
}


def write_bvh(motion: DuetMotion, folder_or_stem: str | Path) -> tuple[Path, Path]:
    """Write both people and return the two paths; read back with ``scale=0.01``.

    A BVH is a rigid skeleton with rotations: what is written is the motion's skeleton, its root
    path and its rotations, so keypoints of a body whose bones change length come back with
    constant bones.

    Args:
        motion: The motion; rotations are fitted where it has none.
        folder_or_stem: An existing folder (gives ``a.bvh`` and ``b.bvh`` in it), or the start of
            the names (``out/waltz`` gives ``out/waltz_a.bvh`` and ``out/waltz_b.bvh``).

    Raises:
        MotionFileError: The place cannot be written to.
    """
    place = Path(folder_or_stem)
    if place.is_dir():
        paths = (place / "a.bvh", place / "b.bvh")
    else:
        stem = place.name.removesuffix(".bvh")
        paths = (place.with_name(f"{stem}_a.bvh"), place.with_name(f"{stem}_b.bvh"))
    contents = [_content(person) for person in motion.people]
    for path, content in zip(paths, contents, strict=True):
        with whole_file(path) as file:
            file.write(content)
    return paths


def _content(person: Motion) -> bytes:
    skeleton, rotations = person.skeleton, person.rotations
    if rotations is None:
        skeleton, rotations = fit_body(person.keypoints)
    order = _depth_first(skeleton)
    lines = ["HIERARCHY", *_hierarchy(skeleton, 0, 0), "MOTION"]
    lines += [f"Frames: {person.frames}", f"Frame Time: {1 / person.fps:.10f}"]
    values = np.concatenate(
        [to_y_up(person.keypoints[:, 0]) * _CM] + [_angles(rotations[:, j]) for j in order],
        axis=1,
    )
    lines += [" ".join(f"{value:.6f}" for value in row) for row in values + 0.0]
    return ("\n".join(lines) + "\n").encode("ascii")


def _children(skeleton: Skeleton, j: int) -> list[int]:
    return [child for child, parent in enumerate(skeleton.parents) if parent == j]


def _depth_first(skeleton: Skeleton, j: int = 0) -> list[int]:
    return [j] + [k for child in _children(skeleton, j) for k in _depth_first(skeleton, child)]


def _hierarchy(skeleton: Skeleton, j: int, depth: int) -> list[str]:
    pad, inner = "\t" * depth, "\t" * (depth + 1)
    turns = " ".join(f"{axis}rotation" for axis in _ORDER)
    if depth:
        head = f"{pad}JOINT {skeleton.names[j]}"
        channels = f"{inner}CHANNELS 3 {turns}"
        offset = skeleton.offsets[j]
    else:
        head = f"ROOT {skeleton.names[j]}"
        channels = f"{inner}CHANNELS 6 Xposition Yposition Zposition {turns}"
        offset = np.zeros(3)
    lines = [head, pad + "{", inner + _offset(offset), channels]
    children = _children(skeleton, j)
    for child in children:
        lines += _hierarchy(skeleton, child, depth + 1)
    if not children:
        end = [inner + "End Site", inner + "{", inner + "\t" + _offset(_cap(skeleton, j))]
        lines += [*end, inner + "}"]
    return [*lines, pad + "}"]


def _offset(offset: FloatArray) -> str:
    return "OFFSET " + " ".join(f"{value:.6f}" for value in to_y_up(offset) * _CM + 0.0)


def _cap(skeleton: Skeleton, j: int) -> FloatArray:
    """Return the rest offset of the end site: a hand, the top of the head, the toes."""
    if skeleton.names[j] in _CAPS:
        return np.array(_CAPS[skeleton.names[j]])
    return skeleton.offsets[j] * skeleton.hand_per_forearm


def _angles(quaternions: FloatArray) -> FloatArray:
    """Return channel angles ``[T, 3]`` in degrees of z-up rotations ``[T, 4]``, without jumps."""
    turned = np.concatenate([quaternions[:, :1], to_y_up(quaternions[:, 1:])], axis=1)
    with warnings.catch_warnings():
        # At the singular pose one of three angles is free; any choice is the same rotation.
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = from_wxyz(turned).as_euler(_ORDER)
    return np.degrees(np.unwrap(angles, axis=0))
