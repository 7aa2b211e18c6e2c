"""Spoilt duets come back clean, and nearer to what they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.finish import figures
from benchmarks.spoiling import Spoiling, spoil
from generator.finishing import Finishing, finish, finish_with_changes
from generator.finishing.figure import Figure, turn_about
from generator.kinematics import forward_kinematics
from generator.motion import CONTACT_POINTS, DuetMotion
from robots.errors import MotionError, SpecError
from robots.ranges import bones_at


def bare(motion: DuetMotion) -> DuetMotion:
    """Keypoints alone: no rotations, no labels, no touches."""
    a, b = (replace(m, rotations=None, foot_contacts=None) for m in motion.people)
    return replace(motion, a=a, b=b, contacts=())


def test_every_figure_gets_better_and_is_within_its_bound(case) -> None:
    before, after = figures(case.spoilt, case.original), figures(case.made, case.original)
    assert before.bones > 0.1
    assert after.bones < 0.005
    assert before.skate > 0.1
    assert after.skate < 0.3 * before.skate
    assert before.jerk > 2
    assert after.jerk < 1.5
    assert after.floating < 0.5 * before.floating
    assert after.sunk < 0.5 * before.sunk
    assert after.pose < before.pose
    assert after.away < before.away


def test_touches_meet(case) -> None:
    if case.original.contacts:
        assert figures(case.spoilt, case.original).miss > 0.02
        assert figures(case.made, case.original).miss < 0.005
        assert case.changes.touches == len(case.original.contacts)


def test_feet_that_are_labelled_as_standing_stand(case) -> None:
    for person in case.made.people:
        down = person.foot_contacts
        assert down is not None
        assert down.mean() > 0.3
        for column, name in enumerate(CONTACT_POINTS):
            stays = down[1:, column] & down[:-1, column]
            speed = np.linalg.norm(np.diff(person.point(name), axis=0), axis=1) * person.fps
            assert speed[stays].max(initial=0.0) < 0.02


def test_no_toe_goes_below_a_standing_one(case) -> None:
    for person in case.made.people:
        toes = np.stack([person.point("left_foot"), person.point("right_foot")])[..., 2]
        labels = person.foot_contacts
        assert labels is not None
        standing = toes[0][labels[:, 1]]
        assert np.ptp(standing) < 1e-3
        assert toes.min() > standing.min() - 1e-3


def test_keypoints_are_the_kinematics_of_rotations(case) -> None:
    for person in case.made.people:
        made = forward_kinematics(person.skeleton, person.keypoints[:, 0], person.rotations)
        np.testing.assert_allclose(made, person.keypoints, atol=1e-9)


def test_rate_and_length_are_those_asked_for(case) -> None:
    assert case.made.fps == 30
    assert abs(case.made.duration - case.spoilt.duration) < 1 / 30
    assert case.made.text == case.original.text


def test_hands_are_fast_when_they_were(handshake: DuetMotion) -> None:
    made = finish(spoil(handshake, 3, Spoiling(place=0.0)))
    speeds = [
        np.linalg.norm(np.gradient(m.a.point("right_hand"), axis=0), axis=1)[: made.frames]
        for m in (handshake, made)
    ]
    a, b = ((s - s.mean()) / s.std() for s in speeds)
    lags = range(-6, 7)
    match = [np.mean(a[10:-10] * np.roll(b, lag)[10:-10]) for lag in lags]
    assert abs(lags[int(np.argmax(match))]) <= 1
    assert max(match) > 0.8


def test_the_signs_of_quaternions_do_not_matter(handshake: DuetMotion) -> None:
    """A quaternion and its opposite are one rotation; a reader's jump between them is no noise."""
    spoilt = spoil(handshake, 4)
    rng = np.random.default_rng(0)
    people = []
    for person in spoilt.people:
        assert person.rotations is not None
        signs = rng.choice([-1.0, 1.0], person.rotations.shape[:2])[..., None]
        people.append(replace(person, rotations=person.rotations * signs))
    turned = finish(replace(spoilt, a=people[0], b=people[1]))
    np.testing.assert_allclose(turned.keypoints, finish(spoilt).keypoints, atol=1e-6)


def test_what_is_clean_stays_as_it_is(handshake: DuetMotion) -> None:
    made = finish(handshake)
    moved = np.linalg.norm(made.keypoints - handshake.keypoints, axis=-1)
    assert moved.mean() < 0.005
    assert moved[:, :, [handshake.a.skeleton.index("head")]].max() < 0.03


