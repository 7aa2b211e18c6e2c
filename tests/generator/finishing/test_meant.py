"""What sentences say about touches, and what finishing makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.spoiling import Spoiling, spoil
from generator.choreographer import Style, choreograph
from generator.features import decode, encode
from generator.finishing import Meeting, finish, finish_with_changes
from generator.finishing.meant import meetings_of
from generator.finishing.touches import mirrored
from generator.motion import DuetMotion
from generator.runtime.sequence import plan, seen_from, sequence


def unlabelled(motion: DuetMotion) -> DuetMotion:
    return replace(motion, contacts=())


def test_a_sentence_says_who_meets_where() -> None:
    (shake,) = meetings_of("two people shake hands", 1.0, 4.0)
    assert shake == Meeting("right_hand", "right_hand", 1.0, 4.0, True)
    (left,) = meetings_of("two people shake hands with their left hands")
    assert left.pair == ("left_hand", "left_hand")
    assert not left.either
    pat = meetings_of("the second person pats the first person on the shoulder")
    assert {point for meeting in pat for point in (meeting.a, meeting.b)} & {"left_collar"}
    assert all(meeting.b.endswith("_hand") for meeting in pat), "the first person pats"
    assert meetings_of("two people wave at each other") == ()
    assert meetings_of("the printer is out of paper again") == ()
    assert mirrored(("left_hand", "spine3")) == ("right_hand", "spine3")


@pytest.mark.parametrize("hand", ["left", "right"])
def test_hands_that_miss_by_far_meet_when_the_sentence_says_so(hand) -> None:
    """Too far apart to be taken for a touch by their looks alone."""
    original = choreograph("handshake", seed=2, style=Style(handedness=hand))
    away = np.array([0.0, 0.0, 0.3])
    high = replace(original.b, keypoints=original.b.keypoints.copy(), rotations=None)
    points = high.keypoints.copy()
    points[:, [16, 17, 18, 19, 20, 21]] += away  # the arms of b are too high
    missed = unlabelled(replace(original, b=replace(high, keypoints=points)))
    assert finish(missed).contacts == ()
    made, changes = finish_with_changes(missed, expected=meetings_of("they shake hands"))
    (touch,) = made.contacts
    assert (touch.a, touch.b) == (f"{hand}_hand", f"{hand}_hand"), "the hand that was offered"
    assert changes.missed > 0.15
    assert changes.missing < 0.005
    true = original.contacts[0]
    assert touch.start < true.end
    assert true.start < touch.end


def test_a_touch_that_cannot_be_closed_gets_no_label() -> None:
    original = unlabelled(choreograph("handshake", seed=1))
    away = original.b.keypoints + np.array([1.5, 1.5, 0.0])
    apart = replace(original, b=replace(original.b, keypoints=away))
    made, changes = finish_with_changes(apart, expected=meetings_of("they shake hands"))
    assert (changes.touches, changes.given_up) == (0, 1)
    assert changes.missed > 0.4
    assert made.contacts == ()


def test_what_is_found_is_not_expected_again() -> None:
    original = choreograph("handshake", seed=1)
    spoilt = unlabelled(spoil(original, 7, Spoiling(place=0.1)))
    found = finish(spoilt).contacts
    assert len(found) == 1
    assert finish(spoilt, expected=meetings_of("they shake hands")).contacts == found


def test_a_meeting_is_looked_for_in_its_own_time() -> None:
    original = choreograph("handshake", seed=1)
    after = original.contacts[0].end + 0.3
    late = Meeting("right_hand", "right_hand", after, after + 0.3)
    touches = finish(unlabelled(original), expected=[late]).contacts
    assert len(touches) == 2, "the one that is found and the one that is expected"
    assert after - 0.05 < touches[1].start <= touches[1].end < after + 0.35


def test_a_touch_that_lasts_over_a_seam_is_one_touch() -> None:
    """Parts are joined before they are finished, so nobody lets go where they meet."""
    original = choreograph("circle_dance", seed=0)
    features, overlap = encode(original)[::2], 18
    cuts = plan([55, len(features) - 55], 75, overlap)
    starts = np.cumsum([0, *(window.frames - overlap for window in cuts[:-1])])

    def draw(number, window, beginning):
        piece = features[starts[number] : starts[number] + window.frames].copy()
        if beginning is None:
            return piece
        from generator.placement import placement_of

        return seen_from(piece, placement_of(piece[:1, 0, :66].reshape(1, 22, 3)))

    joined = np.concatenate(list(sequence(cuts, overlap, draw)))
    made = finish(decode(joined, 15.0))
    seam = 55 / 15
    true = original.contacts[0]
    assert true.start + 0.5 < seam < true.end - 0.5, "hands do not hold at the seam"
    held = [c for c in made.contacts if c.start < seam - 0.5 and c.end > seam + 0.5]
    assert {(c.a, c.b) for c in held} == {("left_hand", "right_hand"), ("right_hand", "left_hand")}
    for touch in held:
        inside = (made.a.times > touch.start + 0.1) & (made.a.times < touch.end - 0.1)
        assert np.abs(made.gap(touch)[inside] - touch.gap).max() < 0.02
