from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from robots.errors import SpecError
from robots.skeleton import Skeleton, human_skeleton, read_only


def test_the_human_has_the_22_smpl_body_keypoints_in_their_order():
    assert human_skeleton().names == (
        "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
        "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
        "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
        "left_wrist", "right_wrist",
    )  # fmt: skip
    assert human_skeleton().parents == (
        -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19
    )  # fmt: skip


def test_the_human_is_left_right_symmetric_and_faces_x():
    skeleton = human_skeleton()
    for name in skeleton:
        if name.startswith("left_"):
            left = skeleton.offsets[skeleton.index(name)]
            right = skeleton.offsets[skeleton.index("right_" + name.removeprefix("left_"))]
            np.testing.assert_allclose(left * (1, -1, 1), right)
    assert skeleton.offsets[skeleton.index("left_elbow")][1] > 0.2
    assert skeleton.offsets[skeleton.index("left_foot")][0] > 0.1
    assert skeleton.offsets[skeleton.index("left_knee")][2] < -0.3


def test_the_human_has_the_limbs_of_a_person_of_1_70_m():
    """Segment lengths of de Leva (1996), as shares of stature."""
    skeleton = human_skeleton()
    for name, share in (("elbow", 0.1618), ("wrist", 0.1545), ("knee", 0.2425), ("ankle", 0.2493)):
        length = skeleton.bone_lengths[skeleton.index(f"left_{name}")]
        assert length == pytest.approx(1.70 * share, abs=1e-3)
    points = np.zeros((22, 3))
    for j, parent in enumerate(skeleton.parents[1:], start=1):
        points[j] = points[parent] + skeleton.offsets[j]
    height = points[skeleton.index("head"), 2] - points[skeleton.index("left_foot"), 2]
    assert 1.45 < height < 1.65  # the head keypoint lies below the crown


@given(factor=st.floats(0.1, 10))
def test_scaling_scales_every_bone(factor):
    skeleton = human_skeleton()
    scaled = skeleton.scaled(factor)
    np.testing.assert_allclose(scaled.offsets, skeleton.offsets * factor)
    assert scaled.names == skeleton.names


@given(lengths=hnp.arrays(float, 22, elements=st.floats(0.01, 2)))
def test_bones_take_given_lengths_and_keep_their_directions(lengths):
    lengths[0] = 0
    skeleton = human_skeleton()
    other = skeleton.with_bone_lengths(lengths)
    np.testing.assert_allclose(other.bone_lengths, lengths, atol=1e-12)
    along = np.einsum("ji,ji->j", other.offsets, skeleton.offsets)
    np.testing.assert_allclose(along, lengths * skeleton.bone_lengths, atol=1e-12)
    back = other.with_bone_lengths(skeleton.bone_lengths)
    np.testing.assert_allclose(back.offsets, skeleton.offsets, atol=1e-12)


def test_names_are_found_and_a_typo_gets_the_nearest():
    skeleton = human_skeleton()
    assert [skeleton.index(name) for name in skeleton] == list(range(len(skeleton)))
    with pytest.raises(SpecError, match="did you mean 'left_elbow'"):
        skeleton.index("left_elbo")


def test_skeletons_are_frozen_all_the_way_down():
    offsets = np.zeros((2, 3))
    skeleton = Skeleton(("a", "b"), (-1, 0), offsets)
    offsets[1] = 9
    assert skeleton.offsets[1, 0] == 0
    with pytest.raises(ValueError):
        skeleton.offsets[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        skeleton.names = ()  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    ("names", "parents", "offsets", "match"),
    [
        (("a", "a"), (-1, 0), np.zeros((2, 3)), "uniquely"),
        (("a", "b"), (-1,), np.zeros((2, 3)), "one parent"),
        (("a", "b"), (-1, 0), np.zeros((3, 3)), "shape"),
        (("a", "b"), (-1, 0), np.full((2, 3), np.nan), "finite"),
        (("a", "b"), (0, 0), np.zeros((2, 3)), "root first"),
        (("a", "b"), (-1, 1), np.zeros((2, 3)), "after their parents"),
        (("a", "b"), (-1, -1), np.zeros((2, 3)), "after their parents"),
        ((), (), np.zeros((0, 3)), "root first"),
    ],
)
def test_a_broken_tree_is_refused(names, parents, offsets, match):
    with pytest.raises(SpecError, match=match):
        Skeleton(names, parents, offsets)


def test_read_only_copies():
    source = np.arange(3)
    copy = read_only(source)
    source[0] = 7
    assert copy[0] == 0
    assert copy.dtype == np.float64
    assert not copy.flags.writeable
