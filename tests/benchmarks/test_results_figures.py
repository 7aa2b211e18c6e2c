"""What one motion is measured by, on motions whose figures are known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.results.figures import labelled_skate, low_skate, measured, missed, overlap
from benchmarks.results.real import LEARNT, keep_real, power_of
from benchmarks.results.spectra import (
    BANDS,
    FREQUENCIES,
    SECONDS,
    in_bands,
    jerk_power,
    velocity_power,
)
from generator.choreographer import choreograph
from generator.io import read_motion, write_motion
from generator.motion import DuetMotion
from robots.errors import MotionFileError, SpecError

GRASP = ("right_hand", "right_hand", 0.06)


@pytest.fixture(scope="module")
def shake() -> DuetMotion:
    return choreograph("handshake", seed=1)


def number(value: float | None) -> float:
    """What must be a number."""
    assert value is not None
    return value


def moved(motion: DuetMotion, by: np.ndarray) -> DuetMotion:
    """The duet with person b elsewhere; ``by`` is ``[3]`` or ``[T, 3]`` m."""
    shift = np.broadcast_to(by, (motion.frames, 3))[:, None]
    return replace(motion, b=replace(motion.b, keypoints=motion.b.keypoints + shift))


def test_what_the_choreographer_makes_is_bodily(shake):
    found, power = measured(shake, [GRASP])
    assert number(found["bones"]) < 1e-6
    assert number(found["skate_labelled"]) < 1e-4
    assert found["sunk"] == 0
    assert number(found["missed"]) < 0.01
    assert np.isfinite(power).all()


def test_feet_that_slide_are_as_fast_as_the_person(shake):
    speed = 0.3
    slid = moved(shake, np.outer(shake.a.times * speed, [1.0, 0.0, 0.0]))
    assert labelled_skate(slid.b) == pytest.approx(speed, rel=1e-3)
    assert low_skate(slid.b) == pytest.approx(speed, rel=0.1)
    assert labelled_skate(replace(slid.b, foot_contacts=None)) is None


def test_a_breathing_bone_and_a_sunken_foot_are_seen(shake):
    points = shake.a.keypoints.copy()
    wrist, elbow = (shake.a.skeleton.index(f"left_{n}") for n in ("wrist", "elbow"))
    points[::2, wrist] += 0.1 * (points[::2, wrist] - points[::2, elbow])
    points[..., 2] -= 0.5
    found, _ = measured(replace(shake, a=replace(shake.a, keypoints=points)), [])
    assert found["bones"] == pytest.approx(0.1 / 4, rel=0.2)  # one of two people, half the frames
    assert number(found["sunk"]) > 0.4
    assert found["missed"] is None


def test_hands_miss_by_what_they_are_apart_beyond_the_intended_gap(shake):
    away = moved(shake, np.array([0.0, 0.0, 1.0]))
    assert missed(away, [GRASP]) == pytest.approx(1.0, abs=0.25)
    assert missed(away, [(*GRASP[:2], 5.0)]) == 0


def test_hands_that_meet_in_the_mirror_have_met_but_not_hand_by_hand(shake):
    assert number(missed(shake, [("left_hand", "left_hand", 0.06)])) < 0.01
    both = [GRASP, ("left_hand", "left_hand", 0.06)]
    assert number(missed(shake, both)) > 0.3, "only one of two pairs meets"


def test_hands_that_pass_each_other_between_two_frames_have_met(shake):
    """At 7.5 frames a second a clap lies between two frames more often than on one."""
    hand = shake.a.point("right_hand") - shake.b.point("right_hand")
    side = np.where(np.arange(shake.frames) % 2, 0.5, -0.5)
    crossing = moved(shake, hand + np.outer(side, [0.0, 1.0, 0.0]))
    gaps = np.linalg.norm(crossing.a.point("right_hand") - crossing.b.point("right_hand"), axis=1)
    assert gaps.min() > 0.49
    assert number(missed(crossing, [(*GRASP[:2], 0.0)])) < 1e-6


def test_bodies_in_one_place_overlap_and_apart_they_do_not(shake):
    between = (shake.a.point("pelvis") - shake.b.point("pelvis")) * [1, 1, 0]
    assert overlap(moved(shake, between)).min() > 0.1
    assert overlap(moved(shake, np.array([0.0, 9.0, 0.0]))).max() < -5


def test_a_swing_has_its_power_at_its_frequency():
    fps, frequency, speed = 30.0, FREQUENCIES[5], 0.7
    times = np.arange(300) / fps
    step = np.sin(np.pi * frequency / fps) / (np.pi * frequency / fps)  # of the difference quotient
    path = speed * np.sin(2 * np.pi * frequency * times) / (2 * np.pi * frequency)
    keypoints = np.zeros((300, 2, 22, 3))
    keypoints[..., 1] = path[:, None, None]
    power = velocity_power(keypoints, fps)
    assert np.argmax(power) == 5
    assert power.sum() == pytest.approx((speed * step) ** 2 / 2, rel=0.01)
    band = [low < frequency <= high for low, high in BANDS]
    assert in_bands(power)[band][0] == pytest.approx(speed * step / np.sqrt(2), rel=0.02)
    jerk = np.sqrt(jerk_power(power).sum())
    assert jerk == pytest.approx((2 * np.pi * frequency) ** 2 * speed / np.sqrt(2), rel=0.1)


def test_the_same_movement_has_the_same_spectrum_at_another_rate():
    rng = np.random.default_rng(0)
    times = np.arange(1201) / 120.0
    phases, sizes = rng.uniform(0, 7, (4, 3)), rng.uniform(0.2, 1, (4, 3))
    waves = np.sin(2 * np.pi * np.multiply.outer(times, [0.5, 0.9, 1.3, 1.7])[..., None] + phases)
    path = (sizes * waves).sum(axis=1)[:, None]
    fast, slow = velocity_power(path[::4], 30.0), velocity_power(path[::16], 7.5)
    known = ~np.isnan(slow)
    assert list(np.flatnonzero(known)) == list(range(8)), "up to half of 7.5 per second"
    assert in_bands(slow)[:2] == pytest.approx(in_bands(fast)[:2], rel=0.15)


def test_too_short_a_motion_has_no_spectrum():
    assert np.isnan(velocity_power(np.zeros((int(SECONDS * 30), 2, 22, 3)), 30.0)).all()


def test_of_real_clips_some_are_learnt_from_and_others_are_held_out(shake, tmp_path):
    clips, root = tmp_path / "set" / "clips", tmp_path / "kept"
    clips.mkdir(parents=True)
    with pytest.raises(SpecError):
        keep_real(clips, root)
    (root / LEARNT).mkdir(parents=True)
    write_motion(shake, root / LEARNT / "of_another_folder.npz")
    for name in "abcd":
        write_motion(replace(shake, text=""), clips / f"{name}.npz")
    entries = [{"files": [f"clips/{n}.npz"], "description": "They box. (CMU)"} for n in "abc"]
    (tmp_path / "set" / "index.json").write_text(json.dumps(entries))
    assert keep_real(clips, root) == (2, 2)
    learnt = sorted((root / LEARNT).iterdir())
    assert [path.stem for path in learnt] == ["a", "b"], "every third and one without a sentence"
    assert read_motion(learnt[0]).text == "They box."
    power = power_of(root)
    for use in ("held out", "learnt from"):
        assert power[use] == pytest.approx(velocity_power(shake.keypoints, shake.fps))
    (tmp_path / "set" / "index.json").write_text('{"a": 1}')
    with pytest.raises(MotionFileError, match="description"):
        keep_real(clips, root)
