"""Collects the metrics of one report from time series."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim.gate import Subject
from sim.report import Metric
from sim.rollout import Rollout

Summary = Literal["mean", "max", "min", "p95"]
"""How a series becomes one value."""
Person = Literal["a", "b"]
PEOPLE: tuple[Person, Person] = ("a", "b")


class Sheet:
    """Collects metrics that share one clock."""

    def __init__(self, times: NDArray) -> None:
        """Start with no metrics; series will have the times ``[N]`` s."""
        self.times = times
        self.metrics: list[Metric] = []

    def people(
        self,
        what: tuple[str, Subject, str, str],
        series: NDArray,
        *,
        summary: Summary = "mean",
        threshold: float | None = None,
    ) -> None:
        """Add a metric per person from ``series [N, 2]``."""
        for p, person in enumerate(PEOPLE):
            self._add(what, person, series[:, p], summary, threshold)

    def both(
        self,
        what: tuple[str, Subject, str, str],
        series: NDArray,
        *,
        summary: Summary = "mean",
        threshold: float | None = None,
    ) -> None:
        """Add a metric of the pair from ``series [N]``."""
        self._add(what, "both", series, summary, threshold)

    def _add(
        self,
        what: tuple[str, Subject, str, str],
        person: Literal["a", "b", "both"],
        series: NDArray,
        summary: Summary,
        threshold: float | None,
    ) -> None:
        name, of, unit, definition = what
        values = np.asarray(series, dtype=float)
        least = summary == "min"
        worst = int(np.argmin(values) if least else np.argmax(values))
        value = {
            "mean": np.mean,
            "max": np.max,
            "min": np.min,
            "p95": lambda x: np.percentile(x, 95),
        }[summary](values)
        self.metrics.append(
            Metric(
                name=name,
                of=of,
                person=person,
                value=float(value),
                unit=unit,
                definition=definition,
                threshold=threshold,
                sense="min" if least else "max",
                worst_time=round(float(self.times[worst]), 4),
            )
        )

    def fall(self, rollout: Rollout) -> None:
        """Add whether each person fell."""
        for person in PEOPLE:
            time = rollout.fall_time[person]
            self.metrics.append(
                Metric(
                    name="fell",
                    of="simulated",
                    person=person,
                    value=float(time is not None),
                    unit="",
                    definition="1 if keypoints were ever more than 0.5 m off on average",
                    threshold=0.0,
                    worst_time=time,
                )
            )

    def ended(self, rollout: Rollout) -> None:
        """Add whether the run ended before the motion did."""
        ended = rollout.ended
        self.metrics.append(
            Metric(
                name="ended_early",
                of="simulated",
                person="both",
                value=float(ended is not None),
                unit="",
                definition="1 if somebody fell for good or the physics diverged",
                threshold=0.0,
                worst_time=None if ended is None else round(ended["time"], 4),
            )
        )
