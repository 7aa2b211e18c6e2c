from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.io import read_motion, write_bvh
from generator.io.bvh import read_bvh
from generator.io.bvh_pose import BvhJoint, joint_positions
from generator.kinematics import continuous, forward_kinematics, to_wxyz
from generator.motion import DuetMotion, Motion
from robots.errors import MotionFileError
from robots.skeleton import human_skeleton


def test_a_rigid_motion_comes_back_from_bvh(make_duet, tmp_path):
    motion = make_duet(frames=40)
    paths = write_bvh(motion, tmp_path / "waltz")
    assert [p.name for p in paths] == ["waltz_a.bvh", "waltz_b.bvh"]
    back = read_motion(paths[0], scale=0.01)
    assert np.abs(back.keypoints - motion.keypoints).max() < 1e-4
    assert back.fps == motion.fps
    assert back.source == "BVH waltz_a.bvh, waltz_b.bvh"


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), fps=st.sampled_from([24.0, 29.97, 30.0, 60.0, 120.0, 23.5]))
def test_any_pose_comes_back_from_bvh(make_duet, tmp_path_factory, seed, fps):
    """Also upside down and at the singular pose of the angles, where one angle is free."""
    rng = np.random.default_rng(seed)
    skeleton = human_skeleton()
    turns = Rotation.random(6 * 22, rng=rng)
    quaternions = to_wxyz(turns).reshape(6, 22, 4)
    quaternions[0, :] = to_wxyz(Rotation.from_euler("ZXY", [30, 90, 10], degrees=True))
    quaternions[1, :] = to_wxyz(Rotation.from_euler("ZXY", [0, -90, 0], degrees=True))
    quaternions[2:, :3] = to_wxyz(Rotation.identity())
    root = rng.normal(size=(6, 3)) * 0.1 + [0, 0, 0.9]
    points = forward_kinematics(skeleton, root, continuous(quaternions))
    person = Motion(fps, points, continuous(quaternions), None, skeleton)
    path, _ = write_bvh(DuetMotion(person, person), tmp_path_factory.mktemp("bvh"))
    bvh = read_bvh(path)
    names = [joint.name for joint in bvh.joints]
    found = joint_positions(bvh.joints, bvh.values, [names.index(n) for n in skeleton], False)
    assert np.abs(found[..., (2, 0, 1)] * 0.01 - points).max() < 1e-4
    assert abs(bvh.frame_time * fps - 1) < 1e-6


def test_a_folder_takes_a_and_b(make_duet, tmp_path):
    paths = write_bvh(make_duet(), tmp_path)
    assert paths == (tmp_path / "a.bvh", tmp_path / "b.bvh")
    assert read_motion(tmp_path, scale=0.01).frames == 12
    assert read_motion(paths[1], scale=0.01).frames == 12


def test_rotations_are_fitted_where_the_motion_has_none(make_duet, tmp_path):
    motion = make_duet()
    a, b = (Motion(p.fps, p.keypoints) for p in motion.people)
    write_bvh(DuetMotion(a, b), tmp_path)
    back = read_motion(tmp_path, scale=0.01)
    assert np.linalg.norm(back.keypoints - motion.keypoints, axis=-1).mean() < 2e-3


def test_angles_do_not_jump(make_duet, tmp_path):
    skeleton = human_skeleton()
    frames = 100
    spin = Rotation.from_euler("z", np.linspace(0, 6 * np.pi, frames)[:, None])
    quaternions = np.tile([1.0, 0, 0, 0], (frames, 22, 1))
    quaternions[:, 0] = to_wxyz(spin)
    points = forward_kinematics(skeleton, np.tile([0, 0, 0.9], (frames, 1)), quaternions)
    person = Motion(30, points, continuous(quaternions), None, skeleton)
    path, _ = write_bvh(DuetMotion(person, person), tmp_path)
    assert np.abs(np.diff(read_bvh(path).values, axis=0)).max() < 30


