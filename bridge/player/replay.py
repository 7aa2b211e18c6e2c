"""A performance told again from its telemetry file, also if nobody closed the file.

**The problem.** The player's summary is the file's last line, and a crash, a kill or a full disk
leaves no last line; those are the runs one wants to look into. Everything the summary is made of is
in the ticks, so it is computed again from them. A tick of which only one robot's line was written
does not count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bridge.player.recorder import LATE_SHARE
from bridge.player.telemetry import SCHEMA, Performance, read_telemetry, track
from robots.errors import MotionFileError
from robots.skeleton import FloatArray

BROKEN_OFF = "broken off"
"""Outcome of a file that says nothing about its end."""
LAG_WINDOW, LAG_STEP = 2.0, 0.5
"""s of the dance that one lag is measured over, and from one to the next."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What one robot was asked and did; N ticks, D joints."""

    person: str
    robot: str
    """Its name."""
    joints: tuple[str, ...]
    times: FloatArray
    """``[N]`` s from the first tick."""
    playing: np.ndarray
    """``[N]`` bool: ticks of the dance itself."""
    goal: FloatArray
    """``[N, D]`` rad."""
    present: FloatArray
    """``[N, D]`` rad, NaN where no answer came."""
    current: FloatArray
    """``[N, D]`` A, NaN where there is none."""
    late: FloatArray
    """``[N]`` s after the schedule at which the tick began."""
    sent: FloatArray
    """``[N]`` s after the schedule at which the goals were on their way."""
    temperature: dict[str, tuple[FloatArray, FloatArray]]
    """By joint: times s and degrees C, as often as it was looked."""

    def lags(self) -> tuple[FloatArray, FloatArray]:
        """Return times ``[M]`` s and lags ``[M]`` ms of goals to positions along the dance."""
        times, goal, present = (
            values[self.playing] for values in (self.times, self.goal, self.present)
        )
        if len(times) < 2:
            return np.zeros(0), np.zeros(0)
        starts = np.arange(times[0], max(times[-1] - LAG_WINDOW, times[0]) + 1e-9, LAG_STEP)
        centres, found = [], []
        for start in starts:
            within = (times >= start) & (times <= start + LAG_WINDOW)
            if within.sum() > 2:
                part = track(self.robot, self.joints, times[within], goal[within], present[within])
                centres.append(float(times[within].mean()))
                found.append(part.lag_ms)
        return np.array(centres), np.array(found)


@dataclass(frozen=True, slots=True, eq=False)
class Replay:
    """A whole telemetry file."""

    performance: Performance
    """Computed from the ticks."""
    closed: bool
    """Whether the player wrote its own summary at the end."""
    tracks: tuple[Track, ...]
    """By person."""
    events: tuple[tuple[float, str], ...]
    """Times s from the first tick, and what happened: states, stops, faults."""


def replay(path: str | Path) -> Replay:
    """Read a telemetry file and compute what its summary says, or would have said.

    Raises:
        MotionFileError: The file cannot be read, or is no telemetry.
    """
    lines = read_telemetry(path)
    if not all(isinstance(line, dict) for line in lines):
        raise MotionFileError("holds more than JSON objects", where=str(path), allowed=SCHEMA)
    header = lines[0] if lines else {}
    if header.get("schema") != SCHEMA or not header.get("robots"):
        raise MotionFileError("is not telemetry", where=str(path), allowed=SCHEMA)
    try:
        return _replay(lines)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise MotionFileError(f"is damaged: {error!r}", where=str(path)) from error


def _replay(lines: list[dict[str, Any]]) -> Replay:
    header = lines[0]
    robots: dict[str, dict[str, Any]] = header["robots"]
    ticks = _whole_ticks(lines, tuple(robots))
    start = float(next(iter(ticks[0][1].values()))["t"]) if ticks else 0.0
    tracks = tuple(
        _track(person, about, [rows[person] for _, rows in ticks], lines, start)
        for person, about in robots.items()
    )
    last = lines[-1]
    closed = last.get("kind") == "summary"
    events = tuple(
        (float(line["t"]) - start, _words(line))
        for line in lines
        if line.get("kind") == "event" and line["event"] != "health" and line["t"] is not None
    )
    outcome = str(last["outcome"]) if closed else _outcome(lines)
    performance = _performance(tracks, ticks, float(header["rate"]), outcome)
    return Replay(performance, closed, tracks, events)


