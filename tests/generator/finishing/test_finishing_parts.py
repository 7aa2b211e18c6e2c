"""The parts of finishing, each by what it promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.finishing.apart import TOLERATED, overlap, push_apart
from generator.finishing.approach import step_nearer
from generator.finishing.bones import fit_bones, rigid_points
from generator.finishing.corrections import bridge, runs
from generator.finishing.denoise import denoise, noise_of
from generator.finishing.feet import plant_feet
from generator.finishing.figure import Figure
from generator.finishing.limbs import move_end
from generator.finishing.resample import resample, resample_labels, resample_rotations
from generator.finishing.settings import Finishing
from generator.finishing.touches import Meeting, nearest_touches
from generator.kinematics import to_wxyz
from generator.motion import Contact
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


def test_waving_is_not_taken_for_noise() -> None:
    """Five frames of 7.5 a second hold a whole wave, and hands wave for most of a clip."""
    rng = np.random.default_rng(3)
    times = np.arange(60) / 7.5
    waving = np.where(times < 5.2, 0.15 * np.sin(2 * np.pi * 2.0 * times), 0.0)
    clean = np.repeat(waving[:, None, None], 3, axis=2)
    out = denoise(clean + 0.001 * rng.standard_normal(clean.shape))
    assert np.abs(out - clean).max() < 0.02


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


def test_noise_does_not_turn_a_pelvis_round() -> None:
    """Hips and lower spine came out in the mirror now and then: it span by 120 degrees."""
    points = standing(0.0, 300).points.copy()
    points += 0.04 * np.random.default_rng(0).standard_normal(points.shape)
    _, _, rotations = fit_bones(SKELETON, points, None, keep=True)
    turns = np.degrees(2 * np.arccos(np.clip(np.abs(rotations[:, 0, 0]), 0.0, 1.0)))
    assert turns.max() < 90
    assert np.percentile(turns, 99) < 60


def test_angles_put_right_what_shortened_a_forearm() -> None:
    """A network drew pushes with forearms half as long, but elbows turned as they should be."""
    true = standing(0.0, 20)
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (20, len(SKELETON), 1))
    points = true.points.copy()
    elbow, wrist = (SKELETON.index(f"left_{name}") for name in ("elbow", "wrist"))
    points[8:14, wrist] = 0.5 * (points[8:14, elbow] + points[8:14, wrist])
    points[8:14, wrist, 2] += 0.1

    def missed(share: float) -> float:
        skeleton, root, rotations = fit_bones(SKELETON, points, turned, share=share)
        made = Figure(skeleton, root, rotations).points
        return float(np.linalg.norm(made - true.points, axis=-1)[:, wrist].max())

    assert missed(0.0) > 0.1
    assert missed(0.9) < 0.03


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


def standing(x: float, frames: int = 30) -> Figure:
    still = np.tile([1.0, 0.0, 0.0, 0.0], (frames, len(SKELETON), 1))
    return Figure(SKELETON, np.tile([x, 0.0, 0.95], (frames, 1)), still)


def hands(gap: float = 0.06) -> list[Contact]:
    return [Contact("right_hand", "right_hand", 0.2, 0.6, gap)]


@pytest.mark.parametrize(("miss", "each"), [(0.10, 0.0), (0.36, 0.12), (0.60, 0.15)])
def test_people_step_nearer_by_what_arms_should_not_close(miss: float, each: float) -> None:
    people = standing(0.0), standing(1.0)
    before = [person.points.copy() for person in people]
    assert step_nearer(people, 30.0, hands(1.0 - miss), Finishing()) == pytest.approx(each)
    for person, was, way in zip(people, before, (1, -1), strict=True):
        moved = person.points - was
        np.testing.assert_allclose(
            moved, np.broadcast_to((way * each, 0, 0), moved.shape), atol=1e-9
        )


def test_nobody_steps_into_the_other_or_after_what_is_out_of_reach() -> None:
    wide, far = (standing(0.0), standing(0.45)), (standing(0.0), standing(1.5))
    room = overlap(wide).max()
    assert room < TOLERATED
    step_nearer(wide, 30.0, hands(), Finishing(max_step=0.5))
    assert overlap(wide).max() < TOLERATED
    assert step_nearer(far, 30.0, hands(), Finishing()) == 0.0
    near = standing(0.0), standing(0.6)
    assert step_nearer(near, 30.0, hands(), Finishing(max_step=0.0)) == 0.0


def test_both_grips_of_a_circle_are_kept() -> None:
    """One by one, each of the two would become the nearer, and be the same."""
    people = standing(0.0), standing(0.6)
    people[1].shift(np.tile([0.0, 0.1, 0.0], (30, 1)))
    grips = [
        Meeting("left_hand", "right_hand", either=True),
        Meeting("right_hand", "left_hand", either=True),
    ]
    found = nearest_touches(people, 30.0, grips)
    assert {(c.a, c.b) for c in found} == {
        ("left_hand", "right_hand"),
        ("right_hand", "left_hand"),
    }


def shuffling(slide: float) -> Figure:
    """A foot that stands, slides for half a second without being lifted, and stands again."""
    body = standing(0.0, 60)
    u = np.clip((np.arange(60) - 22) / 16, 0.0, 1.0)
    way = (slide * u**3 * (10 - 15 * u + 6 * u**2))[:, None] * (1.0, 0.0, 0.0)
    for side, moved in (("left", way), ("right", 0 * way)):
        goal = body.point(f"{side}_ankle") + moved + (0.0, 0.0, 0.1)
        move_end(body, f"{side}_hip", f"{side}_knee", f"{side}_ankle", goal)
    return body


@pytest.mark.parametrize("slide", [0.16, 0.25])
def test_a_foot_that_goes_to_another_place_is_lifted(slide: float) -> None:
    body = shuffling(slide)
    down, _ = plant_feet(body, 30.0, None, Finishing())
    toe = body.point("left_foot")
    assert down[:20, 1].all()
    assert down[42:, 1].all()
    assert toe[50, 0] - toe[5, 0] == pytest.approx(slide, abs=0.04)
    height = toe[:, 2] - toe[0, 2]
    quick = np.linalg.norm(np.diff(toe[:, :2], axis=0), axis=1) * 30 > 0.3
    assert quick.any()
    assert np.maximum(height[1:], height[:-1])[quick].min() > 0.004
    assert height.max() > 0.15 * slide
