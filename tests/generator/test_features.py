"""The non-canonical representation: against the release's vectors, and there and back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.features import (
    CONTACTS,
    POSITIONS,
    ROTATIONS,
    VELOCITIES,
    Poses,
    decode,
    encode,
    foot_contacts,
    from_sixd,
    loaded_columns,
    lowest,
    pair_features,
    pair_placement,
    person_features,
    poses_of,
    release_features,
    release_poses,
    to_sixd,
)
from generator.motion import DuetMotion, Motion
from generator.placement import Placement, facing_yaw, placement_of, turn_about_y
from robots.errors import MotionError


@pytest.fixture(scope="module")
def arrays(golden):
    with np.load(golden / "preprocess.npz", allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def close(actual, expected, atol=1e-5):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=atol)


def test_parity_of_the_loaded_columns(arrays):
    for person in "12":
        close(loaded_columns(arrays[f"file_person{person}"]), arrays[f"loaded{person}"], 0)


def test_parity_of_the_pair(arrays):
    first, second = release_features(arrays["file_person1"], arrays["file_person2"])
    close(first, arrays["canon1"])
    close(second, arrays["canon2"])


def test_parity_of_the_pair_from_loaded_columns(arrays):
    first, second = release_features(arrays["loaded1"], arrays["loaded2"])
    close(first, arrays["canon1"])
    close(second, arrays["canon2"])


def test_parity_of_exchanged_persons(arrays):
    files = arrays["file_person1"], arrays["file_person2"]
    first, second = release_features(*files[::-1])
    close(first, arrays["swapped_canon1"])
    close(second, arrays["swapped_canon2"])
    second, first = release_features(*files, canonical=1)
    close(first, arrays["swapped_canon1"])
    close(second, arrays["swapped_canon2"])


def test_parity_of_the_steps_between(arrays):
    placements = []
    for person, name in (("1", "canon1"), ("2", "canon2_before_rigid")):
        poses = release_poses(arrays[f"file_person{person}"])
        placement = placement_of(poses.positions, lowest(poses))
        close(placement.quaternion, arrays[f"root_quat{person}"][0])
        # The release reports the root after the floor is subtracted and before it is moved.
        close(np.multiply(placement.root, (1, 0, 1)), arrays[f"root_pos{person}"][0])
        close(person_features(poses, placement), arrays[name])
        placements.append(placement)
    relative = placements[1].seen_from(placements[0])
    close(relative, arrays["relative"])
    own = arrays["canon2_before_rigid"]
    points = turn_about_y(own[:, POSITIONS].reshape(-1, 22, 3), -2 * relative[0])
    points += (relative[1], 0, relative[2])
    close(points.reshape(len(own), -1), arrays["canon2"][:, POSITIONS])


def test_parity_of_normalised_features(arrays, golden):
    """The statistics are not stored; they follow from pairs of raw and normalised features."""
    with np.load(golden / "losses.npz") as file:
        raw, norm = (file[f"x_start_{x}"].reshape(-1, 262).astype(float) for x in ("raw", "norm"))
    std = raw.std(axis=0) / np.maximum(norm.std(axis=0), 1e-9)
    mean = (raw - norm * std).mean(axis=0)
    moving = norm.std(axis=0) > 1e-3
    pair = release_features(arrays["file_person1"], arrays["file_person2"])
    for features, name in zip(pair, ("normalised1", "normalised2"), strict=True):
        scale = np.maximum(1, 1 / std[moving])  # an error of 5e-7 m is 1e-4 where std is 0.007
        error = np.abs((features - mean) / std - arrays[name])[:, moving]
        assert moving.sum() > 250
        assert (error < 1e-5 * scale).all()


def test_a_duet_keeps_its_place_and_time(make_duet):
    motion = make_duet(frames=40)
    back = decode(encode(motion), motion.fps, placement=pair_placement(motion))
    close(back.keypoints, motion.keypoints[:-1], 1e-9)
    assert (back.fps, back.frames) == (motion.fps, 39)


def test_rotations_come_back_in_our_rest_frames(make_duet):
    motion = make_duet(frames=30)
    back = decode(
        encode(motion),
        motion.fps,
        placement=pair_placement(motion),
        skeletons=(motion.a.skeleton, motion.b.skeleton),
        rotations="features",
    )
    for person, original in zip(back.people, motion.people, strict=True):
        close(np.abs((person.rotations * original.rotations[:-1]).sum(-1)), 1, 1e-9)


def test_rotations_are_those_of_smpl_s_rest_frames(make_duet):
    """An elbow that bends about up: z in our rest frames, y in SMPL's."""
    motion = make_duet(frames=3)
    rotations = np.tile([1.0, 0, 0, 0], (3, 22, 1))
    elbow = motion.a.skeleton.index("left_elbow")
    rotations[:, elbow] = Rotation.from_euler("z", -0.7).as_quat(scalar_first=True)
    bent = replace(motion, a=replace(motion.a, rotations=rotations))
    sixd = encode(bent)[0, 0, ROTATIONS].reshape(21, 6)
    c, s = np.cos(-0.7), np.sin(-0.7)
    close(sixd[elbow - 1], (c, 0, 0, 1, -s, 0), 1e-12)
    close(np.delete(sixd, elbow - 1, axis=0), [(1, 0, 0, 1, 0, 0)] * 20, 1e-12)


