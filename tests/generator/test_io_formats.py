"""Array formats: plain keypoints, named joints, InterHuman, SMPL-X; and what a caller must say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from generator.io import read_motion
from generator.io.interhuman import sentence
from generator.kinematics import forward_kinematics
from robots.errors import MotionFileError
from robots.skeleton import human_skeleton

NAMES = np.array(human_skeleton().names)
PARENTS = np.array(human_skeleton().parents)


def y_up(points):
    """z-up to y-up, written out: forward x becomes z, left y becomes x, up z becomes y."""
    return np.stack([points[..., 1], points[..., 2], points[..., 0]], axis=-1)


def fits(motion):
    for person in motion.people:
        assert person.rotations is not None
        fk = forward_kinematics(person.skeleton, person.keypoints[:, 0], person.rotations)
        assert np.linalg.norm(fk - person.keypoints, axis=-1).mean() < 2e-3


def save_named(path, points, **extra):
    entries = {"joint_names": NAMES, "parents": PARENTS, "fps": 30.0, **extra}
    np.savez(path, a=points[:, 0], b=points[:, 1], **entries)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_plain_array_is_read(make_duet, tmp_path, dtype, order):
    points = make_duet().keypoints
    np.save(tmp_path / "x.npy", np.asarray(points, dtype, order=order))
    motion = read_motion(tmp_path / "x.npy", fps=25, up="z")
    np.testing.assert_allclose(motion.keypoints, points, atol=1e-6)
    assert motion.fps == 25
    assert motion.source == "keypoints x.npy"
    fits(motion)


def test_y_up_is_turned_to_z_up(make_duet, tmp_path):
    points = make_duet().keypoints
    np.save(tmp_path / "x.npy", y_up(points))
    motion = read_motion(tmp_path / "x.npy", fps=30, up="y")
    np.testing.assert_allclose(motion.keypoints, points, atol=1e-12)


def test_a_unit_is_applied(make_duet, tmp_path):
    points = make_duet().keypoints
    np.save(tmp_path / "x.npy", points * 100)
    motion = read_motion(tmp_path / "x.npy", fps=30, up="z", scale=0.01)
    np.testing.assert_allclose(motion.keypoints, points, atol=1e-12)
    with pytest.raises(MotionFileError, match=r"m tall.*give --scale 0\.01 \(centimetres"):
        read_motion(tmp_path / "x.npy", fps=30, up="z")


@pytest.mark.parametrize("key", ["joints", "keypoints", "anything"])
def test_a_plain_archive_is_read_under_its_usual_names(make_duet, tmp_path, key):
    points = make_duet().keypoints
    np.savez(tmp_path / "x.npz", **{key: points})
    motion = read_motion(tmp_path / "x.npz", fps=30, up="z")
    np.testing.assert_allclose(motion.keypoints, points)


def test_a_plain_archive_may_state_rate_axis_text_and_licence(make_duet, tmp_path):
    points = make_duet().keypoints
    entries = {"fps": 20, "up": "y", "text": "they bow", "license": "CC0"}
    np.savez(tmp_path / "x.npz", joints=y_up(points), **entries)
    motion = read_motion(tmp_path / "x.npz")
    np.testing.assert_allclose(motion.keypoints, points, atol=1e-12)
    assert (motion.fps, motion.text, motion.licence) == (20, "they bow", "CC0")


@pytest.mark.parametrize(
    ("said", "match"),
    [
        ({"up": "z"}, "does not say the frame rate; give it, for example --fps 30"),
        ({"fps": 30}, "does not say which axis is up; give --up y or --up z"),
        ({"fps": 0, "up": "z"}, "--fps 0"),
        ({"fps": float("nan"), "up": "z"}, "--fps nan"),
        ({"fps": 30, "up": "x"}, "--up x"),
        ({"fps": 30, "up": "z", "scale": -1.0}, "--scale"),
    ],
)
def test_what_the_file_is_silent_about_the_caller_must_say(make_duet, tmp_path, said, match):
    np.save(tmp_path / "x.npy", make_duet().keypoints)
    with pytest.raises(MotionFileError, match=match):
        read_motion(tmp_path / "x.npy", **said)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda x: x.swapaxes(0, 1), "swapaxes"),
        (lambda x: x[:, 0], "one person"),
        (lambda x: x[:, :, :3], r"allowed: \(frames, 2, 22, 3\)"),
        (lambda x: x[:1], "1 frames"),
        (lambda x: np.float64(3.0), "shape"),
        (lambda x: x > 0, "not numbers"),
    ],
)
def test_a_wrong_shape_says_the_right_one(make_duet, tmp_path, change, match):
    np.save(tmp_path / "x.npy", change(make_duet().keypoints))
    with pytest.raises(MotionFileError, match=match):
        read_motion(tmp_path / "x.npy", fps=30, up="z")


def test_nan_and_absurd_numbers_are_reported_with_their_frame(make_duet, tmp_path):
    points = make_duet(frames=30).keypoints.copy()
    points[17, 1, 5, 2] = np.nan
    np.save(tmp_path / "x.npy", points)
    with pytest.raises(MotionFileError, match=r"person b: .*not finite in frame 17"):
        read_motion(tmp_path / "x.npy", fps=30, up="z")
    points[17, 1, 5, 2] = 1e300
    np.save(tmp_path / "x.npy", points)
    with pytest.raises(MotionFileError, match="absurdly large in frame 17"):
        read_motion(tmp_path / "x.npy", fps=30, up="z")


def test_named_joints_are_metres_with_y_up(make_duet, tmp_path):
    points = make_duet().keypoints
    save_named(tmp_path / "x.npz", y_up(points))
    motion = read_motion(tmp_path / "x.npz")
    np.testing.assert_allclose(motion.keypoints, points, atol=1e-12)
    assert motion.fps == 30
    fits(motion)


def test_named_joints_are_matched_by_name_not_by_place(make_duet, tmp_path):
    points = make_duet().keypoints
    order = np.random.default_rng(0).permutation(22)
    save_named(tmp_path / "x.npz", y_up(points)[:, :, order], joint_names=NAMES[order])
    motion = read_motion(tmp_path / "x.npz")
    np.testing.assert_allclose(motion.keypoints, points, atol=1e-12)


def test_named_joints_may_state_their_axis(make_duet, tmp_path):
    points = make_duet().keypoints
    save_named(tmp_path / "x.npz", points, up="z")
    np.testing.assert_allclose(read_motion(tmp_path / "x.npz").keypoints, points, atol=1e-12)
    with pytest.raises(MotionFileError, match="contradicts --up y"):
        read_motion(tmp_path / "x.npz", up="y")


def test_named_joints_may_not_be_given_another_rate(make_duet, tmp_path):
    save_named(tmp_path / "x.npz", y_up(make_duet().keypoints))
    with pytest.raises(MotionFileError, match="contradicts --fps 60"):
        read_motion(tmp_path / "x.npz", fps=60)


@pytest.mark.parametrize(
    ("extra", "match"),
    [
        ({"joint_names": NAMES[:3]}, "one point per name"),
        ({"joint_names": np.arange(22)}, "list of at most"),
        ({"joint_names": np.array(["head"] * 22)}, "two bones are called 'head'"),
        ({"joint_names": np.array([f"b{i}" for i in range(22)])}, "none of the known skeletons"),
        ({"joint_names": np.array([*NAMES[:-1], "tail"])}, "no bone for right_wrist"),
        ({"fps": np.array([30.0, 30.0])}, "one number"),
        ({"fps": np.nan}, "nan frames per second"),
        ({"up": "sideways"}, "up axis"),
        ({"text": 3.0}, "not a text"),
    ],
)
def test_wrong_named_joints_say_why(make_duet, tmp_path, extra, match):
    save_named(tmp_path / "x.npz", y_up(make_duet().keypoints), **extra)
    with pytest.raises(MotionFileError, match=match):
        read_motion(tmp_path / "x.npz")


def test_a_three_keypoint_file_is_refused(tmp_path):
    np.savez(tmp_path / "x.npz", a=np.zeros((5, 3, 3)), b=np.zeros((5, 3, 3)),
             joint_names=np.array(["head", "left_hand", "right_hand"]), fps=30.0)  # fmt: skip
    with pytest.raises(MotionFileError, match="none of the known skeletons"):
        read_motion(tmp_path / "x.npz")


def save_interhuman(folder, points, stem="1000"):
    for person in (0, 1):
        place = folder / "motions_processed" / f"person{person + 1}"
        place.mkdir(parents=True, exist_ok=True)
        rows = np.full((len(points), 492), 7.0, np.float32)
        rows[:, :66] = points[:, person].reshape(len(points), 66)
        np.save(place / f"{stem}.npy", rows)
    return folder / "motions_processed"


@pytest.mark.parametrize("given", ["person1", "person2"])
def test_interhuman_pairs_are_read_from_either_file(make_duet, tmp_path, given):
    points = make_duet().keypoints
    folder = save_interhuman(tmp_path, points)
    (tmp_path / "annots").mkdir()
    (tmp_path / "annots" / "1000.txt").write_text("Two people  wave.\nThey wave.\n")
    motion = read_motion(folder / given / "1000.npy")
    np.testing.assert_allclose(motion.keypoints, points, atol=1e-6)
    assert motion.fps == 30
    assert motion.text == "Two people wave."
    assert "CC BY-NC-SA" in motion.licence
    fits(motion)


def test_interhuman_files_may_lie_anywhere(make_duet, tmp_path):
    """Only the dataset's own layout has sentences; a path may have fewer folders than that."""
    path = save_interhuman(tmp_path, make_duet().keypoints) / "person1" / "1000.npy"
    assert read_motion(path).text == ""
    assert sentence(Path("/1000.npy")) == ""


