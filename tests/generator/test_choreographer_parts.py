"""The parts of the choreographer: curves, limbs, steps, style, mirror and swap, text to motion."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from generator.choreographer import (
    LICENCE,
    Style,
    choreograph,
    generate,
    lookup,
    repertoire,
    style_ranges,
    touching,
)
from generator.choreographer.arms import LONGEST, SHORTEST, within_reach
from generator.choreographer.clearance import segment_distance
from generator.choreographer.curves import drift, ease, oscillation, through, window
from generator.choreographer.footsteps import SWING, foot_path, plan_steps
from generator.choreographer.frames import pitch, roll, two_bones, yaw
from generator.choreographer.interaction import interaction
from generator.choreographer.role import Build, Role
from generator.choreographer.spacing import Apart
from generator.choreographer.stage import Stage
from generator.motion import DuetMotion
from robots.errors import PromptError, SpecError
from robots.skeleton import human_skeleton

TIMES = np.arange(120) / 30.0
finite = st.floats(-1.0, 1.0)
vector = st.tuples(finite, finite, finite).map(np.array)


def test_ease_is_minimum_jerk():
    """Zero speed and acceleration at both ends, peak speed 15/8 in the middle."""
    u = np.linspace(0, 1, 10_001)
    speed = np.gradient(ease(u), u)
    assert ease([-1.0, 0.0, 0.5, 1.0, 2.0]) == pytest.approx([0, 0, 0.5, 1, 1])
    assert speed.max() == pytest.approx(1.875, abs=1e-4)
    assert abs(speed[0]) < 1e-6
    assert abs(speed[-1]) < 1e-6


def test_window_is_flat_inside_and_zero_outside():
    curve = window(TIMES, 1.0, 1.5, 2.0, 3.0)
    assert (curve[TIMES <= 1.0] == 0).all()
    assert (curve[(TIMES >= 1.5) & (TIMES <= 2.0)] == 1).all()
    assert (curve[TIMES >= 3.0] == 0).all()


def test_through_passes_every_knot():
    knots = [(0.5, np.array([0.0, 1.0])), (2.0, np.array([3.0, -1.0])), (3.5, np.array([1.0, 1.0]))]
    curve = through(TIMES, knots)
    for moment, value in knots:
        assert curve[round(moment * 30)] == pytest.approx(value)


def test_oscillation_starts_and_ends_at_zero():
    curve = oscillation(TIMES, 1.0, 3.0, 2.0)
    assert np.abs(curve[(TIMES <= 1.0) | (TIMES >= 3.0)]).max() < 1e-12
    assert np.abs(curve).max() > 0.9


def test_drift_is_as_large_as_asked_and_seeded():
    one, again = (drift(TIMES, np.random.default_rng(4), 0.01) for _ in range(2))
    many = np.concatenate([drift(TIMES, np.random.default_rng(i), 0.01) for i in range(300)])
    assert np.array_equal(one, again)
    assert many.std() == pytest.approx(0.01, rel=0.1)


@given(st.floats(-3, 3))
def test_axis_rotations_agree_with_scipy(angle):
    for own, axis in ((roll, "x"), (pitch, "y"), (yaw, "z")):
        assert own(angle) == pytest.approx(Rotation.from_euler(axis, angle).as_matrix(), abs=1e-12)


@settings(deadline=None)
@given(vector, st.floats(0.15, 0.53), vector)
def test_two_bones_end_where_asked_and_bend_at_the_hinge(direction, distance, pole):
    if np.linalg.norm(np.cross(direction, pole)) < 1e-2:
        return
    bones = (np.array([0.0, 0.28, 0.0]), np.array([0.0, 0.26, 0.0]))
    end = (direction / np.linalg.norm(direction) * distance)[None]
    upper, lower = two_bones(np.zeros((1, 3)), end, pole[None], bones, (0.0, 0.0, -1.0))
    for rotation in (upper[0], lower[0]):
        assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
    middle = upper[0] @ bones[0]
    assert middle + lower[0] @ bones[1] == pytest.approx(end[0], abs=1e-9)
    assert middle @ (pole - end[0] * (pole @ end[0]) / distance**2) >= -1e-12
    flexion = Rotation.from_matrix(upper[0].T @ lower[0]).as_rotvec()
    assert flexion[:2] == pytest.approx([0, 0], abs=1e-6)
    assert flexion[2] <= 1e-9


@given(st.floats(0.01, 5.0))
def test_reach_is_kept_within_the_arm_and_exact_at_ease(length):
    arm = 0.62
    got = np.linalg.norm(within_reach(np.array([[length, 0.0, 0.0]]), arm)) / arm
    assert got + 1e-9 >= SHORTEST
    assert got < LONGEST + 0.0501
    if SHORTEST + 0.05 <= length / arm <= LONGEST:
        assert got == pytest.approx(length / arm)


@settings(max_examples=30, deadline=None)
@given(vector, vector, vector, vector)
def test_segment_distance_is_the_least_over_both_segments(p, q, r, s):
    grid = np.linspace(0, 1, 41)
    one = p + grid[:, None] * (q - p)
    other = r + grid[:, None] * (s - r)
    sampled = np.linalg.norm(one[:, None] - other[None], axis=2).min()
    exact = segment_distance(p[None], q[None], r[None], s[None])[0]
    spacing = (np.linalg.norm(q - p) + np.linalg.norm(s - r)) / 40
    assert exact <= sampled + 1e-9
    assert exact >= sampled - spacing


def _walker(speed: float) -> Role:
    role = Role(Build.of(human_skeleton()), TIMES)
    role.path[:, 0] = speed * through(TIMES, [(0.3, 0.0), (3.5, 2.0)])
    return role


def test_who_stands_does_not_step():
    assert plan_steps(_walker(0.0)) == []


def test_steps_alternate_and_never_lift_both_feet():
    steps = plan_steps(_walker(1.0))
    assert len(steps) >= 4
    for before, after in pairwise(steps):
        assert before.side != after.side
        assert after.leave >= before.land, "there is always a time on both feet"
    assert all(step.land - step.leave == pytest.approx(SWING) for step in steps)


def test_heel_rises_before_the_toe_and_foot_lands_flat():
    role = _walker(1.0)
    foot = foot_path(role, plan_steps(role), "left")
    assert (foot.heel_down <= foot.toe_down).all()
    assert (~foot.heel_down & foot.toe_down).any()
    assert foot.toe[:, 2].min() > 0.0
    assert foot.ankle[-1, 2] == pytest.approx(foot.ankle[0, 2])


@pytest.mark.parametrize(
    "wrong", [{"speed": 3.0}, {"lag": -0.1}, {"energy": float("nan")}, {"handedness": "both"}]
)
def test_style_out_of_range_is_refused(wrong):
    with pytest.raises(SpecError, match="allowed"):
        Style(**wrong)


def test_extremes_of_style_are_accepted():
    for name, (low, high) in style_ranges().items():
        assert getattr(replace(Style(), **{name: low}), name) == low
        assert getattr(replace(Style(), **{name: high}), name) == high


def test_unknown_interaction_names_the_nearest():
    with pytest.raises(PromptError, match="'handshake'"):
        choreograph("hand_shake")


def test_repertoire_has_the_first_fourteen():
    fourteen = {
        *("handshake", "high_five", "fist_bump", "wave", "bow", "hug", "push", "box"),
        *("walk_together", "circle_dance", "mirror_dance", "pass_object", "waltz", "beckon"),
    }
    assert fourteen <= set(repertoire())
    assert all(lookup(name).summary.endswith(".") for name in repertoire())


def test_a_new_interaction_is_one_function():
    from generator.choreographer import interaction as module

    @interaction(Apart(1.2))
    def stand_and_look(stage: Stage) -> None:
        """Both stand and look at each other."""
        beat = stage.phases(hold=2.0)
        stage.face_to_face(arrive=beat.hold.start)

    try:
        duet = choreograph("stand_and_look")
    finally:
        del module._REPERTOIRE["stand_and_look"]
    assert np.linalg.norm(duet.keypoints[:, 0, 0] - duet.keypoints[:, 1, 0], axis=1).min() > 1.1


def test_motion_carries_where_it_comes_from():
    duet = choreograph("handshake", seed=3)
    assert (duet.interaction, duet.seed, duet.licence) == ("handshake", 3, LICENCE)
    assert duet.source
    assert duet.fps == 30.0
    assert [(c.a, c.b) for c in duet.contacts] == [("right_hand", "right_hand")]


def test_left_handed_is_the_mirror_image():
    right, left = (choreograph("handshake", style=Style(handedness=h)) for h in ("right", "left"))
    assert left.contacts[0].a == "left_hand"
    mirror = np.array([1.0, -1.0, 1.0])
    for one, other in zip(right.people, left.people, strict=True):
        assert other.point("left_hand") == pytest.approx(one.point("right_hand") * mirror)
        assert other.point("right_knee") == pytest.approx(one.point("left_knee") * mirror)


def test_swap_gives_each_the_other_part_and_keeps_a_on_its_side():
    small = human_skeleton().scaled(0.9)
    plain = choreograph("push", skeletons=(small, human_skeleton()))
    swapped = choreograph("push", style=Style(swap=True), skeletons=(human_skeleton(), small))
    half_turn = np.array([-1.0, -1.0, 1.0])
    assert swapped.b.keypoints == pytest.approx(plain.a.keypoints * half_turn)
    assert swapped.a.keypoints == pytest.approx(plain.b.keypoints * half_turn)
    assert swapped.a.keypoints[0, 0, 0] < swapped.b.keypoints[0, 0, 0]
    assert {c.b for c in swapped.contacts} == {c.a for c in plain.contacts}


def _forward_hand(duet: DuetMotion) -> float:
    """Return how far hands are from the own pelvis at the touch, level, mean of both people."""
    at = round(0.5 * (duet.contacts[0].start + duet.contacts[0].end) * duet.fps)
    ways = [m.point("right_hand")[at] - m.point("pelvis")[at] for m in duet.people]
    return float(np.mean([np.hypot(way[0], way[1]) for way in ways]))


def test_style_distance_moves_people_apart():
    near, far = (choreograph("handshake", style=Style(distance=d)) for d in (0.7, 1.4))
    assert _forward_hand(far) > _forward_hand(near) + 0.03


def test_speed_shortens_the_scene():
    slow, fast = (choreograph("bow", style=Style(speed=s)).duration for s in (0.7, 1.4))
    assert slow > 1.7 * fast


def test_generate_goes_from_sentence_to_motion():
    duet, meaning = generate("The second person shoves the first one away.", seed=2)
    assert duet.text == "The second person shoves the first one away."
    assert duet.interaction == meaning.interaction == "push"
    assert meaning.style.swap
    assert {c.b for c in duet.contacts} == {"left_hand", "right_hand"}


def test_generate_refuses_or_takes_the_nearest():
    with pytest.raises(PromptError, match="--nearest"):
        generate("two people play chess")
    duet, meaning = generate("two people play chess", nearest=True)
    assert duet.interaction == meaning.interaction
    assert not meaning.known


@pytest.mark.parametrize("name", ["handshake", "push"])
@pytest.mark.parametrize("hand", ["left", "right"])
def test_bodies_with_unequal_limbs_keep_them_and_still_meet(name, hand):
    rng = np.random.default_rng(8)
    lengths = human_skeleton().bone_lengths
    first, second = (
        human_skeleton().with_bone_lengths(lengths * rng.uniform(0.93, 1.07, len(lengths)))
        for _ in range(2)
    )
    duet = choreograph(name, style=Style(handedness=hand), skeletons=(first, second))
    for motion, skeleton in zip(duet.people, (first, second), strict=True):
        assert motion.skeleton.bone_lengths == pytest.approx(skeleton.bone_lengths)
    for contact in duet.contacts:
        inside = (duet.a.times >= contact.start) & (duet.a.times <= contact.end)
        assert np.abs(duet.gap(contact)[inside] - contact.gap).max() < 0.01


@pytest.mark.parametrize("name", ["handshake", "hug", "help_up", "tap_shoulder", "wave", "cha_cha"])
@pytest.mark.parametrize("style", [Style(), Style(handedness="left", swap=True)])
def test_who_touches_whom_is_known_without_a_performance(name: str, style: Style) -> None:
    performed = choreograph(name, seed=3, style=style).contacts
    assert set(touching(name, style)) == {(touch.a, touch.b) for touch in performed}
