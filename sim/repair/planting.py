"""Stance feet are put where a foot can stand: on the floor, level, and still.

**The problem.** A foot that carries somebody does not move. In captured motion it creeps by a
millimetre per frame, and in generated motion, where the pelvis drifts by centimetres and every
joint errs by degrees, it slides, tilts, floats and sinks by several centimetres. A controller that
follows such feet trips over them. So

1. :func:`find_stance` finds when the ball of each foot stands: slow after a low-pass, low for the
   moment, for long enough,
2. :func:`level_drift` moves the whole person up or down by what standing feet say of the floor,
   slowly, so that jumps stay jumps,
3. :func:`plant_feet` holds the ball of each stance at its median place, the sole level while the
   heel is down too, toes level while it is up, and lets the correction change over to the next one
   during the swing, by bending the legs.

What a foot would have to be moved by more than :data:`MAX_PLANT` is moved by that much and goes on
sliding: a pirouette is not stepping in place.

Example: in a handshake with 2 cm of drift of the pelvis and 2 degrees of error of each joint, a
standing ball wanders by 4 cm; it is planted at the median, and the knees take up the difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation

from generator.kinematics import forward_kinematics, global_rotations, to_wxyz, unit
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.repair.legs import SIDES, move_foot, smoothstep

MAX_PLANT = 0.10
"""Most that a foot is moved, m; also how far off the floor a stance may be to be put on it."""
MAX_DRIFT = 0.06
"""Most that a person is moved up or down, m."""

_STILL, _MOVING = (0.12, 0.25), (0.25, 0.45)
"""A stance begins where the ball is slower than the first, and spreads while it is slower than the
second, m/s: each for clean motions, and for those whose standing feet move most."""
_CREEP = (0.04, 0.15)
"""Speed of the stiller foot, m/s, that is clean, and that calls for the larger bounds."""
_LOW = 0.07
"""Height over the lowest ball of both feet around the moment, m, up to which a ball may stand."""
_AROUND = 0.4
"""Half the time, s, that is around the moment."""
_LOOK = 0.05
"""Low-pass on positions before their speed is judged, s."""
_SHORTEST = 0.1
"""Shortest stance, s."""
_PITCH = np.radians(15.0)
"""Steepest sole that counts as one with the heel down."""
_BEND = np.radians(60.0)
"""Most that toes are turned."""
_SLOW = 0.15
"""Low-pass on what is found of the floor, s."""
_EASE = 0.25
"""Time in which a correction comes and goes where no other stance follows, s."""
_POLISH = 0.015
"""Low-pass on corrections, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Stance:
    """When and how one foot stands."""

    standing: NDArray[np.bool_]
    """``[N]``: the ball stands."""
    ball: FloatArray
    """``[N, 3]`` m: path of the toe keypoint, where the foot bends."""
    foot: Rotation
    """``N`` orientations of the foot, world."""
    turn: Rotation
    """``N`` rotations, world, that level the sole where the heel stands too."""
    toes: Rotation
    """``N`` orientations of the toes, world, levelled where they stand."""
    rest: FloatArray
    """``[N]`` m: height of the ball with the lowest corner of the turned sole on the floor."""


def find_stance(
    body: HumanBody, root: NDArray, rotations: NDArray, rate: float
) -> tuple[Stance, Stance]:
    """Return when and how the left and the right foot stand.

    Args:
        body: Whose feet.
        root: ``[N, 3]`` m.
        rotations: ``[N, J, 4]`` wxyz.
        rate: Samples per second.
    """
    points = forward_kinematics(body.skeleton, root, rotations)
    frames = global_rotations(body.skeleton, rotations)
    feet = [body.skeleton.index(f"{side}_{n}") for n in ("foot", "ankle") for side in SIDES]
    smooth = gaussian_filter1d(points[:, feet], _LOOK * rate, axis=0, mode="nearest")
    speed = np.linalg.norm(np.gradient(smooth, axis=0), axis=-1) * rate
    creep = np.median(speed[:, :2].min(axis=1))
    doubt = float(smoothstep((creep - _CREEP[0]) / (_CREEP[1] - _CREEP[0])))
    still, moving = (v[0] + doubt * (v[1] - v[0]) for v in (_STILL, _MOVING))
    lowest = smooth[:, :2, 2].min(axis=1)
    floor = minimum_filter1d(lowest, 2 * round(_AROUND * rate) + 1, mode="nearest")
    found = []
    for i, side in enumerate(SIDES):
        foot, toes = frames[feet[2 + i]], frames[feet[i]]
        standing = _spells(smooth[:, i, 2] < floor + _LOW, speed[:, i], still, moving, rate)
        pitch = np.arcsin(np.clip(-foot.apply([1.0, 0.0, 0.0])[:, 2], -1, 1))
        pitch = gaussian_filter1d(pitch, _LOOK * rate, mode="nearest")
        flat = _spells(standing & (np.abs(pitch) < _PITCH), speed[:, 2 + i], still, moving, rate)
        turn = Rotation.from_rotvec(_blend(_level(foot, flat), flat, rate))
        bent = standing & (pitch > -_PITCH)
        toes = Rotation.from_rotvec(_blend(_level(toes, bent), bent, rate)) * toes
        rest = _depth(body, side, turn * foot, toes)
        found.append(Stance(standing, points[:, feet[i]], foot, turn, toes, rest))
    return found[0], found[1]


def _spells(
    may: NDArray[np.bool_], speed: NDArray, still: float, moving: float, rate: float
) -> NDArray[np.bool_]:
    """Return the long enough runs of slow moments ``[N]`` that have a still one in them."""
    out = np.zeros(len(may), dtype=bool)
    for run in _runs(may & (speed < moving)):
        if run.stop - run.start >= _SHORTEST * rate and speed[run].min() < still:
            out[run] = True
    return out


