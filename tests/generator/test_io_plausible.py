from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generator.io.assembly import to_z_up
from generator.io.plausible import require_plausible, require_sane, stature, unit_hint
from generator.kinematics import forward_kinematics
from robots.errors import MotionFileError
from robots.skeleton import human_skeleton


def standing(frames=5, at=(0.0, 0.0), turn=None, height=0.975):
    """The T-pose, 0.975 m being the pelvis height of a 1.70 m person on the floor."""
    rotations = np.tile([1.0, 0, 0, 0], (frames, 22, 1))
    if turn is not None:
        rotations[:, 0] = turn.as_quat(scalar_first=True)
    root = np.tile([*at, height], (frames, 1))
    return forward_kinematics(human_skeleton(), root, rotations)


def check(a, b, scale=1.0, up="z"):
    require_plausible((a, b), scale=scale, up=up, where="x")


def test_two_people_who_stand_are_plausible():
    check(standing(), standing(at=(0, 2)))


@pytest.mark.parametrize("factor", [0.55, 1.0, 1.35])
def test_stature_follows_the_size_of_the_body_not_its_pose(factor):
    lying = standing(turn=Rotation.from_euler("x", 90, degrees=True))
    assert stature(standing() * factor) == pytest.approx(1.70 * factor)
    assert stature(lying * factor) == pytest.approx(1.70 * factor)
    check(standing() * factor, standing() * factor)


@pytest.mark.parametrize(
    ("size", "scale", "match"),
    [
        (100, 1.0, r"170 m tall.*--scale 0\.01 \(centimetres: 1\.70 m tall\)"),
        (1000, 1.0, r"--scale 0\.001 \(millimetres"),
        (39.37, 1.0, r"--scale 0\.0254 \(inches"),
        (17.7, 1.0, r"--scale 0\.056444 \(raw CMU units.*or --scale|--scale 0\.056444"),
        (0.01, 0.01, r"--scale 1 \(metres: 1\.70 m tall\)"),
        (3.0, 1.0, "are these the 22 keypoints"),
    ],
)
def test_a_wrong_unit_names_the_likely_one(size, scale, match):
    with pytest.raises(MotionFileError, match=match):
        check(standing() * size, standing() * size, scale=scale)


def test_unit_hint_is_silent_when_nothing_fits():
    assert unit_hint(5.0) == ""
    assert unit_hint(float("nan")) == ""


@pytest.mark.parametrize(
    ("up", "true_up", "advice"),
    [("z", "y", "give --up y"), ("y", "z", "give --up z"), ("z", "x", "turn"), ("y", "x", "turn")],
)
def test_a_wrong_up_axis_names_the_true_one(up, true_up, advice):
    in_file = {"x": (2, 0, 1), "y": (1, 2, 0), "z": (0, 1, 2)}[true_up]
    a, b = (to_z_up(standing(at=at)[..., in_file], up) for at in ((0, 0), (0, 1)))
    with pytest.raises(MotionFileError, match=f"on their sides.*{true_up} is up: {advice}"):
        check(a, b, up=up)


def test_a_downward_axis_is_noticed():
    flip = Rotation.from_euler("x", 180, degrees=True)
    people = standing(turn=flip, height=1.0), standing(turn=flip, height=1.0)
    with pytest.raises(MotionFileError, match="stand on their heads"):
        check(*people)


def test_one_person_may_lie_or_stand_on_the_head():
    lying = standing(turn=Rotation.from_euler("x", 90, degrees=True), height=0.2)
    flipped = standing(turn=Rotation.from_euler("x", 180, degrees=True), height=0.7)
    check(standing(), lying)
    check(flipped, standing())


def test_two_people_may_lie_facing_each_other():
    left = standing(turn=Rotation.from_euler("x", 90, degrees=True), height=0.2)
    right = standing(turn=Rotation.from_euler("x", -90, degrees=True), height=0.2)
    check(left, right)


def test_tumbling_is_judged_over_the_whole_clip():
    turns = Rotation.from_euler("y", np.linspace(0, 360, 40)[:, None], degrees=True)
    check(standing(40, turn=turns, height=1.0), standing(40, turn=turns, height=1.0))


def test_swapped_sides_are_noticed():
    mirrored = standing() * (1, -1, 1)
    with pytest.raises(MotionFileError, match="left and right are swapped"):
        check(mirrored, mirrored)


@pytest.mark.parametrize(("height", "side"), [(0.0, "below"), (2.5, "above")])
def test_a_floor_elsewhere_is_noticed(height, side):
    with pytest.raises(MotionFileError, match=f"m {side} the floor.*own root"):
        check(standing(height=height), standing(height=height))


def test_a_lifted_partner_is_no_wrong_floor():
    check(standing(), standing(height=2.0))


def test_people_in_different_rooms_are_noticed():
    with pytest.raises(MotionFileError, match=r"50 m apart.*one world frame"):
        check(standing(), standing(at=(30, 40)))


def test_keypoints_in_another_order_are_noticed():
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(20):
        order = rng.permutation(22)
        try:
            check(standing()[:, order], standing(at=(1, 0))[:, order])
        except MotionFileError:
            refused += 1
    assert refused == 20


def test_points_that_coincide_are_noticed():
    points = standing()
    points[:, 6] = points[:, 3]
    with pytest.raises(MotionFileError, match=r"bone from spine1 to spine2 is 0\.000 m"):
        check(points, points)


def test_limbs_that_change_their_length_are_noticed():
    points = standing(20)
    elbow = human_skeleton().index("left_elbow")
    points[::2, elbow] += (0, 0.2, 0)
    with pytest.raises(MotionFileError, match="changes its length"):
        check(points, points)


def test_insane_numbers_are_reported_with_their_frame():
    points = standing()
    require_sane(points, "x")
    for value, what in ((np.nan, "not finite"), (np.inf, "not finite"), (1e9, "absurdly large")):
        bad = points.copy()
        bad[3, 4, 1] = value
        with pytest.raises(MotionFileError, match=f"{what} in frame 3"):
            require_sane(bad, "x")
