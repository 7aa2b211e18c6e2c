from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.io import MOTION_SCHEMA, read_motion, write_motion
from generator.motion import Contact, DuetMotion, Motion
from robots.errors import MotionFileError
from robots.files import read_archive, write_archive


def same(one: Motion, two: Motion) -> None:
    np.testing.assert_array_equal(one.keypoints, two.keypoints)
    np.testing.assert_array_equal(one.skeleton.offsets, two.skeleton.offsets)
    assert one.skeleton.names == two.skeleton.names
    assert one.skeleton.parents == two.skeleton.parents
    assert one.skeleton.hand_per_forearm == two.skeleton.hand_per_forearm
    assert one.fps == two.fps
    for field in ("rotations", "foot_contacts"):
        left, right = getattr(one, field), getattr(two, field)
        assert (left is None) == (right is None)
        if left is not None:
            np.testing.assert_array_equal(left, right)


def test_a_motion_comes_back_exactly(make_duet, tmp_path):
    motion = make_duet()
    contacts = np.random.default_rng(1).random((motion.frames, 4)) < 0.5
    a = Motion(motion.fps, motion.a.keypoints, motion.a.rotations, contacts, motion.a.skeleton)
    motion = DuetMotion(
        a,
        motion.b,
        text=motion.text,
        seed=2**70,
        source=motion.source,
        licence=motion.licence,
        contacts=motion.contacts,
        interaction=motion.interaction,
        kind="simulated",
    )
    write_motion(motion, tmp_path / "m.npz")
    back = read_motion(tmp_path / "m.npz")
    same(motion.a, back.a)
    same(motion.b, back.b)
    for field in ("text", "seed", "source", "licence", "contacts", "interaction", "kind"):
        assert getattr(back, field) == getattr(motion, field)


@settings(max_examples=25, deadline=None)
@given(
    text=st.text(st.characters(exclude_categories=["Cs"]), max_size=40),
    seed=st.none() | st.integers(),
    gap=st.floats(0, 1),
    start=st.floats(0, 100),
    fps=st.floats(1, 1000),
)
def test_any_header_comes_back_exactly(make_duet, tmp_path_factory, text, seed, gap, start, fps):
    one = make_duet(frames=2)
    a, b = (Motion(fps, p.keypoints, p.rotations, None, p.skeleton) for p in one.people)
    contact = Contact("head", "left_hand", start, start + 1, gap)
    motion = DuetMotion(a, b, text=text, seed=seed, licence=text, contacts=(contact,))
    path = tmp_path_factory.mktemp("archive") / "m.npz"
    write_motion(motion, path)
    back = read_motion(path)
    assert (back.text, back.seed, back.licence, back.fps) == (text, seed, text, fps)
    assert back.contacts == (contact,)


def test_equal_motions_give_equal_bytes(make_duet, tmp_path):
    write_motion(make_duet(), tmp_path / "one.npz")
    write_motion(make_duet(), tmp_path / "two.npz")
    write_motion(make_duet(seed=1), tmp_path / "three.npz")
    one, two, three = ((tmp_path / f"{n}.npz").read_bytes() for n in ("one", "two", "three"))
    assert one == two
    assert one != three


def test_rotations_are_fitted_where_the_file_has_none(make_duet, tmp_path):
    motion = make_duet()
    a, b = (Motion(p.fps, p.keypoints, None, None, p.skeleton) for p in motion.people)
    write_motion(DuetMotion(a, b), tmp_path / "m.npz")
    back = read_motion(tmp_path / "m.npz")
    assert back.a.rotations is not None
    assert back.b.rotations is not None
    np.testing.assert_array_equal(back.a.keypoints, a.keypoints)


def test_the_name_must_end_in_npz(make_duet, tmp_path):
    with pytest.raises(MotionFileError, match=r"\.npz"):
        write_motion(make_duet(), tmp_path / "m.bvh")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("said", "flag"), [({"fps": 60}, "--fps"), ({"up": "y"}, "--up"), ({"scale": 0.01}, "--scale")]
)
def test_the_caller_may_not_contradict_what_the_file_states(make_duet, tmp_path, said, flag):
    write_motion(make_duet(), tmp_path / "m.npz")
    with pytest.raises(MotionFileError, match=f"contradicts.*leave out {flag}"):
        read_motion(tmp_path / "m.npz", **said)


