"""The verdict on a duet: named numbers with units and thresholds, and one score."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from robots.errors import MotionFileError
from robots.files import write_json

SCHEMA = "pasdedeux.report/1"
_MAX_BYTES = 4 * 2**20


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """One number about a duet."""

    name: str
    """What it is called, e.g. ``mpjpe_global``."""
    of: Literal["reference", "simulated"]
    """Whether it is about the motion that was asked for or about what physics made of it."""
    person: Literal["a", "b", "both"]
    """Whom it is about."""
    value: float
    """In :attr:`unit`."""
    unit: str
    """``mm``, ``m/s``, ``%`` and so on."""
    definition: str
    """What the number says, in one line."""
    threshold: float | None = None
    """The gate: the value must not be worse than this. ``None`` if it does not decide."""
    sense: Literal["max", "min"] = "max"
    """Whether the threshold is the most or the least that passes."""
    worst_time: float | None = None
    """When it is worst, s."""

    @property
    def passed(self) -> bool:
        """Whether the gate lets it pass."""
        if self.threshold is None:
            return True
        if self.sense == "max":
            return self.value <= self.threshold
        return self.value >= self.threshold

    @property
    def limit(self) -> str:
        """The threshold with its sense, for people; empty without."""
        if self.threshold is None:
            return ""
        return f"{'≤' if self.sense == 'max' else '≥'} {self.threshold:g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """All numbers about a duet, and whether two robots should perform it."""

    kind: Literal["tracked", "kinematic"]
    """Whether physics was asked, or only the motion looked at."""
    score: float
    """0 (absurd) to 100 (faultless); see :mod:`sim.score`."""
    metrics: tuple[Metric, ...]
    """The numbers."""
    text: str
    """Sentence of the motion."""
    licence: str
    """Licence of the motion."""
    duration: float
    """s."""
    input_sha256: str
    """Hash of the motion (:func:`sim.rollout.motion_sha256`)."""
    versions: dict[str, str] = field(default_factory=dict)
    """Software that made it."""
    gate: dict[str, float] = field(default_factory=dict)
    """Thresholds in force."""

    @property
    def passed(self) -> bool:
        """Whether metrics with a threshold are there, and every one passes."""
        judged = [m for m in self.metrics if m.threshold is not None]
        return bool(judged) and all(m.passed for m in judged)

    @property
    def failures(self) -> tuple[str, ...]:
        """One line for every metric that does not pass, or one that says that none was judged."""
        if all(m.threshold is None for m in self.metrics):
            return ("nothing in it was judged: no metric has a threshold",)
        return tuple(
            f"{m.name} of {'the ' if m.person == 'both' else ''}{m.of}"
            f"{'' if m.person == 'both' else ' ' + m.person}: {m.value:.4g} {m.unit}"
            f" ({m.limit})" + (f" at {m.worst_time:.2f} s" if m.worst_time is not None else "")
            for m in self.metrics
            if not m.passed
        )

    def get(self, name: str, person: str | None = None, of: str = "simulated") -> float:
        """Return a metric's value; the worse of both people if no person is named.

        Raises:
            KeyError: There is no such metric.
        """
        found = [
            m for m in self.metrics if m.name == name and m.of == of and person in (None, m.person)
        ]
        if not found:
            raise KeyError(f"{name} of {of} {person or ''}".strip())
        values = [m.value for m in found]
        return max(values) if found[0].sense == "max" else min(values)

    def rows(self) -> list[tuple[str, str, str, str, str, str]]:
        """Return name, of, person, value with unit, threshold and mark of every metric, as text.

        The mark is ``ok`` or ``FAIL``; empty for metrics that do not decide.
        """
        return [
            (
                m.name,
                m.of,
                m.person,
                f"{m.value:.3g} {m.unit}".strip(),
                m.limit,
                "" if m.threshold is None else "ok" if m.passed else "FAIL",
            )
            for m in self.metrics
        ]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON: all fields, and ``passed``, here and per metric."""
        out = asdict(self)
        out["metrics"] = [{**asdict(m), "passed": m.passed} for m in self.metrics]
        return {"schema": SCHEMA, "passed": self.passed, **out}

    @classmethod
    def from_json(cls, data: dict[str, Any], *, where: str = "report") -> Report:
        """Return the report that :meth:`to_json` described.

        Raises:
            MotionFileError: It is not one.
        """
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            raise MotionFileError("this is not a report", where=where, hint="make one with 'score'")
        try:
            metrics = tuple(_metric(m) for m in data["metrics"])
            rest = {f.name: data[f.name] for f in fields(cls) if f.name != "metrics"}
            report = cls(metrics=metrics, **rest)
            numbers = [report.score, report.duration, *(m.value for m in metrics)]
            if not all(math.isfinite(float(n)) for n in numbers):
                raise ValueError("a number is not finite")
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise MotionFileError(f"incomplete report: {error!r}", where=where) from error
        if data.get("passed") is not report.passed:
            raise MotionFileError(
                "says it passed or failed against its own numbers",
                where=where,
                hint="make it anew with 'score'",
            )
        return report

    def save(self, path: str | Path) -> None:
        """Write as JSON.

        Raises:
            MotionFileError: The file cannot be written.
        """
        write_json(path, self.to_json())

    @classmethod
    def load(cls, path: str | Path) -> Report:
        """Read what :meth:`save` wrote.

        Raises:
            MotionFileError: The file is not a report.
        """
        where = str(path)
        try:
            with open(path, "rb") as file:
                data = file.read(_MAX_BYTES + 1)
        except OSError as error:
            raise MotionFileError(
                f"cannot be read: {error.strerror or error}", where=where
            ) from error
        if len(data) > _MAX_BYTES:
            raise MotionFileError("is too large for a report", where=where)
        try:
            return cls.from_json(json.loads(data), where=where)
        except (ValueError, RecursionError) as error:
            raise MotionFileError("is not valid JSON", where=where) from error


def _metric(data: dict[str, Any]) -> Metric:
    made = Metric(**{f.name: data[f.name] for f in fields(Metric)})
    allowed = made.of in ("reference", "simulated") and made.person in ("a", "b", "both")
    if not allowed or made.sense not in ("max", "min"):
        raise ValueError(f"metric {made.name!r}")
    numbers = [made.value, *(n for n in (made.threshold, made.worst_time) if n is not None)]
    if not all(isinstance(n, (int, float)) and not isinstance(n, bool) for n in numbers):
        raise TypeError(f"metric {made.name!r}")
    return made
