"""Mirror and exchange: of poses, of motions, of words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generator.augment import mirror_motion, mirror_poses, mirror_text, swap_motion, swap_text
from generator.features import encode, pair_features, poses_of, release_features, release_poses
from generator.kinematics import forward_kinematics


@pytest.fixture(scope="module")
def arrays(golden):
    with np.load(golden / "preprocess.npz", allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def mirrored_pair(arrays):
    return [mirror_poses(release_poses(arrays[f"file_person{p}"])) for p in "12"]


def test_parity_of_the_mirrored_poses(arrays):
    for person, poses in zip("12", mirrored_pair(arrays), strict=True):
        expected = release_poses(arrays[f"mirrored{person}"])
        np.testing.assert_allclose(poses.positions, expected.positions, atol=1e-6)
        np.testing.assert_allclose(poses.rotations, expected.rotations, atol=1e-6)


def test_parity_of_the_mirrored_features(arrays):
    features = pair_features(mirrored_pair(arrays), 30, release_compat=True)
    np.testing.assert_allclose(features[:, 0], arrays["mirror_canon1"], rtol=0, atol=1e-5)
    np.testing.assert_allclose(features[:, 1], arrays["mirror_canon2"], rtol=0, atol=1e-5)
    same = release_features(arrays["mirrored1"], arrays["mirrored2"])
    np.testing.assert_allclose(np.stack(same, axis=1), features, rtol=0, atol=1e-5)


def test_a_mirrored_motion_is_still_a_motion_of_its_skeleton(make_duet):
    motion = mirror_motion(make_duet(frames=10))
    for person in motion.people:
        assert person.rotations is not None
        points = forward_kinematics(person.skeleton, person.keypoints[:, 0], person.rotations)
        np.testing.assert_allclose(points, person.keypoints, atol=1e-9)


def test_mirroring_a_motion_is_mirroring_its_poses(make_duet):
    motion = make_duet(frames=10)
    labels = np.random.default_rng(0).random((10, 4)) < 0.5
    motion = replace(motion, a=replace(motion.a, foot_contacts=labels))
    direct = encode(mirror_motion(motion))
    poses = [mirror_poses(poses_of(person)) for person in motion.people]
    np.testing.assert_allclose(direct, pair_features(poses, motion.fps), atol=1e-9)


def test_two_mirrors_and_two_exchanges_give_the_motion_back(make_duet):
    motion = replace(make_duet(frames=6), text="the first person raises the left hand, A sees B")
    for once in (mirror_motion, swap_motion):
        twice = once(once(motion))
        np.testing.assert_allclose(twice.keypoints, motion.keypoints, atol=1e-12)
        assert twice.a.rotations is not None
        assert motion.a.rotations is not None
        np.testing.assert_allclose(twice.a.rotations, motion.a.rotations, atol=1e-12)
        assert (twice.text, twice.contacts) == (motion.text, motion.contacts)
        assert once(motion).text != motion.text


def test_labels_follow_the_motion(make_duet):
    motion = make_duet(frames=6)
    (mirrored,) = mirror_motion(motion).contacts
    assert (mirrored.a, mirrored.b) == ("left_hand", "right_shoulder")
    (swapped,) = swap_motion(motion).contacts
    assert (swapped.a, swapped.b) == ("left_shoulder", "right_hand")
    other = mirror_motion(motion)
    np.testing.assert_allclose(other.gap(mirrored), motion.gap(motion.contacts[0]), atol=1e-12)
    other = swap_motion(motion)
    np.testing.assert_allclose(other.gap(swapped), motion.gap(motion.contacts[0]), atol=1e-12)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("raises the left hand", "raises the right hand"),
        ("Left foot, then RIGHT foot", "Right foot, then LEFT foot"),
        ("moves leftwards and right-handed", "moves rightwards and left-handed"),
        ("their left hands; the left's grip", "their right hands; the right's grip"),
        ("turn clockwise", "turn counterclockwise"),
        ("turn counterclockwise, then Clockwise", "turn clockwise, then Counterclockwise"),
        ("an anti-clockwise spin", "an clockwise spin"),
        ("leftover copyright", "leftover copyright"),
        ("right away, right next to her", "right away, right next to her"),
        ("one has left the room", "one has left the room"),
        ("all right, she lifts her right arm", "all right, she lifts her left arm"),
        ("brightly upright", "brightly upright"),
        ("she has left her chair", "she has left her chair"),
        ("she has left hand on hip", "she has right hand on hip"),
        (
            "he is left of her, she is left with nothing",
            "he is right of her, she is left with nothing",
        ),
        ("moves right when the other moves left", "moves left when the other moves right"),
        ("turn right then left-to-right", "turn left then right-to-left"),
    ],
)
def test_words_are_mirrored_and_nothing_but_words(before, after):
    assert mirror_text(before) == after


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("counterclockwise", "countercounterclockwise"),
        ("leftover copyright", "rightover copyleft"),
        ("left right clockwise", "right left counterclockwise"),
    ],
)
def test_the_release_mirrors_substrings(before, after):
    assert mirror_text(before, release_compat=True) == after


SYMMETRIC = st.lists(
    st.sampled_from(["left", "Right", "clockwise", "counterclockwise", "hand", "bright", "two,"]),
    max_size=6,
).map(" ".join)


@given(SYMMETRIC)
def test_mirroring_twice_gives_the_sentence_back(text):
    assert mirror_text(mirror_text(text)) == text


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("the first person pushes the second", "the second person pushes the first"),
        ("The first man's hand. Second man waits", "The second man's hand. First man waits"),
        ("the second tall woman hugs the other", "the first tall woman hugs the other"),
        ("person one bows to person two", "person two bows to person one"),
        ("Person 1 and person 2", "Person 2 and person 1"),
        ("Person A lifts Person B", "Person B lifts Person A"),
        ("person a lifts person b", "person b lifts person a"),
        ("A pushes B", "B pushes A"),
        ("A man pushes a woman", "A man pushes a woman"),
        ("two people shake hands", "two people shake hands"),
        ("one waves to the other", "one waves to the other"),
        ("the person a step away waves", "the person a step away waves"),
        ("they bow for the first time", "they bow for the first time"),
        ("for a second they wait, the first to bow wins", None),
        ("the first hits the second a second time", "the second hits the first a second time"),
    ],
)
def test_roles_are_exchanged_where_a_sentence_names_them(before, after):
    after = before if after is None else after
    assert swap_text(before) == after
    assert swap_text(after) == before