def test_the_caller_may_say_what_the_file_states(make_duet, tmp_path):
    write_motion(make_duet(), tmp_path / "m.npz")
    assert read_motion(tmp_path / "m.npz", fps=30, up="z", scale=1).frames == 12


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("up", "y"),
        ("unit", "cm"),
        ("quaternions", "xyzw"),
        ("fps", "30"),
        ("fps", True),
        ("fps", 0.5),
        ("fps", 10**400),
        ("text", 3),
        ("text", "\ud800"),
        ("seed", 1.5),
        ("seed", True),
        ("kind", "dreamt"),
        ("kind", ["reference"]),
        ("names", ["pelvis"]),
        ("names", "pelvis"),
        ("parents", [0] * 22),
        ("parents", [[]] * 22),
        ("hand_per_forearm", 0.3),
        ("hand_per_forearm", [0.3, 7]),
        ("hand_per_forearm", ["0", "0"]),
        ("contacts", {}),
        ("contacts", [3]),
        ("contacts", [{"a": "nose", "b": "head", "start": 0, "end": 1, "gap": 0}]),
        ("contacts", [{"a": [], "b": "head", "start": 0, "end": 1, "gap": 0}]),
        ("contacts", [{"a": "head", "b": "head", "start": 2, "end": 1, "gap": 0}]),
        ("contacts", [{"a": "head", "b": "head", "start": "2", "end": 1, "gap": 0}]),
    ],
)
def test_a_wrong_header_entry_is_named(make_duet, tmp_path, key, value):
    write_motion(make_duet(), tmp_path / "m.npz")
    header, arrays = read_archive(tmp_path / "m.npz")
    assert header is not None
    write_archive(tmp_path / "bad.npz", {**header, key: value}, arrays)
    with pytest.raises(MotionFileError):
        read_motion(tmp_path / "bad.npz")
    del header[key]
    write_archive(tmp_path / "bad.npz", header, arrays)
    with pytest.raises(MotionFileError, match=f"'{key}'.*missing"):
        read_motion(tmp_path / "bad.npz")


@pytest.mark.parametrize("key", ["keypoints_a", "offsets_b"])
def test_a_missing_array_is_named(make_duet, tmp_path, key):
    write_motion(make_duet(), tmp_path / "m.npz")
    header, arrays = read_archive(tmp_path / "m.npz")
    assert header is not None
    del arrays[key]
    write_archive(tmp_path / "bad.npz", header, arrays)
    with pytest.raises(MotionFileError, match=key):
        read_motion(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    ("key", "change", "match"),
    [
        ("keypoints_a", lambda x: x[:, :3], "shape"),
        ("keypoints_b", lambda x: x[:-1], "shape"),
        ("keypoints_a", lambda x: x.astype("U8"), "not numbers"),
        ("rotations_a", lambda x: x * 2, "unit quaternions"),
        ("offsets_a", lambda x: x[:3], "offsets"),
    ],
)
def test_a_wrong_array_is_refused(make_duet, tmp_path, key, change, match):
    write_motion(make_duet(), tmp_path / "m.npz")
    header, arrays = read_archive(tmp_path / "m.npz")
    assert header is not None
    write_archive(tmp_path / "bad.npz", header, {**arrays, key: change(arrays[key])})
    with pytest.raises(MotionFileError, match=match):
        read_motion(tmp_path / "bad.npz")


def test_nan_is_reported_with_its_frame(make_duet, tmp_path):
    motion = make_duet(frames=30)
    write_motion(motion, tmp_path / "m.npz")
    header, arrays = read_archive(tmp_path / "m.npz")
    assert header is not None
    arrays["keypoints_b"][17, 3, 1] = np.nan
    write_archive(tmp_path / "bad.npz", header, arrays)
    with pytest.raises(MotionFileError, match="frame 17"):
        read_motion(tmp_path / "bad.npz")


def test_another_kind_of_archive_says_what_it_is(tmp_path):
    write_archive(tmp_path / "t.npz", {"schema": "pasdedeux.trajectory/1"}, {"x": np.zeros(2)})
    with pytest.raises(MotionFileError, match=r"pasdedeux\.trajectory/1.*pasdedeux\.motion/1"):
        read_motion(tmp_path / "t.npz")


def test_the_header_states_everything(make_duet, tmp_path):
    write_motion(make_duet(), tmp_path / "m.npz")
    with zipfile.ZipFile(tmp_path / "m.npz") as archive:
        header = json.loads(archive.read("header.json"))
    assert header["schema"] == MOTION_SCHEMA
    assert (header["up"], header["unit"], header["fps"]) == ("z", "m", 30.0)
    assert header["licence"] == "CC0"
    assert len(header["names"]) == len(header["parents"]) == 22
