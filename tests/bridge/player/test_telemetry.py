"""Lag and tracking figures, the phase, the ramp and the file."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.player.phase import Phase
from bridge.player.ramp import Ramp, ramp_time
from bridge.player.telemetry import Telemetry, read_telemetry, track
from robots.errors import MotionFileError

NAMES = ("one", "two")
TIMES = np.arange(0, 4, 0.01)


def signal(times: np.ndarray) -> np.ndarray:
    return np.column_stack([0.4 * np.sin(3 * times), 0.2 * np.cos(5 * times)])


@pytest.mark.parametrize("lag", [0.0, 0.013, 0.048, 0.2])
def test_a_known_lag_is_found(lag):
    tracking = track("robot", NAMES, TIMES, signal(TIMES), signal(TIMES - lag))
    assert tracking.lag_ms == pytest.approx(1e3 * lag, abs=1.0)
    assert tracking.rms_without_lag_deg < 0.05
    assert tracking.rms_deg >= tracking.rms_without_lag_deg


def test_errors_are_those_of_the_answers_that_came():
    goal = np.zeros((4, 2))
    present = np.array([[0.0, 0.1], [0.0, np.nan], [0.0, -0.2], [0.0, 0.0]])
    tracking = track("robot", NAMES, np.arange(4.0), goal, present)
    assert tracking.missed_reads == 1
    assert tracking.worst_joint == "two"
    assert tracking.max_deg == pytest.approx(math.degrees(0.2))
    assert tracking.rms_deg == pytest.approx(math.degrees(math.sqrt(0.05 / 7)))


def test_nothing_played_is_not_a_number_and_no_crash():
    empty = track("robot", NAMES, np.array([]), np.zeros((0, 2)), np.zeros((0, 2)))
    assert math.isnan(empty.rms_deg)
    assert empty.missed_reads == 0


def test_a_line_that_a_crash_cut_off_is_left_out(tmp_path):
    path = tmp_path / "t.jsonl"
    with Telemetry(path) as telemetry:
        telemetry.event(1.0, "first")
        assert [line["event"] for line in read_telemetry(path)] == ["first"]  # before closing
    path.write_text(path.read_text() + '{"kind":"ti')
    assert [line["event"] for line in read_telemetry(path)] == ["first"]
    path.write_text('{"kind":"ti\n' + path.read_text())
    with pytest.raises(MotionFileError, match=":1"):
        read_telemetry(path)


def test_a_telemetry_file_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MotionFileError), Telemetry(tmp_path / "file" / "t.jsonl"):
        pass


def test_a_full_disk_ends_the_record_not_the_dance(caplog):
    with Telemetry("/dev/full") as telemetry:
        for k in range(3):
            telemetry.event(float(k), "something")
    assert caplog.text.count("telemetry ends here") == 1


@given(
    rate=st.floats(0.05, 3),
    stop=st.floats(0.0, 10),
    within=st.floats(0.05, 2),
)
def test_a_phase_never_runs_back_and_never_faster_than_its_rate(rate, stop, within):
    phase = Phase(0.0, rate)
    phase.stop(stop, within)
    phase.stop(stop / 2, within)  # a second call changes nothing
    times = np.linspace(0, stop + within + 1, 400)
    values = np.array([phase.at(float(time)) for time in times])
    steps = np.diff(values)
    assert (steps >= -1e-12).all()
    assert (steps <= rate * np.diff(times) + 1e-9).all()
    assert phase.stopped(stop + within)
    assert values[-1] == pytest.approx(rate * (stop + within / 2))


@given(
    start=st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    end=st.lists(st.floats(-3, 3), min_size=3, max_size=3),
    limit=st.floats(0.1, 5),
)
def test_a_ramp_keeps_to_the_speed_limit_and_ends_where_it_should(start, end, limit):
    a, b = np.array(start), np.array(end)
    duration = ramp_time(a, b, np.full(3, limit), 0.5)
    ramp = Ramp(a, b, duration)
    times = np.linspace(0, duration, 500)
    positions = np.array([ramp.at(float(time)) for time in times])
    speed = np.abs(np.diff(positions, axis=0)) / (times[1] - times[0])
    assert speed.max() <= limit * (1 + 1e-6)
    np.testing.assert_allclose(positions[0], a, atol=1e-12)
    np.testing.assert_allclose(positions[-1], b, atol=1e-12)
    assert speed[0].max() <= 1e-3 * limit + 1e-9  # starts at rest
