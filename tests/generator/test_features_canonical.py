"""The canonical representation: there and back, and what it is invariant to."""

from __future__ import annotations

import numpy as np
import pytest

from generator.canonical import (
    CANONICAL_FEATURES,
    HEIGHT,
    LOCAL_POSITIONS,
    PARTNER_DIRECTION,
    PARTNER_PLACE,
    STEP,
    TURN,
    from_canonical,
    to_canonical,
)
from generator.features import POINTS, POSITIONS, VELOCITIES, decode, encode
from generator.placement import turn_about_y
from robots.errors import MotionError


def test_the_round_trip_is_exact(make_duet):
    features = encode(make_duet(frames=60))
    back = from_canonical(to_canonical(features))
    np.testing.assert_allclose(back, features, rtol=0, atol=1e-9)


def test_the_round_trip_of_a_motion_keeps_keypoints(make_duet):
    motion = make_duet(frames=30)
    direct = decode(encode(motion), motion.fps)
    through = decode(from_canonical(to_canonical(encode(motion))), motion.fps)
    np.testing.assert_allclose(through.keypoints, direct.keypoints, rtol=0, atol=1e-9)


def moved_rigidly(features, turn, shift):
    out = features.copy()
    shape = (len(features), 2, POINTS, 3)
    out[..., POSITIONS] = (
        turn_about_y(features[..., POSITIONS].reshape(shape), turn) + shift
    ).reshape(len(features), 2, -1)
    out[..., VELOCITIES] = turn_about_y(features[..., VELOCITIES].reshape(shape), turn).reshape(
        len(features), 2, -1
    )
    return out


def test_it_does_not_depend_on_where_the_pair_stands(make_duet):
    features = encode(make_duet(frames=20))
    moved = moved_rigidly(features, 1.9, (2.0, 0.0, -3.0))
    np.testing.assert_allclose(to_canonical(moved), to_canonical(features), rtol=0, atol=1e-9)


def walker(turn, step, frames=5):
    """A straight body that turns and steps ahead in every frame; its partner stands still."""
    features = np.zeros((frames, 2, 262))
    pose = np.zeros((POINTS, 3))
    pose[:, 1] = 1.0
    pose[1, 0], pose[2, 0] = 0.1, -0.1
    points = np.zeros((frames + 1, 2, POINTS, 3))
    root = np.zeros(3)
    for i in range(frames + 1):
        points[i, 0] = turn_about_y(pose, i * turn) + root
        points[i, 1] = turn_about_y(pose, np.pi / 2) + np.array([0.0, 0.0, 2.0])
        root = root + turn_about_y(np.array([0.0, 0.0, step]), i * turn)
    features[..., POSITIONS] = points[:-1].reshape(frames, 2, -1)
    features[..., VELOCITIES] = np.diff(points, axis=0).reshape(frames, 2, -1)
    return features


def test_its_numbers_mean_what_they_say():
    canonical = to_canonical(walker(0.1, 0.05))
    assert canonical.shape == (5, 2, CANONICAL_FEATURES)
    np.testing.assert_allclose(canonical[:, 0, TURN], 0.1, atol=1e-12)
    np.testing.assert_allclose(canonical[:, 0, STEP], [[0, 0.05]] * 5, atol=1e-12)
    np.testing.assert_allclose(canonical[:, 1, TURN], 0, atol=1e-12)
    np.testing.assert_allclose(canonical[..., HEIGHT], 1)
    # In its own frame the body never moves.
    np.testing.assert_allclose(
        canonical[:, :, LOCAL_POSITIONS],
        canonical[:1, :1, LOCAL_POSITIONS] + np.zeros((5, 2, 63)),
        atol=1e-12,
    )
    # The partner stands 2 m ahead and faces left; from its side, a is 2 m to its right.
    np.testing.assert_allclose(canonical[0, 0, PARTNER_PLACE], (0, 2), atol=1e-12)
    np.testing.assert_allclose(canonical[0, 0, PARTNER_DIRECTION], (0, 1), atol=1e-12)
    np.testing.assert_allclose(canonical[0, 1, PARTNER_PLACE], (2, 0), atol=1e-12)
    np.testing.assert_allclose(canonical[0, 1, PARTNER_DIRECTION], (0, -1), atol=1e-12)


def test_an_error_in_a_turn_grows_over_time(make_duet):
    """The drift for which the paper prefers the other representation."""
    canonical = to_canonical(walker(0.0, 0.05, frames=50))
    canonical[10, 0, TURN] += 0.01
    drift = from_canonical(canonical)[:, 0, :3] - walker(0.0, 0.05, frames=50)[:, 0, :3]
    size = np.linalg.norm(drift, axis=1)
    assert size[10] < 1e-9
    assert size[49] > 3 * size[20] > 0


def test_wrong_shapes_are_named():
    with pytest.raises(MotionError, match="262"):
        to_canonical(np.zeros((4, 2, 267)))
    with pytest.raises(MotionError, match="267"):
        from_canonical(np.zeros((4, 2, 262)))