Tick = tuple[int, dict[str, dict[str, Any]]]
"""Which stretch of ticks without a change of state it belongs to, and its lines by person."""


def _whole_ticks(lines: Sequence[dict[str, Any]], people: tuple[str, ...]) -> list[Tick]:
    ticks: list[Tick] = []
    rows: dict[str, dict[str, Any]] = {}
    stretch = 0
    for line in lines:
        if line["kind"] == "event" and line["event"] == "state":
            stretch += 1
        if line["kind"] != "tick":
            continue
        if rows and next(iter(rows.values()))["t"] != line["t"]:
            rows = {}
        rows[line["robot"]] = line
        if len(rows) == len(people):
            ticks.append((stretch, rows))
            rows = {}
    return ticks


def _track(
    person: str,
    about: dict[str, Any],
    rows: list[dict[str, Any]],
    lines: Sequence[dict[str, Any]],
    start: float,
) -> Track:
    joints = tuple(str(name) for name in about["joints"])
    temperature: dict[str, tuple[list[float], list[float]]] = {}
    for line in lines:
        if line.get("event") == "health" and line["robot"] == person:
            for joint, value in line.get("present_temperature", {}).items():
                times, values = temperature.setdefault(joint, ([], []))
                times.append(float(line["t"]) - start)
                values.append(float(value))

    def vectors(name: str) -> FloatArray:
        # An absent answer is null; numpy makes it NaN.
        return np.array([row[name] for row in rows], float).reshape(len(rows), len(joints))

    def numbers(name: str) -> FloatArray:
        return np.array([row[name] for row in rows], float)

    return Track(
        person=person,
        robot=str(about["name"]),
        joints=joints,
        times=numbers("t") - start,
        playing=np.array([row["state"] == "PLAY" for row in rows], bool),
        goal=vectors("goal"),
        present=vectors("present"),
        current=vectors("current"),
        late=numbers("late"),
        sent=numbers("sent"),
        temperature={name: (np.array(t), np.array(v)) for name, (t, v) in temperature.items()},
    )


def _words(line: dict[str, Any]) -> str:
    if line["event"] == "state":
        return str(line["state"])
    return f"{line['event']}: {line['error']}" if "error" in line else str(line["event"])


def _outcome(lines: Sequence[dict[str, Any]]) -> str:
    for line in lines:
        if line.get("event") == "fault":
            return f"{line.get('type', 'BusError')}: {line['error']}"
    return BROKEN_OFF


def _performance(
    tracks: Sequence[Track], ticks: list[Tick], rate: float, outcome: str
) -> Performance:
    first = tracks[0]
    playing = first.playing
    times, late = first.times[playing], first.late[playing]
    sent = np.array([each.sent[playing] for each in tracks])
    stretch = np.array([number for number, _ in ticks], int)[playing]
    gaps = np.rint(np.diff(times) * rate).astype(int) - 1
    dropped = int(gaps[np.diff(stretch) == 0].clip(0).sum()) if len(times) > 1 else 0
    return Performance(
        completed=outcome == "completed",
        outcome=outcome,
        duration=float(times[-1] - times[0]) if len(times) else 0.0,
        rate=rate,
        ticks=len(times),
        late_ticks=int((late > LATE_SHARE / rate).sum()),
        dropped_ticks=dropped,
        jitter_p99_ms=_p99(late),
        skew_p99_ms=_p99(sent.max(axis=0) - sent.min(axis=0)) if len(times) else 0.0,
        tracking={
            each.person: track(
                each.robot, each.joints, times, each.goal[playing], each.present[playing]
            )
            for each in tracks
        },
    )


def _p99(values: FloatArray) -> float:
    kept = values[np.isfinite(values)]
    return float(np.percentile(kept, 99)) * 1e3 if len(kept) else math.nan