def test_fitted_rotations_agree_with_the_keypoints(make_duet):
    from generator.kinematics import forward_kinematics

    motion = make_duet(frames=20)
    back = decode(encode(motion), motion.fps)
    for person in back.people:
        assert person.rotations is not None
        points = forward_kinematics(person.skeleton, person.keypoints[:, 0], person.rotations)
        assert np.linalg.norm(points - person.keypoints, axis=-1).mean() < 2e-3


def test_without_a_placement_person_a_starts_at_the_origin_and_faces_x(make_duet):
    motion = make_duet(frames=12)
    back = decode(encode(motion), motion.fps)
    close(back.a.keypoints[0, 0, :2], 0, 1e-9)
    across = back.a.point("left_hip")[0] - back.a.point("right_hip")[0]
    assert across[1] > 0.1
    assert abs(across[0]) < 1e-9
    assert abs(back.keypoints[..., 2].min()) < 1e-9
    now, before = (
        np.linalg.norm(m.keypoints[:11, 0, :, None] - m.keypoints[:11, 1, None], axis=-1)
        for m in (back, motion)
    )
    close(now, before, 1e-9)


def test_where_the_pair_stands_does_not_change_the_features(make_duet):
    motion = make_duet(frames=15)
    turn = Rotation.from_euler("z", 2.3)
    shift = np.array([3.0, -7.0, 0.4])

    def moved(person: Motion) -> Motion:
        points = person.keypoints @ turn.as_matrix().T
        rotations = np.array(person.rotations)
        rotations[:, 0] = (turn * Rotation.from_quat(rotations[:, 0], scalar_first=True)).as_quat(
            scalar_first=True
        )
        return replace(person, keypoints=points + shift, rotations=rotations)

    other = DuetMotion(moved(motion.a), moved(motion.b))
    close(encode(other), encode(motion), 1e-9)


def lifted(motion: DuetMotion, height: float) -> DuetMotion:
    points = motion.b.keypoints + np.array([0, 0, height])
    return replace(motion, b=replace(motion.b, keypoints=points))


def test_rotations_are_fitted_where_a_motion_has_none(make_duet):
    motion = make_duet(frames=12)
    bare = replace(motion, a=replace(motion.a, rotations=None), b=replace(motion.b, rotations=None))
    features = encode(bare)
    close(features[..., POSITIONS], encode(motion)[..., POSITIONS], 0)
    columns = features[..., ROTATIONS].reshape(-1, 3, 2)
    close(np.linalg.norm(columns, axis=1), 1, 1e-9)
    assert np.abs(features[..., ROTATIONS] - encode(motion)[..., ROTATIONS]).mean() < 0.2


def test_a_lifted_person_stays_lifted_in_our_form_only(make_duet):
    motion = lifted(make_duet(frames=12), 0.5)
    heights = encode(motion)[..., POSITIONS].reshape(11, 2, 22, 3)[..., 1].min(axis=(0, 2))
    close(heights, (0, 0.5), 1e-2)
    heights = encode(motion, release_compat=True)[..., POSITIONS].reshape(11, 2, 22, 3)[..., 1]
    assert heights.min(axis=(0, 2)).max() < 0.01
    back = decode(encode(motion), motion.fps, placement=pair_placement(motion))
    close(back.keypoints, motion.keypoints[:-1], 1e-9)


def test_labels_of_the_motion_are_kept_and_thresholds_fill_in(make_duet):
    motion = make_duet(frames=10)
    labels = np.random.default_rng(0).random((10, 4)) < 0.5
    labelled = replace(motion, a=replace(motion.a, foot_contacts=labels))
    features = encode(labelled)
    close(features[:, 0, CONTACTS], labels[:-1], 0)
    close(features[:, 1], encode(motion)[:, 1], 0)
    close(
        encode(labelled, release_compat=True)[..., CONTACTS],
        encode(motion, release_compat=True)[..., CONTACTS],
        0,
    )
    assert (decode(features, 30).a.foot_contacts == labels[:-1]).all()


def test_contact_needs_a_low_and_slow_foot_at_any_frame_rate():
    for fps in (15.0, 30.0, 60.0):
        for speed, ankle, toe, expected in (
            (0.90, 0.11, 0.04, (1, 1, 1, 1)),
            (1.00, 0.11, 0.04, (0, 0, 0, 0)),
            (0.90, 0.13, 0.04, (0, 1, 0, 1)),
            (0.90, 0.11, 0.06, (1, 0, 1, 0)),
        ):
            positions = np.zeros((3, 22, 3))
            positions[:, (7, 8), 1] = ankle
            positions[:, (10, 11), 1] = toe
            positions[..., 0] = np.arange(3)[:, None] * speed / fps
            close(foot_contacts(positions, fps), [expected] * 2, 0)