def _runs(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the runs of true moments ``[N]``."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).tolist()
    return [slice(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _depth(body: HumanBody, side: str, foot: Rotation, toes: Rotation) -> FloatArray:
    """Return how far below the ball the lowest corner of a foot is ``[N]`` m."""
    name = f"{side}_foot"
    heel = body.sole_corners(f"{side}_ankle") - body.skeleton.offsets[body.skeleton.index(name)]
    low = [
        np.einsum("tj,cj->tc", frame.as_matrix()[:, 2], corners).min(axis=1)
        for frame, corners in ((foot, heel), (toes, body.sole_corners(name)))
    ]
    return -np.minimum(*low)


def level_drift(stances: tuple[Stance, Stance], rate: float) -> tuple[float, FloatArray]:
    """Return by how much to raise a person so that standing feet are on the floor.

    The height error of standing feet, averaged over feet and about :data:`_SLOW` of time by
    normalised convolution: where nobody stands for long the correction fades to its constant part.

    Returns:
        The constant part, m, which is miscalibration of the floor, and the whole ``[N]`` m.
    """
    errors = np.stack([s.rest - s.ball[:, 2] for s in stances])
    counts = np.stack([s.standing for s in stances]) & (np.abs(errors) < MAX_DRIFT + 0.02)
    if not counts.any():
        return 0.0, np.zeros(errors.shape[1])
    always = float(np.median(errors[counts]))
    weight = gaussian_filter1d(counts.sum(axis=0) * 1.0, _SLOW * rate, mode="nearest")
    drift = ((errors - always) * counts).sum(axis=0)
    drift = gaussian_filter1d(drift, _SLOW * rate, mode="nearest") / np.maximum(weight, 0.05)
    return always, always + np.clip(drift, -MAX_DRIFT, MAX_DRIFT)


def plant_feet(
    body: HumanBody,
    root: NDArray,
    rotations: NDArray,
    stances: tuple[Stance, Stance],
    rate: float,
) -> tuple[FloatArray, FloatArray]:
    """Return rotations ``[N, J, 4]`` whose feet stand still, and how far they moved ``[N]`` m.

    Args:
        body: Whose feet.
        root: ``[N, 3]`` m.
        rotations: ``[N, J, 4]`` wxyz.
        stances: Of left and right, of these poses.
        rate: Samples per second.
    """
    most = np.zeros(len(root))
    for side, stance in zip(SIDES, stances, strict=True):
        if not stance.standing.any():
            continue
        shift = _blend(_hold(stance), stance.standing, rate)
        foot = stance.turn * stance.foot
        toe = body.skeleton.index(f"{side}_foot")
        offset = body.skeleton.offsets[toe].copy()
        ankle_shift = shift + stance.foot.apply(offset) - foot.apply(offset)
        rotations = move_foot(body, root, rotations, side, ankle_shift, stance.turn)
        rotations[:, toe] = to_wxyz(foot.inv() * stance.toes)
        most = np.maximum(most, np.linalg.norm(shift, axis=1))
    return rotations, most


def _hold(stance: Stance) -> FloatArray:
    """Return what moves the ball to where it stands ``[N, 3]`` m, 0 in the swing."""
    shift = np.zeros(stance.ball.shape)
    for at in _runs(stance.standing):
        ball, rest = stance.ball[at], stance.rest[at]
        place = np.repeat(np.median(ball, axis=0)[None], len(ball), axis=0)
        if abs(np.median(ball[:, 2] - rest)) < MAX_PLANT:
            place[:, 2] = rest
        shift[at] = place - ball
    length = np.linalg.norm(shift, axis=1, keepdims=True)
    return shift * np.minimum(1.0, MAX_PLANT / np.maximum(length, 1e-9))


def _level(frames: Rotation, when: NDArray[np.bool_]) -> FloatArray:
    """Return rotation vectors, world, that level frames and hold their heading, 0 otherwise."""
    turn = np.zeros((len(when), 3))
    ahead = frames.apply([1.0, 0.0, 0.0])
    for at in _runs(when):
        heading = unit(np.median(ahead[at], axis=0) * (1.0, 1.0, 0.0))
        if heading.any():
            level = Rotation.from_euler("z", np.arctan2(heading[1], heading[0]))
            turn[at] = (level * frames[at].inv()).as_rotvec()
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    return turn * np.minimum(1.0, _BEND / np.maximum(length, 1e-9))


def _blend(values: NDArray, given: NDArray[np.bool_], rate: float) -> FloatArray:
    """Return corrections ``[N, 3]`` that are as given in spells, and change smoothly in between.

    Between two spells the value passes from the last of one to the first of the next; over a long
    gap it goes to zero and comes back within :data:`_EASE`.
    """
    out = np.array(values)
    known = np.flatnonzero(given)
    if not len(known):
        return out
    ease = max(1, round(_EASE * rate))
    moments = np.arange(len(given))
    behind = np.maximum.accumulate(np.where(given, moments, -1))
    ahead = np.minimum.accumulate(np.where(given, moments, len(given))[::-1])[::-1]
    gap = np.flatnonzero(~given)
    since = np.where(behind[gap] >= 0, gap - behind[gap], 10 * ease).astype(float)
    until = np.where(ahead[gap] < len(given), ahead[gap] - gap, 10 * ease).astype(float)
    reach = np.minimum(ease, np.maximum(since + until, 1))
    one = 1 - smoothstep(since / np.minimum(reach, since + until))
    other = 1 - smoothstep(until / np.minimum(reach, since + until))
    out[gap] = one[:, None] * values[behind[gap]] + other[:, None] * values[ahead[gap] % len(given)]
    return gaussian_filter1d(out, _POLISH * rate, axis=0, mode="nearest")
