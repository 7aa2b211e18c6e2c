"""What happened, line by line as it happens, and the summary of it.

The file is JSON lines: one ``header``, then one ``tick`` per tick and robot and an ``event`` for
whatever changes, at the end one ``summary``. Each line is handed to the system as soon as it is
complete, so a crash loses nothing but what had not happened yet.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from bridge.servo.state import ServoState
from robots.errors import MotionFileError
from robots.files import plain
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

SCHEMA = "pasdedeux.telemetry/1"
DIGITS = 5
"""Decimals of angles and times: 10 microradians, 10 microseconds."""
MAX_LAG = 0.5
"""Largest lag that is looked for, s."""


class Telemetry:
    """Writes the file; without a path it writes nothing and costs nothing."""

    def __init__(self, path: str | Path | None) -> None:
        """Name the file; it is made on entering."""
        self._path = path
        self._file: IO[str] | None = None
        self._moved = False

    def __enter__(self) -> Telemetry:
        """Make the file.

        Raises:
            MotionFileError: It cannot be made.
        """
        if self._path is not None:
            try:
                Path(self._path).parent.mkdir(parents=True, exist_ok=True)
                # Line buffering: every line reaches the system at once.
                self._file = open(self._path, "w", buffering=1, encoding="utf-8")
            except OSError as error:
                raise MotionFileError(
                    f"cannot be written: {error.strerror}", where=str(self._path)
                ) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file; if nothing moved before an error, leave none behind."""
        if self._file is None:
            return
        self._file.close()
        if error is not None and not self._moved and self._path is not None:
            Path(self._path).unlink(missing_ok=True)

    def header(self, values: Mapping[str, Any]) -> None:
        """Write the first line."""
        self._line({"kind": "header", "schema": SCHEMA, **values})

    def event(self, time: float, name: str, **values: Any) -> None:
        """Write that something happened at ``time`` s."""
        self._line({"kind": "event", "t": _round(time), "event": name, **values})

    def tick(
        self,
        time: float,
        *,
        robot: str,
        state: str,
        phase: float,
        goal: FloatArray,
        servos: ServoState,
        late: float,
        sent: float,
    ) -> None:
        """Write what one robot was asked and did.

        Args:
            time: Scheduled time of the tick, s.
            robot: ``a`` or ``b``.
            state: State of the player.
            phase: Phase of the path, s.
            goal: ``[D]`` rad.
            servos: What came back.
            late: How long after the schedule the tick began, s.
            sent: How long after the schedule this robot's goals were on their way, s.
        """
        if self._file is None:
            return
        self._moved = True
        self._line(
            {
                "kind": "tick",
                "t": _round(time),
                "robot": robot,
                "state": state,
                "phase": _round(phase),
                "goal": _list(goal),
                "present": _list(servos.position),
                "error": _list(goal - servos.position),
                "current": _list(servos.current),
                "late": _round(late),
                "sent": _round(sent),
                "read": _round(servos.time - time),
            }
        )

    def summary(self, performance: Performance) -> None:
        """Write the last line."""
        self._line({"kind": "summary", **performance.to_json()})

    def _line(self, value: Mapping[str, Any]) -> None:
        if self._file is None:
            return
        try:
            self._file.write(json.dumps(value, allow_nan=False, separators=(",", ":")) + "\n")
        except OSError as error:
            # A full disk must not make two robots fall over; the dance goes on unrecorded.
            log.error("%s: telemetry ends here: %s", self._path, error.strerror or error)
            self._file = None


def _round(value: float) -> float | None:
    return round(value, DIGITS) if math.isfinite(value) else None


def _list(values: FloatArray) -> list[float | None]:
    if np.isfinite(values).all():
        return np.round(values, DIGITS).tolist()
    return [_round(float(value)) for value in values]


def read_telemetry(path: str | Path) -> list[dict[str, Any]]:
    """Return the lines of a telemetry file; a line that a crash cut off at the end is left out.

    Raises:
        MotionFileError: It cannot be read, or a line before the last is damaged.
    """
    try:
        lines = Path(path).read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MotionFileError(f"cannot be read: {error}", where=str(path)) from error
    values: list[dict[str, Any]] = []
    for number, line in enumerate(lines, 1):
        try:
            values.append(json.loads(line))
        except ValueError as error:
            if number == len(lines):
                break
            raise MotionFileError("is damaged", where=f"{path}:{number}") from error
    return values


