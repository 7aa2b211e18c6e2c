import json
from dataclasses import replace

import numpy as np
import pytest

from generator.motion import Contact, DuetMotion
from sim.outcome import Cost, is_of, outcome, recorded
from sim.track import TrackSettings, track

ASSIST = TrackSettings(controller="assist")
KEYS = {
    *("fell", "fall_time_s", "mpjpe_global_mm", "mpjpe_root_mm", "accel_error_mm_per_frame2"),
    *("max_mean_error_m", "success", "assist_max_bodyweight", "penetration_max_mm"),
    *("floor_penetration_p95_mm", "contact_recall", "cpu_seconds_per_second"),
    *("wall_seconds_per_second", "seed", "mujoco_version"),
}
COST = Cost(cpu=2.4, wall=1.2)


@pytest.fixture(scope="module")
def rollout(duet):
    return track(duet, settings=replace(ASSIST, seed=5))


def told(text):
    """Parse JSON as strict readers do, who know no NaN."""

    def refuse(name):
        raise AssertionError(name)

    return json.loads(text, parse_constant=refuse)


def test_an_outcome_has_every_promised_key(rollout, tmp_path):
    outcome(rollout, COST).save(tmp_path / "track.json")
    figures = told((tmp_path / "track.json").read_text())
    assert figures.keys() >= KEYS
    for key in ("fell", "fall_time_s", "mpjpe_global_mm", "max_mean_error_m"):
        assert set(figures[key]) == {"a", "b"}
    assert figures["success"] is True
    assert figures["seed"] == 5
    assert figures["fall_time_s"] == {"a": None, "b": None}
    assert 0 < figures["mpjpe_root_mm"]["a"] < figures["mpjpe_global_mm"]["a"] < 30


def test_cost_is_per_simulated_second(rollout):
    result = outcome(rollout, COST)
    assert result.simulated_s == pytest.approx(1.2)
    assert result.cpu_seconds_per_second == pytest.approx(2.0)
    assert result.wall_seconds_per_second == pytest.approx(1.0)


def test_a_cost_counts_the_time_between_two_readings():
    start = Cost.now()
    sum(range(200_000))
    spent = Cost.now().since(start)
    assert 0 < spent.cpu < 1
    assert 0 < spent.wall < 1


def test_recall_is_the_share_of_wanted_touches_that_happen(rollout, duet):
    assert outcome(rollout, COST).contact_recall is None  # nobody touches, nothing is labelled
    labels = [
        {"a": "left_hand", "b": "right_hand", "start": 0.0, "end": 0.5, "gap": 0.0},
        {"a": "head", "b": "head", "start": 0.0, "end": 0.5, "gap": 2.0},
    ]
    far = replace(rollout, metadata={**rollout.metadata, "contacts": labels})
    recall = outcome(far, COST).contact_recall
    assert recall == 1.0
    moved = rollout.keypoints.copy()
    moved[:, 1, :, 0] += 0.3
    away = replace(far, keypoints=moved, metadata={**far.metadata, "contacts": labels[:1]})
    assert outcome(away, COST).contact_recall == 0.0
    assert far.contacts[1] == Contact("head", "head", 0.0, 0.5, 2.0)


def test_who_is_half_a_metre_off_fell_then_and_the_outcome_is_no_success(rollout):
    fallen = rollout.keypoints.copy()
    fallen[30:, 1, :, 2] -= 0.6
    result = outcome(replace(rollout, keypoints=fallen), COST)
    assert result.fell == {"a": False, "b": True}
    assert result.fall_time_s == {"a": None, "b": pytest.approx(0.5)}
    assert not result.success
    assert result.finished
    assert result.max_mean_error_m["b"] > 0.55 > result.max_mean_error_m["a"]


def test_a_run_that_ended_early_is_no_success_and_says_why(rollout):
    ended = {"time": 1.25, "why": "the physics diverged at 1.250 s"}
    result = outcome(replace(rollout, metadata={**rollout.metadata, "ended": ended}), COST)
    assert not result.success
    assert not result.finished
    assert result.ended_because == "the physics diverged at 1.250 s"


def test_penetration_of_the_reference_is_that_of_the_motion_as_given(duet, move):
    """Repair moves people apart before control; what was asked for must not look better by it."""
    inside = DuetMotion(duet.a, move(duet.b, lambda k: k - np.array([1.1, 0, 0])))
    rollout = track(inside, settings=ASSIST)
    repaired = replace(rollout, reference_qpos=np.roll(rollout.reference_qpos, 1, axis=0))
    depth = outcome(repaired, COST).penetration_max_mm["reference"]
    assert depth == outcome(rollout, COST).penetration_max_mm["reference"]
    assert depth > 50


def test_recoveries_are_counted(rollout):
    assert outcome(rollout, COST).recoveries == 0
    events = [{"lost_at": 0.9, "back_to": 0.2}, {"lost_at": 1.0, "back_to": 0.1}]
    stumbled = replace(rollout, metadata={**rollout.metadata, "recoveries": events})
    assert outcome(stumbled, COST).recoveries == 2


def test_numbers_that_are_not_finite_are_written_as_null(rollout, tmp_path):
    result = outcome(rollout, COST, least_assist={"force_bodyweight": float("nan")})
    result.save(tmp_path / "track.json")
    figures = told((tmp_path / "track.json").read_text())
    assert figures["least_assist"] == {"force_bodyweight": None}


def test_a_record_is_recognised_by_motion_settings_and_versions(rollout, duet, make_duet, tmp_path):
    path, settings = tmp_path / "track.json", replace(ASSIST, seed=5)
    outcome(rollout, COST).save(path)
    record = recorded(path)
    assert record is not None
    assert is_of(record, duet, settings)
    assert not is_of(record, make_duet(0.4), settings)
    assert not is_of(record, duet, ASSIST)
    assert not is_of({**record, "versions": {"mujoco": "0"}}, duet, settings)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"schema": "x"}', b"\xff\xfe"])
def test_what_is_no_record_is_none(content, tmp_path):
    path = tmp_path / "track.json"
    assert recorded(path) is None
    path.write_bytes(content)
    assert recorded(path) is None
