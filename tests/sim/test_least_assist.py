import math
from dataclasses import replace

import numpy as np
import pytest

import sim.least_assist
from generator.choreographer import choreograph
from generator.given import cut_motion
from generator.motion import DuetMotion
from robots.errors import SimDiverged, SpecError
from sim.least_assist import least_assist
from sim.scene import AssistLimits
from sim.track import TrackSettings, track

SPRINGS = TrackSettings(controller="assist")


@pytest.fixture(scope="module")
def settled(make_duet):
    """A rollout in which nobody falls."""
    return track(make_duet(0.3), settings=SPRINGS)


@pytest.fixture
def needing(monkeypatch, settled):
    """Return what makes tracking hold from a given assist on, and lists the limits that it saw."""

    def install(force, failure=None):
        seen: list[AssistLimits] = []

        def fake(motion, *, settings, progress=None):
            seen.append(settings.assist)
            if settings.assist.max_force >= force:
                return settled
            if failure is not None:
                raise failure
            return replace(settled, keypoints=settled.keypoints + np.array([1.0, 0, 0]))

        monkeypatch.setattr(sim.least_assist, "track", fake)
        return seen

    return install


def test_a_motion_that_needs_no_help_costs_one_run(needing, duet):
    seen = needing(0.0)
    found = least_assist(duet, SPRINGS)
    assert (found.trackable, found.force_bodyweight, found.torque_share) == (True, 0.0, 0.0)
    assert len(seen) == len(found.tries) == 1


def test_a_motion_that_nothing_helps_is_not_trackable_after_two_runs(needing, duet):
    needing(math.inf)
    found = least_assist(duet, SPRINGS)
    assert not found.trackable
    assert found.force_bodyweight is None
    assert found.torque_share is None
    assert [t.force_bodyweight for t in found.tries] == [0.0, 2.0]
    assert "fell at 0.00 s" in found.tries[0].why


@pytest.mark.parametrize("needed", [0.004, 0.01, 0.07, 0.333, 1.0, 1.99])
def test_the_answer_is_the_need_rounded_up_by_at_most_a_tenth(needing, duet, needed):
    seen = needing(needed)
    found = least_assist(duet, SPRINGS)
    assert found.trackable
    assert found.force_bodyweight is not None
    assert needed <= found.force_bodyweight <= max(0.01, 1.1 * needed) + 1e-12
    assert len(seen) <= 9


def test_force_and_torque_keep_the_proportion_of_the_defaults(needing, duet):
    seen = needing(0.5)
    settings = replace(SPRINGS, assist=AssistLimits(frequency=7.0))
    found = least_assist(duet, settings)
    for limits in seen:
        assert limits.max_torque == pytest.approx(limits.max_force * 0.15 / 0.5)
        assert limits.frequency == 7.0
    assert found.force_bodyweight is not None
    assert found.torque_share == pytest.approx(found.force_bodyweight * 0.3)


def test_divergence_counts_as_a_failure(needing, duet):
    needing(0.2, failure=SimDiverged("the physics diverged at 0.1 s"))
    found = least_assist(duet, SPRINGS)
    assert found.force_bodyweight == pytest.approx(0.2, rel=0.1)
    assert found.tries[0].why == "the physics diverged at 0.1 s"


def test_a_run_that_ended_early_counts_as_a_failure(monkeypatch, settled, duet):
    metadata = {**settled.metadata, "ended": {"time": 0.1, "why": "the controller gave up"}}
    cut = replace(settled, metadata=metadata)
    monkeypatch.setattr(sim.least_assist, "track", lambda *_, **__: cut)
    found = least_assist(duet, SPRINGS)
    assert not found.trackable
    assert found.tries[-1].why == "the controller gave up"


def test_progress_never_goes_back_and_reaches_one(monkeypatch, settled, duet):
    def fake(motion, *, settings, progress):
        progress(0.5)
        progress(1.0)
        return (
            settled
            if settings.assist.max_force > 0.3
            else replace(settled, keypoints=settled.keypoints + 1.0)
        )

    monkeypatch.setattr(sim.least_assist, "track", fake)
    seen: list[float] = []
    least_assist(duet, SPRINGS, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


@pytest.mark.parametrize(
    "wrong", [{"resolution": 0.0}, {"ceiling": 0.005}, {"ceiling": 11.0}, {"within": 0.6}]
)
def test_bounds_that_make_no_sense_are_refused(duet, wrong):
    with pytest.raises(SpecError, match="least_assist"):
        least_assist(duet, SPRINGS, **wrong)


def test_people_who_stand_need_no_help(make_duet):
    found = least_assist(make_duet(0.5), SPRINGS)
    assert found.force_bodyweight == 0.0


def test_hanging_in_the_air_takes_about_the_weight_of_a_body(make_duet, move):
    base = make_duet(0.6)

    def hover(k):
        return k + np.array([0, 0, 0.5])

    up = DuetMotion(move(base.a, hover), move(base.b, hover))
    found = least_assist(up, SPRINGS, resolution=0.5, within=0.2)
    assert found.force_bodyweight == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_springs_alone_need_a_hand_to_walk():
    walk = cut_motion(choreograph("handshake", seed=0), 0.0, 3.0)
    found = least_assist(walk, SPRINGS)
    assert found.force_bodyweight is not None
    assert 0.01 < found.force_bodyweight <= 0.5
