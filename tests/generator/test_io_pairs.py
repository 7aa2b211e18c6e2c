from __future__ import annotations

import pytest

from generator.io.pairs import split_path, with_partner
from robots.errors import MotionFileError


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ("waltz_a.bvh", "waltz_b.bvh"),
        ("waltz-a.bvh", "waltz-b.bvh"),
        ("waltz.a.bvh", "waltz.b.bvh"),
        ("waltz_A.bvh", "waltz_B.bvh"),
        ("a.bvh", "b.bvh"),
        ("waltz_person1.npz", "waltz_person2.npz"),
        ("waltz_p1.npz", "waltz_p2.npz"),
        ("Person1.bvh", "Person2.bvh"),
        ("person1/7.npy", "person2/7.npy"),
        ("18_01.amc", "19_01.amc"),
        ("018_01.bvh", "019_01.bvh"),
        ("22/22_10.amc", "23/23_10.amc"),
    ],
)
def test_either_of_a_pair_finds_the_other_and_a_comes_first(tmp_path, a, b):
    paths = (tmp_path / a, tmp_path / b)
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.touch()
    assert with_partner(paths[0]) == paths
    assert with_partner(paths[1]) == paths


@pytest.mark.parametrize(
    ("one", "two"),
    [("walk_1.bvh", "walk_2.bvh"), ("samba.bvh", "sambb.bvh"), ("24_01.amc", "25_01.amc")],
)
def test_names_that_could_be_two_takes_of_one_person_are_no_pair(tmp_path, one, two):
    (tmp_path / one).touch()
    (tmp_path / two).touch()
    with pytest.raises(MotionFileError, match=f"comma: {one}"):
        with_partner(tmp_path / one)


def test_two_paths_are_given_with_a_comma(tmp_path):
    one, two = tmp_path / "x.bvh", tmp_path / "y.bvh"
    one.touch()
    with pytest.raises(MotionFileError, match=r"y\.bvh: there is no such file"):
        split_path(f"{one},{two}")
    two.touch()
    assert split_path(f"{one},{two}") == (one, two)
    assert split_path(f"{two}, {one}") == (two, one)


def test_a_comma_in_a_name_is_part_of_the_name(tmp_path):
    path = tmp_path / "he, she.npz"
    path.touch()
    assert split_path(path) == (path,)


def test_a_folder_needs_exactly_two_of_one_format(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(MotionFileError, match="0 motion files"):
        split_path(tmp_path)
    (tmp_path / "z.bvh").touch()
    (tmp_path / "c.amc").touch()
    with pytest.raises(MotionFileError, match="2 motion files"):
        split_path(tmp_path)
    (tmp_path / "c.amc").unlink()
    (tmp_path / "B.BVH").touch()
    assert split_path(tmp_path) == (tmp_path / "B.BVH", tmp_path / "z.bvh")
    (tmp_path / "c.bvh").touch()
    with pytest.raises(MotionFileError, match="3 motion files"):
        split_path(tmp_path)


def test_a_name_too_long_for_the_system_is_just_not_there():
    with pytest.raises(MotionFileError, match="no such file"):
        split_path("x" * 5000 + ".bvh")
