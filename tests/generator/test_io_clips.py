"""The readers on real motion capture, with figures that a wrong bone map would miss."""

from __future__ import annotations

import numpy as np
import pytest

from generator.io import read_motion, write_motion
from generator.io.plausible import stature
from generator.kinematics import forward_kinematics, unit
from robots.errors import MotionFileError

CLIPS = (
    "cmu_002_05_face",
    "cmu_002_07_face",
    "cmu_002_08_face",
    "cmu_005_02_mirror",
    "cmu_007_01_side",
    "cmu_18_01_handshake_sym",
)


@pytest.fixture(scope="module")
def clip(duets):
    motions = {}

    def read(name):
        if name not in motions:
            motions[name] = read_motion(duets / "pseudo" / f"{name}.npz")
        return motions[name]

    return read


@pytest.mark.parametrize("name", CLIPS)
def test_clips_show_two_people_of_plausible_build(clip, name):
    for person in clip(name).people:
        assert 1.45 < stature(person.keypoints) < 1.95
        bones = person.keypoints[:, 1:] - person.keypoints[:, list(person.skeleton.parents[1:])]
        lengths = np.linalg.norm(bones, axis=-1)
        # CC's neck bends between two bones that are one here; all else is rigid.
        assert lengths.std(axis=0).max() < 3e-3
        assert np.sort(lengths.std(axis=0))[-3] < 1e-6
        assert lengths.min() > 0.02
        names = person.skeleton.names[1:]
        for limb, low, high in (("knee", 0.38, 0.50), ("ankle", 0.38, 0.52), ("elbow", 0.23, 0.32),
                                ("wrist", 0.18, 0.30), ("foot", 0.09, 0.18)):  # fmt: skip
            left, right = (lengths[0, names.index(f"{side}_{limb}")] for side in ("left", "right"))
            assert low < left < high
            assert abs(left / right - 1) < (0.11 if limb == "foot" else 0.06)
        assert -0.02 < person.keypoints[..., 2].min() < 0.1


@pytest.mark.parametrize("name", CLIPS)
def test_left_is_left(clip, name):
    """Feet and knees of a body whose sides or axes were swapped would point backwards."""
    for person in clip(name).people:
        across = person.point("left_hip") - person.point("right_hip")
        forward = unit(np.cross(across, person.point("spine1") - person.point("pelvis")))
        shoulders = person.point("left_shoulder") - person.point("right_shoulder")
        assert (np.einsum("ti,ti->t", shoulders, across) > 0).mean() > 0.9
        feet, knees = np.zeros_like(forward), np.zeros_like(forward)
        for side in ("left", "right"):
            hip, knee, ankle, toe = (
                person.point(f"{side}_{point}") for point in ("hip", "knee", "ankle", "foot")
            )
            feet += unit(toe - ankle)
            knees += knee - (hip + ankle) / 2
        assert np.median(np.einsum("ti,ti->t", feet, forward)) > 0.7
        assert (np.einsum("ti,ti->t", feet, forward) > 0).mean() > 0.9
        assert np.median(np.einsum("ti,ti->t", knees, forward)) > 0.01


@pytest.mark.parametrize("name", CLIPS)
def test_rotations_reproduce_the_keypoints(clip, name):
    for person in clip(name).people:
        found = forward_kinematics(person.skeleton, person.keypoints[:, 0], person.rotations)
        error = np.linalg.norm(found - person.keypoints, axis=-1)
        assert error.mean() < 5e-3
        assert error.max() < 2e-2


def test_the_handshake_brings_the_right_hands_together(clip):
    motion = clip("cmu_18_01_handshake_sym")
    right = np.linalg.norm(motion.a.point("right_hand") - motion.b.point("right_hand"), axis=1)
    left = np.linalg.norm(motion.a.point("left_hand") - motion.b.point("left_hand"), axis=1)
    assert right.min() < 0.05
    assert left.min() > 0.3
    assert (motion.fps, motion.frames) == (30, 76)


def test_a_clip_comes_back_exactly_through_the_own_format(clip, tmp_path):
    motion = clip("cmu_18_01_handshake_sym")
    write_motion(motion, tmp_path / "m.npz")
    back = read_motion(tmp_path / "m.npz")
    np.testing.assert_array_equal(back.keypoints, motion.keypoints)
    np.testing.assert_array_equal(back.a.rotations, motion.a.rotations)


@pytest.mark.parametrize(
    ("bvh", "clip_name", "scale", "step"),
    [
        ("002_05", "cmu_002_05_face", 0.01, 2),
        ("007_01", "cmu_007_01_side", 0.01, 2),
        ("18_01", "cmu_18_01_handshake_sym", 0.056444, 4),
    ],
)
def test_bvh_agrees_with_an_independent_conversion(clip, duets, bvh, clip_name, scale, step):
    """The clips were made from these files by other code: equal but for place and heading."""
    path = duets / "single_cmu" / f"{bvh}.bvh"
    points = read_motion(f"{path},{path}", scale=scale).a.keypoints[::step]
    expected = clip(clip_name).a.keypoints
    assert len(points) == len(expected)
    points, expected = (x - x.mean(axis=(0, 1)) for x in (points, expected))
    u, _, vt = np.linalg.svd(np.einsum("tji,tjk->ik", points[..., :2], expected[..., :2]))
    turn = np.eye(3)
    turn[:2, :2] = u @ vt
    assert np.linalg.det(turn) > 0
    assert np.abs(points @ turn - expected).max() < 1e-5


@pytest.mark.parametrize("trial", ["02_01", "02_03"])
def test_acclaim_files_show_one_walking_or_running_person(duets, trial):
    path = duets / "asf_amc" / f"{trial}.amc"
    motion = read_motion(f"{path},{path}")
    person = motion.a
    assert motion.fps == 120
    assert 1.5 < stature(person.keypoints) < 1.9
    bones = person.skeleton.bone_lengths
    for name, length in (("left_knee", 0.429), ("left_ankle", 0.411), ("left_elbow", 0.275),
                         ("left_wrist", 0.284), ("right_wrist", 0.285)):  # fmt: skip
        assert bones[person.skeleton.index(name)] == pytest.approx(length, abs=2e-3)
    feet = person.keypoints[:, [10, 11], 2].min(axis=1)
    assert -0.05 < feet.min() < 0.06
    speed = np.linalg.norm(np.diff(person.keypoints[:, 0, :2], axis=0), axis=1) * motion.fps
    assert 0.8 < np.median(speed) < 4.5
    # People walk and run forwards.
    across = person.point("left_hip") - person.point("right_hip")
    forward = np.cross(across, [0, 0, 1.0])
    travel = person.keypoints[-1, 0] - person.keypoints[0, 0]
    assert (forward[:, :2] @ travel[:2] > 0).mean() > 0.95
    for side in ("left", "right"):
        arm = person.point(f"{side}_wrist") - person.point(f"{side}_shoulder")
        assert np.median(arm[:, 2]) < -0.1


def test_a_real_bvh_alone_says_how_to_give_the_pair(duets):
    with pytest.raises(MotionFileError, match=r"comma: 002_05\.bvh,OTHER\.bvh"):
        read_motion(duets / "single_cmu" / "002_05.bvh")