def test_interhuman_without_the_partner_says_which_file_is_missing(make_duet, tmp_path):
    folder = save_interhuman(tmp_path, make_duet().keypoints)
    (folder / "person2" / "1000.npy").unlink()
    with pytest.raises(MotionFileError, match=r"person2/1000\.npy is not there"):
        read_motion(folder / "person1" / "1000.npy")


def test_interhuman_states_its_rate_and_axis(make_duet, tmp_path):
    path = save_interhuman(tmp_path, make_duet().keypoints) / "person1" / "1000.npy"
    with pytest.raises(MotionFileError, match="contradicts --fps 60"):
        read_motion(path, fps=60)
    with pytest.raises(MotionFileError, match="contradicts --up y"):
        read_motion(path, up="y")


def test_smplx_pairs_are_read(make_duet, tmp_path):
    points = make_duet().keypoints
    for letter, person in (("a", 0), ("b", 1)):
        extra = np.zeros((len(points), 30, 3))  # fingers after the body
        np.savez(
            tmp_path / f"lift_{letter}.npz",
            global_joint_positions=np.concatenate([points[:, person], extra], axis=1),
            height=1.7,
        )
    with pytest.raises(MotionFileError, match="--fps"):
        read_motion(tmp_path / "lift_a.npz")
    motion = read_motion(tmp_path / "lift_b.npz", fps=30)
    np.testing.assert_allclose(motion.keypoints, points)
    fits(motion)


