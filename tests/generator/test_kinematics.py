from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.kinematics import (
    continuous,
    fit_rotations,
    fit_skeleton,
    forward_kinematics,
    from_wxyz,
    global_rotations,
    to_wxyz,
    unit,
)
from robots.skeleton import human_skeleton

SEEDS = st.integers(0, 2**32 - 1)
PARENTS = list(human_skeleton().parents)


def random_pose(seed, frames=4, size=None):
    """Rotations ``[T, 22, 4]``: any at all, or of at most ``size`` rad from rest."""
    rng = np.random.default_rng(seed)
    if size is None:
        turns = Rotation.random(frames * 22, rng=rng)
    else:
        turns = Rotation.from_rotvec(rng.uniform(-1, 1, (frames * 22, 3)) * size / np.sqrt(3))
    return to_wxyz(turns).reshape(frames, 22, 4), rng.normal(size=(frames, 3))


def smooth_pose(seed, frames=60, fps=30.0, size=0.8):
    rng = np.random.default_rng(seed)
    times = np.arange(frames)[:, None, None] / fps
    turns = size * np.sin(rng.uniform(1, 4, (22, 3)) * times + rng.uniform(0, 6, (22, 3)))
    quaternions = to_wxyz(Rotation.from_rotvec(turns.reshape(-1, 3))).reshape(frames, 22, 4)
    return quaternions, np.tile([0.0, 0.0, 0.9], (frames, 1))


def test_the_rest_pose_is_the_sum_of_the_offsets():
    skeleton = human_skeleton()
    identity = np.tile([1.0, 0, 0, 0], (2, 22, 1))
    points = forward_kinematics(skeleton, np.zeros((2, 3)), identity)
    for j, parent in enumerate(PARENTS[1:], start=1):
        np.testing.assert_allclose(points[:, j] - points[:, parent], [skeleton.offsets[j]] * 2)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_bones_keep_their_lengths_in_any_pose(seed):
    skeleton = human_skeleton()
    quaternions, root = random_pose(seed)
    points = forward_kinematics(skeleton, root, quaternions)
    lengths = np.linalg.norm(points[:, 1:] - points[:, PARENTS[1:]], axis=-1)
    np.testing.assert_allclose(lengths, [skeleton.bone_lengths[1:]] * 4, atol=1e-12)
    np.testing.assert_array_equal(points[:, 0], root)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_turning_the_root_turns_the_whole_body(seed):
    skeleton = human_skeleton()
    quaternions, root = random_pose(seed)
    turn = Rotation.random(rng=np.random.default_rng(seed))
    turned = quaternions.copy()
    turned[:, 0] = to_wxyz(turn * from_wxyz(quaternions[:, 0]))
    points = forward_kinematics(skeleton, root, quaternions)
    expected = root[:, None] + np.einsum("ij,tkj->tki", turn.as_matrix(), points - root[:, None])
    np.testing.assert_allclose(forward_kinematics(skeleton, root, turned), expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_global_rotations_are_products_along_the_chain(seed):
    quaternions, _ = random_pose(seed)
    frames = global_rotations(human_skeleton(), quaternions)
    chain, j = Rotation.identity(4), 20
    while j >= 0:
        chain = from_wxyz(quaternions[:, j]) * chain
        j = PARENTS[j]
    assert (frames[20].inv() * chain).magnitude().max() < 1e-9


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_fitted_rotations_reproduce_any_rigid_pose(seed):
    skeleton = human_skeleton()
    quaternions, root = random_pose(seed)
    points = forward_kinematics(skeleton, root, quaternions)
    found = forward_kinematics(skeleton, root, fit_rotations(skeleton, points))
    np.testing.assert_allclose(found, points, atol=1e-7)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, scale=st.floats(0.3, 3))
