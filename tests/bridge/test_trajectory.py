from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.trajectory import SCHEMA, JointTrajectory
from robots.errors import LimitViolation, MotionFileError
from robots.files import read_archive, write_archive

TIMES = np.array([0.0, 0.5, 2.0])
POSITION = np.array([[0.0, 1.0], [1.0, 1.0], [4.0, -2.0]])


def trajectory(**change):
    values = {"times": TIMES, "position": POSITION, "joint_names": ("x", "y"), "robot": "r"}
    return JointTrajectory(**{**values, **change})


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"times": TIMES[:1], "position": POSITION[:1]}, "two moments"),
        ({"times": TIMES[:, None]}, "two moments"),
        ({"times": TIMES + 1}, "start at 0"),
        ({"times": TIMES[[0, 2, 1]]}, "strictly increase"),
        ({"times": np.array([0.0, 0.5, 0.5])}, "strictly increase"),
        ({"times": np.array([0.0, 0.5, np.nan])}, "strictly increase"),
        ({"position": POSITION[:2]}, "shape"),
        ({"position": POSITION[:, :1]}, "shape"),
        ({"joint_names": ("x", "x")}, "same joint name"),
        ({"position": POSITION * [[1, 1], [1, np.nan], [1, 1]]}, r"y: .*not finite at 0\.500 s"),
    ],
)
def test_a_broken_trajectory_is_refused(change, match):
    with pytest.raises(LimitViolation, match=match):
        trajectory(**change)


def test_a_trajectory_is_frozen_and_shares_no_memory():
    position = POSITION.copy()
    one = trajectory(position=position)
    position[:] = 9
    np.testing.assert_array_equal(one.position, POSITION)
    with pytest.raises(ValueError):
        one.times[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.robot = "s"  # pyright: ignore[reportAttributeAccessIssue]


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    names=st.lists(st.text("abc_é", min_size=1, max_size=5), min_size=1, max_size=4, unique=True),
    text=st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
)
def test_a_trajectory_comes_back_exactly(tmp_path_factory, seed, names, text):
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 1, 4))])
    one = JointTrajectory(
        times, rng.normal(size=(5, len(names))), tuple(names), text, {"text": text, "slowed_by": 1}
    )
    path = tmp_path_factory.mktemp("trajectory") / "t.npz"
    one.save(path)
    back = JointTrajectory.load(path)
    np.testing.assert_array_equal(back.times, one.times)
    np.testing.assert_array_equal(back.position, one.position)
    assert (back.joint_names, back.robot) == (one.joint_names, one.robot)
    assert back.metadata == one.metadata


def test_equal_trajectories_give_equal_bytes(tmp_path):
    trajectory().save(tmp_path / "one.npz")
    trajectory().save(tmp_path / "two.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


@pytest.mark.parametrize(
    ("header", "arrays"),
    [
        ({"schema": "pasdedeux.motion/1"}, {}),
        ({"joint_names": 3}, {}),
        ({"joint_names": ["x"]}, {}),
        ({"metadata": 3}, {}),
        ({"metadata": ["abc"]}, {}),
        ({}, {"times": TIMES[::-1]}),
        ({}, {"times": np.array(["a", "b", "c"])}),
        ({}, {"times": np.array([False, True, True])}),
        ({}, {"position": np.array([["a", "b"]] * 3)}),
        ({}, {"position": np.array(3.0)}),
    ],
)
def test_a_wrong_file_gives_a_motion_file_error(tmp_path, header, arrays):
    trajectory().save(tmp_path / "t.npz")
    good_header, good_arrays = read_archive(tmp_path / "t.npz")
    assert good_header is not None
    assert good_header["schema"] == SCHEMA
    write_archive(tmp_path / "bad.npz", {**good_header, **header}, {**good_arrays, **arrays})
    with pytest.raises(MotionFileError):
        JointTrajectory.load(tmp_path / "bad.npz")


@pytest.mark.parametrize("key", ["joint_names", "robot", "metadata", "times", "position"])
def test_a_missing_entry_gives_a_motion_file_error(tmp_path, key):
    trajectory().save(tmp_path / "t.npz")
    header, arrays = read_archive(tmp_path / "t.npz")
    assert header is not None
    header.pop(key, None)
    arrays.pop(key, None)
    write_archive(tmp_path / "bad.npz", header, arrays)
    with pytest.raises(MotionFileError, match=key):
        JointTrajectory.load(tmp_path / "bad.npz")


def test_a_foreign_archive_is_no_trajectory(tmp_path):
    np.savez(tmp_path / "x.npz", times=TIMES)
    with pytest.raises(MotionFileError, match=r"not a joint trajectory.*retarget"):
        JointTrajectory.load(tmp_path / "x.npz")


@settings(max_examples=60, deadline=None)
@given(at=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255), cut=st.booleans())
def test_a_damaged_file_gives_itself_or_a_motion_file_error(tmp_path_factory, at, flip, cut):
    path = tmp_path_factory.mktemp("damage") / "t.npz"
    trajectory().save(path)
    data = bytearray(path.read_bytes())
    place = int(at * len(data))
    data[place] ^= flip
    path.write_bytes(data[:place] if cut else data)
    try:
        JointTrajectory.load(path)
    except MotionFileError:
        return
    assert not cut