def test_bare_keypoints_are_finished_and_their_touch_is_found(handshake: DuetMotion) -> None:
    spoilt = spoil(handshake, 5, Spoiling(place=0.02))
    made, changes = finish_with_changes(bare(spoilt))
    assert changes.touches >= 1
    found = [c for c in made.contacts if (c.a, c.b) == ("right_hand", "right_hand")]
    assert found
    true = handshake.contacts[0]
    assert found[0].start < true.end
    assert true.start < found[0].end
    assert figures(made, handshake).bones < 0.005
    assert made.a.rotations is not None
    assert made.a.foot_contacts is not None


def test_expected_touches_are_closed_where_they_are_nearest(handshake: DuetMotion) -> None:
    spoilt = bare(spoil(handshake, 7, Spoiling(place=0.1)))
    made = finish(spoilt, expected=[("right_hand", "right_hand")])
    (touch,) = made.contacts
    inside = (made.a.times >= touch.start) & (made.a.times <= touch.end)
    assert inside.any()
    assert np.abs(made.gap(touch)[inside] - touch.gap).max() < 0.005


def test_touches_that_miss_by_too_much_are_left(handshake: DuetMotion) -> None:
    apart = handshake.b.keypoints + np.array([2.0, 2.0, 0.0])
    far = replace(handshake, b=replace(handshake.b, keypoints=apart))
    made, changes = finish_with_changes(far)
    assert changes.given_up == len(handshake.contacts)
    assert changes.touches == 0
    hands = [made.a.point("right_hand") - far.a.point("right_hand")]
    assert np.abs(hands).max() < 0.03


def test_the_same_input_gives_the_same_output(case) -> None:
    again = finish(case.spoilt)
    np.testing.assert_array_equal(again.keypoints, case.made.keypoints)


def test_a_back_that_is_bent_further_than_backs_go_is_turned_back(handshake: DuetMotion) -> None:
    """A network that was to bow deeply bent it by 130 degrees; the gate refused that."""
    off = Finishing(smoothing=0, feet=False, hands=False, apart=False, jolt=1e4)
    whole, changes = finish_with_changes(handshake, settings=off)
    assert changes.unbent == 0
    person = whole.a
    assert person.rotations is not None
    figure = Figure(person.skeleton, person.keypoints[:, 0], person.rotations)
    bow = np.radians(130) * np.hanning(len(figure))
    left = person.point("left_hip")[0] - person.point("right_hip")[0]
    figure.bend("spine2", turn_about(bow[:, None] * left / np.linalg.norm(left)))
    spoilt = replace(whole, a=figure.motion(person.fps, person.foot_contacts))
    made, changes = finish_with_changes(spoilt, settings=off)
    bent, straight = (bones_at(m.a.keypoints, m.a.skeleton, "spine2")[2] for m in (spoilt, made))
    assert bent.max() > 115
    assert straight.max() == pytest.approx(100, abs=0.5)
    assert changes.unbent == pytest.approx(bent.max() - 100, abs=0.5)
    fine = bent < 99
    np.testing.assert_allclose(made.a.keypoints[fine], spoilt.a.keypoints[fine], atol=2e-3)
    np.testing.assert_allclose(made.a.point("pelvis"), spoilt.a.point("pelvis"), atol=2e-3)


def test_stages_can_be_left_out(handshake: DuetMotion) -> None:
    off = Finishing(smoothing=0, feet=False, hands=False, apart=False)
    made, changes = finish_with_changes(handshake, settings=off)
    np.testing.assert_allclose(made.keypoints, handshake.keypoints, atol=2e-3)
    assert (changes.raised, changes.planted, changes.pushed, changes.missing) == (0, 0, 0, 0)
    np.testing.assert_array_equal(made.a.foot_contacts, handshake.a.foot_contacts)


@pytest.mark.parametrize("frames", [2, 3, 4, 6])
def test_the_shortest_motions_are_finished(make_duet, frames: int) -> None:
    made = finish(make_duet(frames=frames, fps=15.0))
    assert np.isfinite(made.keypoints).all()


def test_a_known_skeleton_is_kept(handshake: DuetMotion) -> None:
    bodies = handshake.a.skeleton, handshake.b.skeleton
    made = finish(spoil(handshake, 2), skeletons=bodies)
    np.testing.assert_allclose(made.a.skeleton.bone_lengths, bodies[0].bone_lengths, atol=1e-12)


@pytest.mark.parametrize("fps", [0.0, 5000.0, float("nan")])
def test_absurd_rates_are_refused(handshake: DuetMotion, fps: float) -> None:
    with pytest.raises(MotionError, match="frames per second"):
        finish(handshake, fps=fps)


@pytest.mark.parametrize("wrong", [{"smoothing": -1.0}, {"max_gap": float("inf")}])
def test_wrong_settings_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(SpecError, match=next(iter(wrong))):
        Finishing(**wrong)  # type: ignore[arg-type]
