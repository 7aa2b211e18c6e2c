from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.io.bones import MAX_BONES, families, map_bones
from robots.errors import MotionFileError
from robots.skeleton import human_skeleton

FAMILIES = [family.title for family in families()]


def bone_names(title: str) -> list[str]:
    """First choices of a family's bones, in file order."""
    family = families()[FAMILIES.index(title)]
    names = [bone for choices in family.choices for bone, _ in choices[0]]
    return list(dict.fromkeys([*names, *family.requires]))


@pytest.mark.parametrize("title", FAMILIES)
def test_every_family_is_known_by_its_own_names(title):
    assert map_bones(bone_names(title), "x").family.title == title


@pytest.mark.parametrize("title", FAMILIES)
def test_left_and_right_take_mirrored_bones(title):
    """left_knee must come from a bone whose name is right_knee's with the side exchanged."""
    family = families()[FAMILIES.index(title)]
    skeleton = human_skeleton()
    for name in skeleton:
        if not name.startswith("left_"):
            continue
        right = family.choices[skeleton.index("right_" + name.removeprefix("left_"))]
        left = family.choices[skeleton.index(name)]
        assert len(left) == len(right)
        for one, two in zip(left, right, strict=True):
            swap = [(_mirror(bone), weight) for bone, weight in one]
            assert swap == list(two)


def _mirror(name: str) -> str:
    return name.replace("left", "right") if "left" in name else name.replace("l", "r", 1)


@pytest.mark.parametrize(
    "decorate",
    [lambda n: f"mixamorig:{n}", lambda n: f"mixamorig1:{n}", lambda n: f"mixamorig_{n}",
     lambda n: n.upper(), lambda n: f"Scene:Dancer:{n}"],
)  # fmt: skip
def test_namespaces_and_case_do_not_matter(decorate):
    names = [decorate(name) for name in bone_names("Mixamo")]
    assert map_bones(names, "x").family.title == "Mixamo"


@pytest.mark.parametrize("title", FAMILIES)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_keypoints_are_means_of_the_named_bones_in_any_order(title, seed):
    rng = np.random.default_rng(seed)
    names = bone_names(title)
    points = {name: rng.normal(size=3) for name in names}
    rng.shuffle(names)
    found = map_bones(names, "x")
    starts = np.array([[points[names[i]] for i in found.bones]])
    keypoints = found.keypoints(starts)[0]
    for j, choices in enumerate(found.family.choices):
        expected = sum(weight * points[bone] for bone, weight in choices[0])
        np.testing.assert_allclose(keypoints[j], expected, atol=1e-12)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1)


def test_missing_bones_are_named():
    names = [n for n in bone_names("Mixamo") if n not in ("lefttoebase", "neck")]
    with pytest.raises(MotionFileError, match=r"like a Mixamo.*no bone for left_foot, neck"):
        map_bones(names, "x")


def test_a_strange_skeleton_gets_the_list_of_known_ones():
    with pytest.raises(MotionFileError, match="allowed: SMPL, Character Creator, CMU"):
        map_bones(["wing", "tail"], "x")
    with pytest.raises(MotionFileError, match="none of the known"):
        map_bones([], "x")


def test_repeated_names_and_endless_lists_are_refused():
    with pytest.raises(MotionFileError, match="two bones are called"):
        map_bones([*bone_names("Mixamo"), "Hips"], "x")
    with pytest.raises(MotionFileError, match="at most"):
        map_bones([f"b{i}" for i in range(MAX_BONES + 1)], "x")
