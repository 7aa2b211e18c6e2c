"""The canonical representation (Sec. 4.1, eq. 1): each person in its own moving frame.

    x = [ turn 1 | step 2 | pelvis height 1 | positions 21*3 | displacements 22*3
          | local rotations 21*6 | foot contacts 4 | partner's direction 2 | partner's place 2 ]

The frame of a person stands under the pelvis and faces where the hips face. *Turn* (rad) and *step*
(m, x and z) lead from this frame's moment to the next; positions leave out the pelvis, which only
has its height; the partner's direction is the cosine and sine of its heading relative to one's own.
The layout of the first 263 is that of HumanML3D; nothing is divided by the frame time.

It is a function of the non-canonical features of :mod:`generator.features` and back again, without
loss except for where the pair stands. The way back sums up turns and steps from the first frame, so
that errors of a generated motion grow over time: the drift for which the paper rejects this
representation (row "canonical rep" of Table 3). Person b is set in place by what person a says of
it in the first frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.architecture import FEATURES
from generator.features import CONTACTS, POINTS, POSITIONS, ROTATIONS, VELOCITIES
from generator.placement import facing_yaw, turn_about_y
from robots.errors import MotionError
from robots.skeleton import FloatArray

CANONICAL_FEATURES = 267
"""Numbers per person and frame."""

TURN = 0
STEP = slice(1, 3)
HEIGHT = 3
LOCAL_POSITIONS = slice(4, 67)
LOCAL_VELOCITIES = slice(67, 133)
LOCAL_ROTATIONS = slice(133, 259)
LOCAL_CONTACTS = slice(259, 263)
PARTNER_DIRECTION = slice(263, 265)
PARTNER_PLACE = slice(265, 267)


def to_canonical(features: NDArray) -> FloatArray:
    """Return canonical features ``[N, 2, 267]`` of non-canonical ones ``[N, 2, 262]``.

    Raises:
        MotionError: The shape does not fit.
    """
    features = _require(features, FEATURES)
    rows = len(features)
    positions = features[..., POSITIONS].reshape(rows, 2, POINTS, 3)
    velocities = features[..., VELOCITIES].reshape(rows, 2, POINTS, 3)
    after = positions[-1:] + velocities[-1:]  # the frame that the encoding dropped
    headings = np.stack(
        [-facing_yaw(np.concatenate([positions[:, p], after[:, p]])) for p in range(2)], axis=1
    )
    now = headings[:-1]
    turns = _wrapped(np.diff(headings, axis=0))
    roots = positions[:, :, 0]
    ground = roots * (1.0, 0.0, 1.0)
    local = turn_about_y(positions - ground[:, :, None], -now[..., None])
    moves = turn_about_y(velocities, -now[..., None])
    apart = _wrapped(now[:, ::-1] - now)
    place = turn_about_y(ground[:, ::-1] - ground, -now)
    return np.concatenate(
        [
            turns[..., None],
            moves[:, :, 0, ::2],
            roots[..., 1:2],
            local[:, :, 1:].reshape(rows, 2, -1),
            moves.reshape(rows, 2, -1),
            features[..., ROTATIONS],
            features[..., CONTACTS],
            np.stack([np.cos(apart), np.sin(apart)], axis=-1),
            place[..., ::2],
        ],
        axis=-1,
    )


def from_canonical(features: NDArray) -> FloatArray:
    """Return non-canonical features ``[N, 2, 262]`` of canonical ones ``[N, 2, 267]``.

    Person a starts above the origin and faces +z.

    Raises:
        MotionError: The shape does not fit.
    """
    features = _require(features, CANONICAL_FEATURES)
    rows = len(features)
    turns, steps = features[..., TURN], features[..., STEP]
    cos, sin = features[0, 0, PARTNER_DIRECTION]
    headings = np.zeros((rows, 2))
    headings[0, 1] = np.arctan2(sin, cos)
    headings[1:] = headings[0] + np.cumsum(turns[:-1], axis=0)
    step = np.stack([steps[..., 0], np.zeros((rows, 2)), steps[..., 1]], axis=-1)
    roots = np.zeros((rows, 2, 3))
    roots[0, 1, ::2] = features[0, 0, PARTNER_PLACE]
    roots[1:] = roots[0] + np.cumsum(turn_about_y(step, headings)[:-1], axis=0)
    local = np.zeros((rows, 2, POINTS, 3))
    local[:, :, 0, 1] = features[..., HEIGHT]
    local[:, :, 1:] = features[..., LOCAL_POSITIONS].reshape(rows, 2, -1, 3)
    positions = turn_about_y(local, headings[..., None]) + roots[:, :, None]
    moves = features[..., LOCAL_VELOCITIES].reshape(rows, 2, POINTS, 3)
    velocities = turn_about_y(moves, headings[..., None])
    return np.concatenate(
        [
            positions.reshape(rows, 2, -1),
            velocities.reshape(rows, 2, -1),
            features[..., LOCAL_ROTATIONS],
            features[..., LOCAL_CONTACTS],
        ],
        axis=-1,
    )


def _wrapped(angle: NDArray) -> FloatArray:
    return np.arctan2(np.sin(angle), np.cos(angle))


def _require(features: NDArray, width: int) -> FloatArray:
    features = np.asarray(features, float)
    if features.ndim != 3 or features.shape[1:] != (2, width) or not len(features):
        raise MotionError(f"features have shape {features.shape}", allowed=f"(frames, 2, {width})")
    return features