@dataclass(frozen=True, slots=True)
class Tracking:
    """How one robot followed its goals while it performed."""

    robot: str
    """Name of the robot."""
    rms_deg: float
    """Root mean square of present minus goal over all joints and ticks, degrees."""
    max_deg: float
    """Largest difference, degrees."""
    worst_joint: str
    """Joint of :attr:`max_deg`."""
    lag_ms: float
    """Delay of present behind goal that explains most of the difference, ms."""
    rms_without_lag_deg: float
    """What is left of :attr:`rms_deg` after shifting by the lag, degrees."""
    missed_reads: int
    """Answers of single servos that did not come."""


@dataclass(frozen=True, slots=True)
class Performance:
    """Summary of a performance."""

    completed: bool
    """Whether it was played to the end."""
    outcome: str
    """``completed``, ``stopped`` or the error that ended it."""
    duration: float
    """s, from the first to the last tick of the dance itself."""
    rate: float
    """Ticks per second that were asked for."""
    ticks: int
    """Ticks of the dance."""
    late_ticks: int
    """Ticks that began more than a quarter of a period after their time."""
    dropped_ticks: int
    """Ticks left out because the one before took too long."""
    jitter_p99_ms: float
    """99th percentile of how late ticks began, ms."""
    skew_p99_ms: float
    """99th percentile of the time between the two robots' commands, ms."""
    tracking: dict[str, Tracking] = field(default_factory=dict)
    """By person."""

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values; not-a-number becomes ``None``."""
        return plain(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Performance:
        """Return what :meth:`to_json` told of.

        Raises:
            TypeError: It is something else.
        """
        numbers = _known(values)
        numbers["tracking"] = {p: Tracking(**_known(t)) for p, t in values["tracking"].items()}
        return cls(**numbers)


def _known(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return JSON values with not-a-number where they say ``None``."""
    return {name: math.nan if value is None else value for name, value in values.items()}


def track(
    robot: str,
    joint_names: Sequence[str],
    times: FloatArray,
    goal: FloatArray,
    present: FloatArray,
) -> Tracking:
    """Measure how a robot followed.

    The lag is the shift of the goals that leaves the least squared difference to what was measured,
    on a grid of 1 ms: the peak of the cross-correlation, for signals of limited length.

    Args:
        robot: Name.
        joint_names: Names of the D joints.
        times: ``[N]`` s, when the goals were sent.
        goal: ``[N, D]`` rad.
        present: ``[N, D]`` rad, NaN where a servo did not answer.
    """
    seen = np.isfinite(present)
    missed = int((~seen).sum())
    if len(times) < 2 or not seen.any():
        nan = math.nan
        return Tracking(robot, nan, nan, "", nan, nan, missed)
    error = np.where(seen, present - goal, 0.0)
    worst = int(np.abs(error).max(axis=0).argmax())
    lag, left = _lag(times, goal, present, seen)
    return Tracking(
        robot=robot,
        rms_deg=math.degrees(math.sqrt(float((error**2).sum() / seen.sum()))),
        max_deg=math.degrees(float(np.abs(error).max())),
        worst_joint=joint_names[worst],
        lag_ms=lag * 1e3,
        rms_without_lag_deg=math.degrees(left),
        missed_reads=missed,
    )


def _lag(
    times: FloatArray, goal: FloatArray, present: FloatArray, seen: np.ndarray
) -> tuple[float, float]:
    """Return (lag s, root mean square difference rad that is left)."""
    longest = min(MAX_LAG, (times[-1] - times[0]) / 2)
    fair = times >= times[0] + longest
    weight = seen[fair]
    if not weight.any():
        return math.nan, math.nan
    target = np.where(seen, present, 0.0)[fair]

    def cost(lag: float) -> float:
        shifted = [np.interp(times[fair] - lag, times, column) for column in goal.T]
        return float((((target - np.column_stack(shifted)) ** 2) * weight).sum() / weight.sum())

    coarse = min(np.arange(0.0, longest + 1e-9, 0.01), key=cost)
    fine = min(np.arange(max(0.0, coarse - 0.01), coarse + 0.0101, 0.001), key=cost)
    return float(fine), math.sqrt(cost(fine))
