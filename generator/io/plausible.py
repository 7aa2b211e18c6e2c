"""Refuses motions that cannot be two people: wrong unit, wrong up axis, swapped sides, mixed order.

**The problem.** Numbers in centimetres, or with y up, are still finite numbers of the right shape;
everything after this point would run and produce nonsense. The mistakes have clear marks, so each
test looks for the mark of one mistake, over the median of the whole clip and over both people, and
says what to change. Tumbling, lifting and lying on the floor must pass: a test speaks only if the
wrong reading explains the clip and the right one cannot.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robots.errors import MotionFileError
from robots.skeleton import FloatArray, human_skeleton

STATURE_RANGE = (0.9, 2.3)
"""Accepted body height, m: from a small child to a very tall adult."""

USUAL_STATURE = (1.3, 2.1)
"""Body height that makes a unit worth suggesting, m."""

MAX_FLOOR_ERROR = 0.6
"""Largest distance of the lower of the two people from the floor z = 0, median over time, m."""

MAX_DISTANCE = 30.0
"""Largest distance between the two people, median over time, m."""

MAX_COORDINATE = 1e6
"""Larger coordinates (in any unit) are damage, not motion."""

UNITS = (
    (1.0, "metres"),
    (0.01, "centimetres"),
    (0.001, "millimetres"),
    (0.0254, "inches"),
    (0.056444, "raw CMU units"),
)
"""Metres per unit of the units that motion files come in."""

_CHAIN = ("left_ankle", "left_knee", "spine1", "spine2", "spine3", "neck", "head")
_LIMBS = ("knee", "ankle", "elbow", "wrist")
_STATURE = 1.70
"""Body height of :func:`human_skeleton`, m."""


def stature(keypoints: NDArray) -> float:
    """Return the body height that a person's bones imply, in the unit of ``keypoints [T, 22, 3]``.

    The bones between ankle and head, each at its median over time, against those of the 1.70 m
    :func:`human_skeleton`; so it does not depend on how the person stands.
    """
    skeleton = human_skeleton()
    chain = [skeleton.index(name) for name in _CHAIN]
    own = _bone_lengths(keypoints)
    ratio = np.median(own, axis=0)[chain].sum() / skeleton.bone_lengths[chain].sum()
    return float(ratio * _STATURE)


def unit_hint(raw_stature: float) -> str:
    """Return which ``--scale`` would make a person of a body height in file units, or ``""``."""
    fits = [
        f"--scale {scale:g} ({unit}: {raw_stature * scale:.2f} m tall)"
        for scale, unit in UNITS
        if USUAL_STATURE[0] <= raw_stature * scale <= USUAL_STATURE[1]
    ]
    return " or ".join(fits)


def require_plausible(
    people: tuple[NDArray, NDArray], *, scale: float, up: str, where: str
) -> None:
    """Return if two people ``[T, 22, 3]`` (m, z up) can be two people in one room.

    Args:
        people: Keypoints of both, after conversion.
        scale: Metres per unit that was used, for the hint.
        up: Up axis that was used, for the hint.
        where: The file.

    Raises:
        MotionFileError: They cannot; the hint names the likely cause.
    """
    for name, person in zip("ab", people, strict=True):
        _require_body(person, f"{where}, person {name}", scale)
    _require_upright(people, up, where)
    _require_forward_feet(people, where)
    _require_one_room(people, where)


def require_sane(keypoints: NDArray, where: str) -> None:
    """Return if raw coordinates ``[T, ..., 3]`` are finite and not absurd.

    Raises:
        MotionFileError: They are not; the first bad frame is named.
    """
    flat = keypoints.reshape(len(keypoints), -1)
    bad = ~(np.abs(flat) <= MAX_COORDINATE).all(axis=1)
    if bad.any():
        frame = int(np.argmax(bad))
        finite = np.isfinite(flat[frame]).all()
        what = "a coordinate is absurdly large" if finite else "a coordinate is not finite"
        raise MotionFileError(
            f"{what} in frame {frame}", where=where, hint="repair or cut the motion there"
        )


def _bone_lengths(keypoints: NDArray) -> FloatArray:
    parents = list(human_skeleton().parents)
    parents[0] = 0
    return np.linalg.norm(keypoints - keypoints[:, parents], axis=-1)


def _require_body(person: NDArray, where: str, scale: float) -> None:
    height = stature(person)
    if not STATURE_RANGE[0] <= height <= STATURE_RANGE[1]:
        unit = unit_hint(height / scale)
        raise MotionFileError(
            f"this person would be {height:.3g} m tall",
            where=where,
            allowed=f"{STATURE_RANGE[0]} to {STATURE_RANGE[1]} m",
            hint=f"the unit looks wrong: give {unit}" if unit else "are these the 22 keypoints?",
        )
    skeleton = human_skeleton()
    lengths = _bone_lengths(person)
    median = np.median(lengths, axis=0)
    for j, name in enumerate(skeleton.names):
        if not j:
            continue
        parent = skeleton.names[skeleton.parents[j]]
        if not 0.005 <= median[j] / height * _STATURE <= 0.8:
            raise MotionFileError(
                f"the bone from {parent} to {name} is {median[j]:.3f} m long",
                where=where,
                hint="are these the 22 keypoints in their order?",
            )
        spread = np.percentile(np.abs(lengths[:, j] - median[j]), 75)
        if name.partition("_")[2] in _LIMBS and spread > 0.3 * median[j]:
            raise MotionFileError(
                f"the bone from {parent} to {name} changes its length by {spread:.2f} m",
                where=where,
                hint="are these the 22 keypoints in their order?",
            )


def _require_upright(people: tuple[NDArray, NDArray], up: str, where: str) -> None:
    rises = [_rise(person) for person in people]
    upward = [rise[2] for rise in rises]
    if max(upward) < -0.5:
        raise MotionFileError(
            "both people stand on their heads", where=where, hint="the up axis points down"
        )
    # The file's axes that stand where x and y of the z-up world are.
    names = ("z", "x") if up == "y" else ("x", "y")
    for axis, name in enumerate(names):
        across = [rise[axis] for rise in rises]
        same_way = across[0] * across[1] > 0
        if max(upward) < 0.2 and min(np.abs(across)) > 0.6 and same_way:
            advice = "turn the file, only y and z are read" if name == "x" else f"give --up {name}"
            raise MotionFileError(
                "both people lie on their sides through the whole clip",
                where=where,
                hint=f"it looks like {name} is up: {advice}",
            )


def _rise(person: NDArray) -> FloatArray:
    """Return the median of ankles to head ``[3]``, as a share of the median distance."""
    skeleton = human_skeleton()
    ankles = person[:, [skeleton.index("left_ankle"), skeleton.index("right_ankle")]].mean(axis=1)
    body = person[:, skeleton.index("head")] - ankles
    return np.median(body, axis=0) / np.median(np.linalg.norm(body, axis=1))


def _require_forward_feet(people: tuple[NDArray, NDArray], where: str) -> None:
    skeleton = human_skeleton()

    def bone(person: NDArray, start: str, end: str) -> FloatArray:
        return person[:, skeleton.index(end)] - person[:, skeleton.index(start)]

    agreement = []
    for person in people:
        forward = np.cross(bone(person, "right_hip", "left_hip"), bone(person, "pelvis", "neck"))
        feet = bone(person, "left_ankle", "left_foot") + bone(person, "right_ankle", "right_foot")
        size = np.linalg.norm(forward, axis=1) * np.linalg.norm(feet, axis=1)
        cosine = np.einsum("ti,ti->t", forward, feet) / np.maximum(size, 1e-12)
        agreement.append(np.median(cosine))
    if max(agreement) < -0.3:
        raise MotionFileError(
            "the feet of both people point backwards",
            where=where,
            hint="left and right are swapped, or the axes are left-handed; mirror one axis",
        )


def _require_one_room(people: tuple[NDArray, NDArray], where: str) -> None:
    lowest = np.minimum(people[0][..., 2].min(axis=1), people[1][..., 2].min(axis=1))
    height = float(np.median(lowest))
    if abs(height) > MAX_FLOOR_ERROR:
        side = "above" if height > 0 else "below"
        raise MotionFileError(
            f"through most of the clip the feet are {abs(height):.2f} m {side} the floor",
            where=where,
            allowed=f"floor at height 0, within {MAX_FLOOR_ERROR} m",
            hint="is each person centred on its own root? the floor must be at height 0",
        )
    distance = float(np.median(np.linalg.norm(people[0][:, 0] - people[1][:, 0], axis=1)))
    if distance > MAX_DISTANCE:
        raise MotionFileError(
            f"the two people are {distance:.0f} m apart",
            where=where,
            allowed=f"at most {MAX_DISTANCE:.0f} m",
            hint="do the two files share one world frame?",
        )
