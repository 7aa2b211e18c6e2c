"""What two robots did, read back from a telemetry file as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bridge.player.telemetry import SCHEMA, read_telemetry
from robots.errors import MotionFileError
from robots.skeleton import FloatArray

PEOPLE = ("a", "b")
DANCING = "PLAY"
"""State with which a recording begins: what comes before only leads to the first pose."""


@dataclass(frozen=True, slots=True)
class Puppeteered:
    """One robot's share of a recording."""

    robot: str
    """Name of the robot."""
    joint_names: tuple[str, ...]
    """Names of the D columns."""
    goal: FloatArray
    """``[N, D]`` rad, as commanded."""
    present: FloatArray
    """``[N, D]`` rad, as the servos answered; NaN where one did not."""

    @property
    def filled(self) -> FloatArray:
        """:attr:`present` with gaps bridged straight; a servo that never answered is at goal."""
        whole = self.present.copy()
        for column, goal in zip(whole.T, self.goal.T, strict=True):
            seen = np.isfinite(column)
            if not seen.any():
                column[:] = goal
            elif not seen.all():
                index = np.arange(len(column))
                column[~seen] = np.interp(index[~seen], index[seen], column[seen])
        return whole


@dataclass(frozen=True, slots=True)
class Recording:
    """The dance of two robots from its first tick on, with whatever followed it."""

    times: FloatArray
    """``[N]`` s from the first tick, strictly increasing. Ticks that were left out are not here."""
    phase: FloatArray
    """``[N]`` s, where on the path the robots were to be."""
    people: tuple[Puppeteered, Puppeteered]
    """Of a and b."""

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Read a telemetry file, of a performance that was cut short too.

        Raises:
            MotionFileError: It cannot be read, is none, or the robots never danced.
        """
        lines = read_telemetry(path)
        try:
            return cls._of(lines, str(path))
        except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
            raise MotionFileError(f"is damaged: {error!r}", where=str(path)) from error

    @classmethod
    def _of(cls, lines: Sequence[Mapping[str, Any]], where: str) -> Recording:
        if not lines or lines[0].get("schema") != SCHEMA:
            raise MotionFileError("is not a telemetry file", where=where, allowed=SCHEMA)
        ticks = {person: _ticks(lines, person) for person in PEOPLE}
        times = sorted(ticks["a"].keys() & ticks["b"].keys())
        if len(times) < 2:
            raise MotionFileError(
                "the robots did not dance",
                where=where,
                hint="look at the events in the file for what stopped them",
            )
        robots = lines[0]["robots"]
        a, b = (
            Puppeteered(
                str(robots[person]["name"]),
                tuple(map(str, robots[person]["joints"])),
                *(_column(ticks[person], times, name) for name in ("goal", "present")),
            )
            for person in PEOPLE
        )
        for one in (a, b):
            if one.goal.shape != (len(times), len(one.joint_names)):
                raise ValueError("goals do not fit the joints")
            if one.present.shape != one.goal.shape or not np.isfinite(one.goal).all():
                raise ValueError("angles do not fit the joints")
        phase = np.array([ticks["a"][time]["phase"] for time in times], float)
        return cls(np.array(times) - times[0], phase, (a, b))


def _ticks(lines: Sequence[Mapping[str, Any]], person: str) -> dict[float, Mapping[str, Any]]:
    """Return the ticks of a robot by time, from the first of the dance on."""
    ticks = [line for line in lines if line["kind"] == "tick" and line["robot"] == person]
    dance = [index for index, tick in enumerate(ticks) if tick["state"] == DANCING]
    return {float(tick["t"]): tick for tick in ticks[dance[0] :]} if dance else {}


def _column(ticks: Mapping[float, Mapping[str, Any]], times: Sequence[float], name: str) -> Any:
    return np.array([ticks[time][name] for time in times], dtype=float)
