"""The parts of finishing, each by what it promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.finishing.apart import TOLERATED, overlap, push_apart
from generator.finishing.bones import rigid_points
from generator.finishing.corrections import bridge, runs
from generator.finishing.denoise import denoise, noise_of
from generator.finishing.figure import Figure
from generator.finishing.limbs import move_end
from generator.finishing.resample import resample, resample_labels, resample_rotations
from generator.kinematics import to_wxyz
from robots.skeleton import human_skeleton

SKELETON = human_skeleton()


def figure(frames: int = 20, seed: int = 0, x: float = 0.0) -> Figure:
    rng = np.random.default_rng(seed)
    turns = 0.3 * rng.standard_normal((frames * len(SKELETON), 3))
    rotations = to_wxyz(Rotation.from_rotvec(turns)).reshape(frames, len(SKELETON), 4)
    return Figure(SKELETON, np.tile([x, 0.0, 0.95], (frames, 1)), rotations)


@pytest.mark.parametrize("size", [0.002, 0.005])
def test_jitter_goes_and_is_measured(size: float) -> None:
    rng = np.random.default_rng(0)
    times = np.arange(120) / 15
    clean = 0.3 * np.sin(0.8 * times)[:, None, None] * np.ones((1, 4, 3))
    noisy = clean + size * rng.standard_normal(clean.shape)
    assert noise_of(noisy) == pytest.approx(np.full(4, size), rel=0.3)
    left = denoise(noisy) - clean
    assert left.std() < 0.7 * size
    assert np.diff(left, 3, axis=0).std() < 0.1 * np.diff(noisy - clean, 3, axis=0).std()


def test_an_accent_keeps_its_height_and_its_moment() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(90) / 15
    strike = 0.3 * np.exp(-(((times - 3.0) / 0.15) ** 2))
    clean = np.repeat(strike[:, None, None], 3, axis=2)
    out = denoise(clean + 0.003 * rng.standard_normal(clean.shape))[:, 0, 0]
    assert int(np.argmax(out)) == int(np.argmax(strike))
    assert out.max() > 0.92 * strike.max()


def test_without_strength_nothing_changes() -> None:
    noisy = np.random.default_rng(2).standard_normal((30, 2, 3))
    np.testing.assert_array_equal(denoise(noisy, 0.0), noisy)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.05))
def test_bones_become_exact_and_points_move_little(seed: int, breath: float) -> None:
    rng = np.random.default_rng(seed)
    body = figure(4, seed % 100)
    points = body.points + breath * 0.3 * rng.standard_normal(body.points.shape)
    rigid = rigid_points(SKELETON, points)
    parents = list(SKELETON.parents[1:])
    lengths = np.linalg.norm(rigid[:, 1:] - rigid[:, parents], axis=-1)
    np.testing.assert_allclose(lengths, np.tile(SKELETON.bone_lengths[1:], (4, 1)), atol=2e-3)
    assert np.linalg.norm(rigid - points) <= np.linalg.norm(body.points - points) + 1e-3


def test_rigid_points_stay_where_they_are() -> None:
    body = figure()
    np.testing.assert_allclose(rigid_points(SKELETON, body.points), body.points, atol=1e-4)


@given(
    st.lists(st.booleans(), min_size=2, max_size=60),
    st.integers(1, 12),
    st.integers(0, 1000),
)
def test_corrections_hold_in_their_spells(mask: list[bool], ease: int, seed: int) -> None:
    given_ = np.array(mask)
    values = np.random.default_rng(seed).standard_normal((len(mask), 3))
    out = bridge(values, given_, ease)
    np.testing.assert_array_equal(out[given_], values[given_])
    assert np.isfinite(out).all()
    if not given_.any():
        assert not out.any()


def test_corrections_pass_smoothly_and_fade() -> None:
    times = np.arange(100.0)
    values = 0.01 * times[:, None]
    mask = (times >= 20) & (times < 40) | (times >= 50) & (times < 60)
    out = bridge(values, mask, 8)[:, 0]
    # the ramp goes on through the short gap, as its slope fits
    np.testing.assert_allclose(out[40:50], 0.01 * times[40:50], atol=1e-9)
    assert out[0] == 0
    assert out[80] == 0
    assert np.abs(np.diff(out, 2)).max() < 0.06


def test_runs_are_found() -> None:
    mask = np.array([True, True, False, True, False])
    assert runs(mask) == [slice(0, 2), slice(3, 4)]


def test_splines_pass_through_their_frames() -> None:
    rng = np.random.default_rng(3)
    values = np.cumsum(rng.standard_normal((20, 3)), axis=0)
    np.testing.assert_allclose(resample(values, 15, 30)[::2], values, atol=1e-9)
    assert len(resample(values, 15, 30)) == 39
    np.testing.assert_array_equal(resample(values, 30, 30), values)


def test_a_steady_turn_stays_steady() -> None:
    angle = 0.2 * np.arange(20)
    vectors = angle[:, None] * np.array([0.0, 0.6, 0.8])
    steady = to_wxyz(Rotation.from_rotvec(vectors))[:, None]
    made = resample_rotations(steady, 15, 30)[:, 0]
    turned = Rotation.from_quat(made, scalar_first=True)
    steps = (turned[:-1].inv() * turned[1:]).magnitude()
    np.testing.assert_allclose(steps, 0.1, atol=1e-3)


def test_labels_are_those_of_the_nearest_frame() -> None:
    labels = np.array([[True], [False], [True]])
    assert resample_labels(labels, 10, 20)[:, 0].tolist() == [True, True, False, True, True]


def test_a_limb_reaches_its_goal_and_keeps_its_bones() -> None:
    body = figure(seed=4)
    goal = body.point("right_hand") + 0.05 * np.random.default_rng(0).standard_normal((20, 3))
    goal = body.point("right_shoulder") + 0.8 * (goal - body.point("right_shoulder"))
    feet = body.point("left_foot").copy()
    move_end(body, "right_shoulder", "right_elbow", "right_hand", goal)
    np.testing.assert_allclose(body.point("right_hand"), goal, atol=1e-4)
    parents = list(SKELETON.parents[1:])
    lengths = np.linalg.norm(body.points[:, 1:] - body.points[:, parents], axis=-1)
    np.testing.assert_allclose(lengths, np.tile(SKELETON.bone_lengths[1:], (20, 1)), atol=1e-9)
    np.testing.assert_array_equal(body.point("left_foot"), feet)


@pytest.mark.filterwarnings("error")
def test_a_limb_of_no_length_stays_finite() -> None:
    """An untrained network may put two keypoints in one place."""
    lengths = SKELETON.bone_lengths.copy()
    lengths[[SKELETON.index("left_knee"), SKELETON.index("right_ankle")]] = 0
    lame = SKELETON.with_bone_lengths(lengths)
    body = figure(seed=3)
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (20, len(lame), 1))
    body = Figure(lame, body.points[:, 0], turns)
    for side in ("left", "right"):
        goal = body.point(f"{side}_ankle") + np.array([0.1, 0.0, 0.1])
        move_end(body, f"{side}_hip", f"{side}_knee", f"{side}_ankle", goal)
    assert np.isfinite(body.points).all()


def test_no_change_of_place_is_no_change_of_pose() -> None:
    body = figure(seed=5)
    frames = body.frames.copy()
    move_end(body, "left_hip", "left_knee", "left_ankle", body.point("left_ankle").copy())
    np.testing.assert_allclose(body.frames, frames, atol=1e-6)


def test_people_inside_each_other_come_apart() -> None:
    still = np.tile([1.0, 0.0, 0.0, 0.0], (30, len(SKELETON), 1))
    a, b = (Figure(SKELETON, np.tile([x, 0.0, 0.95], (30, 1)), still) for x in (0.0, 0.15))
    assert overlap((a, b)).max() > 0.05
    push_apart((a, b), 30.0)
    assert overlap((a, b)).max() < TOLERATED + 0.005