def test_fitted_skeletons_have_the_bones_of_the_motion(seed, scale):
    skeleton = human_skeleton().scaled(scale)
    quaternions, root = random_pose(seed)
    points = forward_kinematics(skeleton, root, quaternions)
    fitted = fit_skeleton(human_skeleton(), points)
    np.testing.assert_allclose(fitted.offsets, skeleton.offsets, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_the_fit_turns_with_the_world(seed):
    """A person seen from another side gets the same local rotations and a turned root."""
    skeleton = human_skeleton()
    quaternions, root = random_pose(seed, size=1.0)
    points = forward_kinematics(skeleton, root, quaternions)
    turn = Rotation.random(rng=np.random.default_rng(seed))
    one = fit_rotations(skeleton, points)
    two = fit_rotations(skeleton, points @ turn.as_matrix().T)
    local = from_wxyz(one[:, 1:].reshape(-1, 4)).inv() * from_wxyz(two[:, 1:].reshape(-1, 4))
    assert local.magnitude().max() < 1e-5
    root_turn = (turn * from_wxyz(one[:, 0])).inv() * from_wxyz(two[:, 0])
    assert root_turn.magnitude().max() < 1e-5


def test_the_rest_pose_fits_without_any_rotation():
    skeleton = human_skeleton()
    identity = np.tile([1.0, 0, 0, 0], (3, 22, 1))
    points = forward_kinematics(skeleton, np.zeros((3, 3)), identity)
    np.testing.assert_allclose(np.abs(fit_rotations(skeleton, points)), identity, atol=1e-6)


@pytest.mark.parametrize(
    ("joint", "axis"),
    [
        ("left_knee", (0, 1, 0)),
        ("right_knee", (0, 1, 0)),
        ("left_elbow", (0, 0, -1)),
        ("right_elbow", (0, 0, 1)),
    ],
)
@pytest.mark.parametrize("spin", [-0.7, 0.0, 0.7])
def test_a_bent_limb_shows_how_the_upper_limb_is_spun(joint, axis, spin):
    """Knees bend back and elbows forward about one axis; a spun thigh must not be lost."""
    skeleton = human_skeleton()
    upper = skeleton.parents[skeleton.index(joint)]
    along = unit(skeleton.offsets[skeleton.index(joint)])
    quaternions = np.tile([1.0, 0, 0, 0], (2, 22, 1))
    quaternions[:, upper] = to_wxyz(Rotation.from_rotvec(along * spin))
    quaternions[:, skeleton.index(joint)] = to_wxyz(Rotation.from_rotvec(np.multiply(axis, 1.2)))
    points = forward_kinematics(skeleton, np.zeros((2, 3)), quaternions)
    found = fit_rotations(skeleton, points)
    error = from_wxyz(found[:, upper]).inv() * from_wxyz(quaternions[:, upper])
    assert error.magnitude().max() < 0.06  # the shank's rest direction is 3 degrees off the thigh's


def test_opposite_directions_are_turned_half_around():
    """The axis is open where a bone points against its rest direction."""
    skeleton = human_skeleton()
    rng = np.random.default_rng(0)
    quaternions = np.tile([1.0, 0, 0, 0], (6, 22, 1))
    for frame, axis in enumerate(np.concatenate([np.eye(3), -np.eye(3)])):
        quaternions[frame, 18] = to_wxyz(Rotation.from_rotvec(np.pi * axis))
    points = forward_kinematics(skeleton, rng.normal(size=(6, 3)), quaternions)
    found = forward_kinematics(skeleton, points[:, 0], fit_rotations(skeleton, points))
    np.testing.assert_allclose(found, points, atol=1e-7)


HINGES = {4: (0, 1, 0), 5: (0, 1, 0), 18: (0, 0, -1), 19: (0, 0, 1)}
"""Knees and elbows with the axes about which people bend them."""


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_the_fit_of_a_smooth_motion_is_smooth(seed):
    """Limbs pass through straight, where nothing shows how they are spun, and must not snap."""
    skeleton = human_skeleton()
    quaternions, root = smooth_pose(seed, size=0.4)
    rng = np.random.default_rng(seed)
    for joint, axis in HINGES.items():
        bend = 0.8 - 0.8 * np.cos(rng.uniform(1, 4) * np.arange(60) / 30 + rng.uniform(0, 6))
        quaternions[:, joint] = to_wxyz(Rotation.from_rotvec(bend[:, None] * np.array(axis)))
    points = forward_kinematics(skeleton, root, quaternions)
    found = fit_rotations(skeleton, points)
    dots = np.einsum("tji,tji->tj", found[1:], found[:-1])
    assert dots.min() > 0
    steps = 2 * np.degrees(np.arccos(np.clip(dots, -1, 1)))
    assert steps.max() < 25


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_continuous_changes_signs_only(seed):
    rng = np.random.default_rng(seed)
    quaternions, _ = smooth_pose(seed, frames=20)
    flipped = quaternions * rng.choice([-1.0, 1.0], size=(20, 22, 1))
    found = continuous(flipped)
    np.testing.assert_array_equal(np.abs(found), np.abs(flipped))
    assert (np.einsum("tji,tji->tj", found[1:], found[:-1]) >= 0).all()
    np.testing.assert_array_equal(found[0], flipped[0])
    np.testing.assert_array_equal(continuous(found), found)


@given(seed=SEEDS)
def test_quaternions_are_wxyz(seed):
    angle = np.random.default_rng(seed).uniform(-3, 3)
    quaternion = to_wxyz(Rotation.from_rotvec([0, 0, angle]))
    np.testing.assert_allclose(quaternion[0], np.cos(angle / 2), atol=1e-12)
    np.testing.assert_allclose(quaternion[3], np.sin(angle / 2), atol=1e-12)
    back = from_wxyz(quaternion[None]).as_rotvec()[0]
    np.testing.assert_allclose(back, [0, 0, angle], atol=1e-9)


def test_unit_vectors_have_length_one_and_zero_stays_zero():
    vectors = np.array([[3.0, 0, 4], [0, 0, 0], [1e-200, 0, 0]])
    np.testing.assert_allclose(unit(vectors), [[0.6, 0, 0.8], [0, 0, 0], [0, 0, 0]])
