import functools
import pickle

import numpy as np
import pytest

from benchmarks.tracking import robustness
from benchmarks.tracking.robustness import CONDITIONS, Grip, table, trials_of
from sim.disturbance import NONE
from sim.scene import AssistLimits

PUSH = next(c for c in CONDITIONS if c.name.startswith("push 100"))


@pytest.fixture(scope="module", autouse=True)
def handshakes():
    """Every trial makes its handshake anew; here each of the ten is made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robustness, "choreograph", functools.cache(robustness.choreograph))
        yield


@pytest.fixture(scope="module")
def pushes():
    return trials_of(PUSH, "ilqr", most=20)


def test_a_clip_is_the_seconds_around_the_grip_with_its_label():
    clip = Grip(set="push", name="x", seed=3).load()
    (grip,) = clip.contacts
    assert 3.5 < clip.duration < 4.5
    assert grip.start == pytest.approx(1.5, abs=0.05)
    middle = round((grip.start + grip.end) / 2 * clip.fps)
    assert clip.gap(grip)[middle] == pytest.approx(grip.gap, abs=0.03)


def test_trials_are_the_same_every_time(pushes):
    again = trials_of(PUSH, "ilqr", most=20)
    assert [t.key for t in again] == [t.key for t in pushes]
    assert len({t.key for t in pushes}) == 20


def test_pushes_come_from_all_sides_at_all_times_on_both(pushes):
    blows = [t.disturbance.pushes[0] for t in pushes]
    assert {p.person for p in blows} == {"a", "b"}
    assert np.linalg.norm([p.force for p in blows], axis=1) == pytest.approx(100.0)
    quarters = {(p.force[0] > 0, p.force[1] > 0) for p in blows}
    assert len(quarters) == 4
    starts = [p.start for p in blows]
    assert min(starts) < 1.0
    assert max(starts) > 1.8


def test_whoever_is_pushed_has_time_to_fall(pushes):
    for trial in pushes:
        push = trial.disturbance.pushes[0]
        assert push.start + push.duration < trial.clip.load().duration - 1.0


def test_nobody_may_turn_back_time(pushes):
    settings = pushes[0].settings
    assert settings.ilqr.recovery == 0
    assert settings.disturbance.pushes
    assert settings.assist == AssistLimits(max_force=0, max_torque=0)


def test_trials_can_be_sent_to_another_process(pushes):
    assert pickle.loads(pickle.dumps(pushes[0])).key == pushes[0].key


def test_the_table_counts_who_stood_and_leaves_out_what_was_not_tried(pushes):
    rows = {}
    for trial, stood in zip(pushes[:4], (True, True, True, False), strict=True):
        rows[trial.key] = {
            "success": stood,
            "mpjpe_global_mm": {"a": 20.0, "b": 30.0},
            "max_mean_error_m": {"a": 0.1, "b": 0.08},
            "cpu_seconds_per_second": 5.0,
        }
    lines = list(table(pushes, rows))
    assert len(lines) == 3
    assert lines[2] == "| push 100 N, 0.2 s | 3 of 4 (75 %) | 30 mm | 100 mm | 5.0 |"


def test_one_row_is_without_any_disturbance():
    (trial,) = trials_of(CONDITIONS[0], "assist", most=1)
    assert trial.disturbance == NONE
    assert trial.settings.assist == AssistLimits()
