from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.motion import Contact, DuetMotion, Motion
from robots.errors import MotionError, SpecError

POINTS = np.random.default_rng(0).normal(size=(7, 22, 3))
UNITS = np.tile([1.0, 0, 0, 0], (7, 22, 1))


def test_a_motion_keeps_what_it_is_given():
    contacts = np.eye(7, 4, dtype=bool)
    motion = Motion(25, POINTS, UNITS, contacts)
    assert motion.frames == 7
    np.testing.assert_array_equal(motion.keypoints, POINTS)
    np.testing.assert_array_equal(motion.rotations, UNITS)
    np.testing.assert_array_equal(motion.foot_contacts, contacts)
    np.testing.assert_allclose(motion.times, np.arange(7) / 25)


def test_a_motion_is_frozen_and_shares_no_memory():
    points = POINTS.copy()
    motion = Motion(25, points, UNITS.copy())
    points[:] = 0
    np.testing.assert_array_equal(motion.keypoints, POINTS)
    for array in (motion.keypoints, motion.rotations):
        with pytest.raises(ValueError):
            array[0] = 1  # pyright: ignore[reportOptionalSubscript]
    with pytest.raises(dataclasses.FrozenInstanceError):
        motion.fps = 3  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"fps": 0}, "frames per second"),
        ({"fps": np.nan}, "frames per second"),
        ({"fps": 5000}, "frames per second"),
        ({"keypoints": POINTS[:, :3]}, "shape"),
        ({"keypoints": POINTS[0]}, "shape"),
        ({"keypoints": POINTS[:1]}, "1 frames"),
        ({"keypoints": np.zeros((100_001, 22, 3))}, "100001 frames"),
        ({"rotations": UNITS[:-1]}, "rotations have shape"),
        ({"rotations": UNITS * 1.01}, "unit quaternions"),
        ({"rotations": UNITS * np.nan}, "not finite in frame 0"),
        ({"foot_contacts": np.zeros((7, 3))}, "foot contacts have shape"),
    ],
)
def test_a_broken_motion_is_refused(change, match):
    with pytest.raises(MotionError, match=match):
        Motion(**{"fps": 25, "keypoints": POINTS, **change})


@given(frame=st.integers(0, 6), point=st.integers(0, 21), bad=st.sampled_from([np.nan, np.inf]))
def test_the_first_bad_frame_is_named(frame, point, bad):
    points = POINTS.copy()
    points[frame:, point, 1] = bad
    with pytest.raises(MotionError, match=f"not finite in frame {frame}"):
        Motion(25, points)


def test_a_hand_continues_the_forearm():
    motion = Motion(25, POINTS)
    elbow, wrist = motion.point("left_elbow"), motion.point("left_wrist")
    hand = motion.point("left_hand")
    np.testing.assert_allclose(np.cross(hand - wrist, wrist - elbow), 0, atol=1e-12)
    ratio = np.linalg.norm(hand - wrist, axis=1) / np.linalg.norm(wrist - elbow, axis=1)
    np.testing.assert_allclose(ratio, motion.skeleton.hand_per_forearm)
    assert (np.einsum("ti,ti->t", hand - wrist, wrist - elbow) > 0).all()


def test_unknown_points_get_the_nearest_name():
    with pytest.raises(SpecError, match="did you mean 'left_wrist'"):
        Motion(25, POINTS).point("left_writs")


def test_two_people_share_a_clock():
    a = Motion(25, POINTS)
    with pytest.raises(MotionError, match="frames per second"):
        DuetMotion(a, Motion(30, POINTS))
    with pytest.raises(MotionError, match="7 frames, b 6"):
        DuetMotion(a, Motion(25, POINTS[:6]))


@settings(deadline=None)
@given(shift=st.tuples(*[st.floats(-5, 5)] * 3))
def test_the_gap_is_the_distance_between_the_two_points(shift):
    a, b = Motion(25, POINTS), Motion(25, POINTS + shift)
    duet = DuetMotion(a, b)
    contact = Contact("left_hand", "left_hand", 0, 1)
    np.testing.assert_allclose(duet.gap(contact), np.linalg.norm(shift), atol=1e-9)
    assert (duet.fps, duet.frames, duet.duration) == (25, 7, 6 / 25)
    assert duet.people == (a, b)
    assert duet.keypoints.shape == (7, 2, 22, 3)
    np.testing.assert_array_equal(duet.keypoints[:, 1], b.keypoints)