def test_displacements_are_differences_of_positions(make_duet):
    features = encode(make_duet(frames=9))
    close(features[:-1, :, VELOCITIES], np.diff(features[..., POSITIONS], axis=0), 1e-12)


def test_sixd_is_the_first_two_columns_row_by_row():
    matrix = np.arange(9).reshape(3, 3)
    close(to_sixd(matrix), (0, 1, 3, 4, 6, 7), 0)
    close(from_sixd(np.zeros((2, 6))), [np.eye(3)] * 2, 0)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_sixd_restores_any_rotation_and_repairs_any_six_numbers(seed):
    rng = np.random.default_rng(seed)
    matrices = Rotation.random(5, rng=rng).as_matrix()
    close(from_sixd(to_sixd(matrices)), matrices, 1e-12)
    repaired = from_sixd(rng.normal(size=(4, 6)))
    close(repaired @ repaired.swapaxes(-1, -2), [np.eye(3)] * 4, 1e-9)
    close(np.linalg.det(repaired), 1, 1e-9)


@settings(max_examples=50, deadline=None)
@given(st.floats(-np.pi, np.pi), st.floats(-5, 5), st.floats(-5, 5), st.floats(-1, 1))
def test_a_placement_is_undone(yaw, x, z, floor):
    placement = Placement(yaw, (x, floor, z))
    points = np.random.default_rng(0).normal(size=(3, 4, 3))
    close(placement.undo(placement.apply(points)), points, 1e-9)
    close(
        placement.turn(points),
        Rotation.from_quat(placement.quaternion, scalar_first=True)
        .apply(points.reshape(-1, 3))
        .reshape(points.shape),
        1e-9,
    )


def test_facing_is_defined_everywhere():
    pose = np.zeros((3, 22, 3))
    pose[0, 1], pose[0, 2] = (0.1, 0, 0), (-0.1, 0, 0)  # left hip on the left: faces +z
    pose[1, 1], pose[1, 2] = (-0.1, 0, 0), (0.1, 0, 0)  # faces -z, where the release divides by 0
    pose[2, 1] = (0, 0.2, 0)  # hips above each other
    yaw = facing_yaw(pose)
    close(np.abs(yaw), (0, np.pi, 0), 1e-12)


def test_wrong_input_is_named(make_duet):
    poses = poses_of(make_duet(frames=5).a)
    with pytest.raises(MotionError, match="equal numbers"):
        pair_features((poses, poses.cut(0, 4)), 30)
    with pytest.raises(MotionError, match="not finite"):
        Poses(poses.positions * np.nan, poses.rotations)
    with pytest.raises(MotionError, match="492"):
        release_poses(np.zeros((5, 491)))
    with pytest.raises(MotionError, match="262"):
        decode(np.zeros((5, 2, 261)), 30)
    with pytest.raises(MotionError, match="frames"):
        decode(encode(make_duet(frames=2)), 30)
    broken = encode(make_duet(frames=6))
    broken[3, 1, 7] = np.inf
    with pytest.raises(MotionError, match="finite"):
        decode(broken, 30)


def test_generated_features_whose_rotations_are_noise_still_decode(make_duet):
    features = encode(make_duet(frames=8))
    features[..., ROTATIONS] = np.random.default_rng(1).normal(size=(7, 2, 126))
    flat = features.reshape(7, 524)
    back = decode(flat, 30, rotations="features", text="noise", seed=3)
    assert back.text == "noise"
    close(back.a.keypoints, decode(features, 30).a.keypoints, 0)


@pytest.mark.parametrize("name", ["cmu_18_01_handshake_sym", "cmu_002_05_face"])
def test_real_motion_comes_back(duets, name):
    from generator.canonical import from_canonical, to_canonical
    from generator.io import read_motion

    motion = read_motion(duets / "pseudo" / f"{name}.npz")
    placement = pair_placement(motion)
    features = encode(motion)
    back = decode(features, motion.fps, placement=placement)
    close(back.keypoints, motion.keypoints[:-1], 1e-9)
    single = features.astype(np.float32).astype(float)
    close(decode(single, motion.fps, placement=placement).keypoints, motion.keypoints[:-1], 1e-5)
    close(from_canonical(to_canonical(features)), features, 1e-7)
    exact = decode(
        features,
        motion.fps,
        placement=placement,
        skeletons=(motion.a.skeleton, motion.b.skeleton),
        rotations="features",
    )
    for person, original in zip(exact.people, motion.people, strict=True):
        assert person.rotations is not None
        assert original.rotations is not None
        close(np.abs((person.rotations * original.rotations[:-1]).sum(-1)), 1, 1e-6)