def test_nothing_is_left_behind_when_the_place_cannot_be_written(make_duet, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(MotionFileError, match="cannot be written"):
        write_bvh(make_duet(), tmp_path / "file" / "waltz")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_the_unit_must_be_said_and_the_likely_one_is_named(make_duet, tmp_path):
    write_bvh(make_duet(), tmp_path)
    with pytest.raises(MotionFileError, match=r"unit of length; give --scale 0\.01 \(centimetres"):
        read_motion(tmp_path)


def test_the_caller_overrules_a_wrong_frame_time(make_duet, tmp_path):
    for path in write_bvh(make_duet(), tmp_path):
        text = path.read_text().replace("Frame Time: 0.0333333333", "Frame Time: 0")
        path.write_text(text)
    with pytest.raises(MotionFileError, match=r"inf frames per second.*true rate with --fps"):
        read_motion(tmp_path, scale=0.01)
    assert read_motion(tmp_path, scale=0.01, fps=120).fps == 120


def test_two_files_of_different_rates_do_not_fit(make_duet, tmp_path):
    write_bvh(make_duet(fps=30), tmp_path / "x")
    write_bvh(make_duet(fps=60), tmp_path / "y")
    both = f"{tmp_path}/x_a.bvh,{tmp_path}/y_b.bvh"
    with pytest.raises(MotionFileError, match="frame times differ"):
        read_motion(both, scale=0.01)
    assert read_motion(both, scale=0.01, fps=30).fps == 30


@pytest.mark.parametrize(
    ("time", "fps"),
    [("0.033333", 30), ("0.0333333", 30), ("0.016667", 60), ("0.008333", 120), ("0.04", 25),
     ("0.033367", 30 / 1.001), ("0.0125", 80)],
)  # fmt: skip
def test_short_frame_times_stand_for_whole_rates(make_duet, tmp_path, time, fps):
    for path in write_bvh(make_duet(), tmp_path):
        path.write_text(path.read_text().replace("0.0333333333", time))
    assert read_motion(tmp_path, scale=0.01).fps == pytest.approx(fps, rel=1e-9)


def test_a_single_file_says_how_to_give_the_pair(make_duet, tmp_path):
    path, _ = write_bvh(make_duet(), tmp_path)
    path = path.rename(tmp_path / "solo.bvh")
    with pytest.raises(MotionFileError, match=r"one person.*comma: solo\.bvh,OTHER\.bvh"):
        read_motion(path, scale=0.01)


ROTATION_ORDERS = ["ZXY", "ZYX", "XYZ", "YXZ"]


@pytest.mark.parametrize("order", ROTATION_ORDERS)
def test_channels_turn_about_moving_axes_in_their_order(order):
    channels = tuple((axis.lower(), False) for axis in order)
    joints = (
        BvhJoint("hips", -1, np.zeros(3), (("x", True), ("y", True), ("z", True), *channels)),
        BvhJoint("knee", 0, np.array([0.0, 2.0, 0.0]), channels),
        BvhJoint("foot", 1, np.array([1.0, 0.0, 3.0]), ()),
    )
    values = np.array([[5, 6, 7, 10, 20, 30, 40, 50, 60.0]])
    turns = {
        axis: Rotation.from_rotvec(np.radians(1) * np.eye(3)["XYZ".index(axis)]) for axis in "XYZ"
    }
    root = turns[order[0]] ** 10 * turns[order[1]] ** 20 * turns[order[2]] ** 30
    knee = turns[order[0]] ** 40 * turns[order[1]] ** 50 * turns[order[2]] ** 60
    at_knee = np.array([5, 6, 7]) + root.apply([0, 2, 0])
    at_foot = at_knee + (root * knee).apply([1, 0, 3])
    found = joint_positions(joints, values, [0, 1, 2], False)[0]
    np.testing.assert_allclose(found, [[5, 6, 7], at_knee, at_foot], atol=1e-12)


def test_position_channels_stand_for_the_offset_or_add_to_it_at_the_root():
    places = (("x", True), ("y", True), ("z", True))
    joints = (
        BvhJoint("hips", -1, np.array([0, 100.0, 0]), places),
        BvhJoint("spine", 0, np.array([0, 10.0, 1.0]), (("y", True),)),
    )
    values = np.array([[1, 2, 3, 11.0]])
    instead = joint_positions(joints, values, [0, 1], False)[0]
    added = joint_positions(joints, values, [0, 1], True)[0]
    np.testing.assert_allclose(instead, [[1, 2, 3], [1, 13, 4]])
    np.testing.assert_allclose(added, [[1, 102, 3], [1, 113, 4]])


def test_long_motions_are_computed_in_chunks_without_seams():
    joints = (BvhJoint("hips", -1, np.zeros(3), (("x", True),)),)
    values = np.arange(5000.0)[:, None]
    found = joint_positions(joints, values, [0], False)
    np.testing.assert_array_equal(found[:, 0, 0], values[:, 0])


TINY = """HIERARCHY
ROOT hips {
  OFFSET 0 0 0
  CHANNELS 3 Xposition Yposition Zposition
  JOINT my knee
  {
    OFFSET 0 1 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 1 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.1
1 2 3 4 5 6
1 2 3 4 5 7
"""


def test_the_grammar_accepts_braces_on_the_line_and_names_with_spaces(tmp_path):
    (tmp_path / "x.bvh").write_bytes(b"\xef\xbb\xbf" + TINY.replace("\n", "\r\n\r\n").encode())
    bvh = read_bvh(tmp_path / "x.bvh")
    assert [joint.name for joint in bvh.joints] == ["hips", "my knee"]
    assert bvh.values.shape == (2, 6)
    assert bvh.frame_time == 0.1


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("HIERARCHY", "MOTION", "starts with HIERARCHY"),
        ("Frames: 2", "Frames: 1000000000", "claims 1000000000 frames.*at most 100000"),
        ("Frames: 2", "Frames: -2", "frames is '-2'"),
        ("Frames: 2", "Frames: 3", "2 of 3 frames.*cut off"),
        ("Frames: 2", "Frames: 1", "more than the 1 frames"),
        ("Frames: 2\n", "", "expected 'Frames: N'"),
        ("Frame Time: 0.1\n", "", "expected 'Frame Time"),
        ("Frame Time: 0.1", "Frame Time: soon", "expected numbers"),
        ("1 2 3 4 5 7", "1 2 3 4 5", r"frame 1 has 5 numbers \(allowed: 6\)"),
        ("1 2 3 4 5 7", "1 2 3 4 5 nan", "line 19: a number is not finite"),
        ("1 2 3 4 5 7", "1 2 3 4 5 x7", "line 19: expected numbers"),
        ("OFFSET 0 1 0\n    CH", "CH", "joint 'my knee' has no OFFSET"),
        ("OFFSET 0 1 0\n    CH", "OFFSET 0 1\n    CH", "not expected"),
        ("3 Zrotation", "4 Zrotation", "channels"),
        ("3 Zrotation", "3 Wrotation", "channels"),
        ("3 Zrotation", "3 Xrotation", "channels"),
        ("3 Zrotation", "1000000000 Zrotation", "claims"),
        ("ROOT hips", "JOINT hips", "JOINT is not expected"),
        ("JOINT my knee", "ROOT my knee", "ROOT is not expected"),
        ("JOINT my knee", "JOINT", "needs a name"),
        ("End Site", "Beginning", "'Beginning' is not expected"),
        ("}\nMOTION", "MOTION", "not closed before MOTION"),
        ("}\nMOTION", "}\n}\nMOTION", "not expected"),
        ("}\nMOTION", "}\nROOT other\n{\nOFFSET 0 0 0\n}\nMOTION", "two skeletons"),
        ("MOTION\nFrames", "Frames", "not expected"),
    ],
)
def test_a_damaged_file_says_where(tmp_path, old, new, match):
    assert old in TINY
    (tmp_path / "x.bvh").write_text(TINY.replace(old, new, 1))
    with pytest.raises(MotionFileError, match=match):
        read_bvh(tmp_path / "x.bvh")


def test_a_file_that_ends_early_is_refused_at_every_line(tmp_path):
    lines = TINY.splitlines(keepends=True)
    for end in range(len(lines)):
        (tmp_path / "x.bvh").write_text("".join(lines[:end]))
        with pytest.raises(MotionFileError):
            read_bvh(tmp_path / "x.bvh")