def test_one_surplus_frame_is_cut_and_more_is_an_error(make_duet, tmp_path):
    points = make_duet().keypoints
    for letter, frames in (("a", 12), ("b", 11)):
        np.savez(tmp_path / f"x_{letter}.npz", global_joint_positions=points[:frames, 0])
    assert read_motion(tmp_path / "x_a.npz", fps=30).frames == 11
    np.savez(tmp_path / "x_b.npz", global_joint_positions=points[:10, 1])
    with pytest.raises(MotionFileError, match="person a has 12 frames, person b 10"):
        read_motion(tmp_path / "x_a.npz", fps=30)


@pytest.mark.parametrize("suffix", ["pkl", "pickle", "pt", "pth"])
def test_pickles_are_refused_unopened(tmp_path, suffix):
    path = tmp_path / f"x.{suffix}"
    path.write_bytes(b"cos\nsystem\n(S'touch pwned'\ntR.")
    with pytest.raises(MotionFileError, match="never opened, because they can run code"):
        read_motion(path)


def test_a_pickle_under_another_name_is_refused(tmp_path):
    for name in ("x.npz", "x.npy"):
        np.save(tmp_path / "o.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
        data = (tmp_path / "o.npy").read_bytes() if name == "x.npy" else b"\x80\x04}."
        (tmp_path / name).write_bytes(data)
        with pytest.raises(MotionFileError, match="pickle"):
            read_motion(tmp_path / name, fps=30, up="z")


def test_unknown_and_missing_files_say_so(tmp_path):
    (tmp_path / "x.fbx").write_bytes(b"x")
    with pytest.raises(MotionFileError, match=r"\.fbx.*allowed.*export it as BVH"):
        read_motion(tmp_path / "x.fbx")
    (tmp_path / "x.npz").write_bytes(b"")
    with pytest.raises(MotionFileError, match="empty"):
        read_motion(tmp_path / "x.npz")
    with pytest.raises(MotionFileError, match="no such file"):
        read_motion(tmp_path / "nothing.npz")
    with pytest.raises(MotionFileError, match="no file name"):
        read_motion("")
    with pytest.raises(MotionFileError, match="no file name"):
        read_motion("a\0b.npz")


def test_two_paths_for_a_format_with_both_people_are_refused(make_duet, tmp_path):
    for name in ("x.npy", "y.npy"):
        np.save(tmp_path / name, make_duet().keypoints)
    with pytest.raises(MotionFileError, match="both people in one file"):
        read_motion(f"{tmp_path}/x.npy,{tmp_path}/y.npy", fps=30, up="z")
