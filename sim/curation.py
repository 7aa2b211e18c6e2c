"""Physics in the loop of the training data: clips that it repairs or rejects.

**The problem.** What the choreographer invents obeys no physics: weight may be borne by nothing,
a hand may pass through an arm, a step may come too fast. A model that learns from it learns that
too. So every clip is given to two simulated people (:func:`sim.track.track`), and what they did,
not what was asked of them, is what is learnt from, if the report's gate lets it pass. Each verdict
is a file of its own (:mod:`generator.data.verdict`), written when all else of the clip is on disk:
however the work is ended, the next call goes on, and a clip whose process died is tried again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from generator.choreographer import SOURCE, repertoire
from generator.data.verdict import Curation, Verdict
from generator.io import write_motion
from generator.motion import CONTACT_POINTS, DuetMotion
from robots.errors import DuetError, MotionError
from robots.files import plain
from sim.batch import Lost, cores, in_processes
from sim.controllers.ilqr.settings import QUALITIES
from sim.footing import standing
from sim.gate import Gate
from sim.outcome import Cost, versions
from sim.report import Report
from sim.score import score
from sim.track import TrackSettings, track

FIGURES = {
    "penetration_p95": "mm",
    "penetration_max": "mm",
    "floor_penetration_p95": "mm",
    "float_mean": "mm",
    "slide_ratio": "% time",
    "slide_speed": "m/s",
    "skate_ratio": "% time",
}
"""Metrics of a report that a verdict keeps, before and after, of the worse person; their units."""
SIMULATED = ("mpjpe_global", "acceleration_error", "assist_max")
"""Those that it keeps of what was simulated alone."""

Progress = Callable[[float], None]
"""Takes the share of the clips that is done, 0 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CurationSettings:
    """How clips are judged."""

    tracking: TrackSettings = field(
        default_factory=lambda: TrackSettings(ilqr=replace(QUALITIES["preview"], threads=1))
    )
    """How the people are simulated; on one thread, since all cores have a clip."""
    gate: Gate = field(default_factory=Gate)
    """What is still plausible."""

    @property
    def made_with(self) -> dict[str, Any]:
        """Everything that a verdict depends on beside the clip's number, as plain JSON."""
        return {
            "settings": plain(self.tracking),
            "gate": plain(self.gate),
            "versions": versions(),
            "choreographer": SOURCE,
        }


@dataclass(frozen=True, slots=True)
class Item:
    """A clip to judge."""

    curation: Curation
    """Where it comes from and its verdict goes."""
    number: int
    """Which of its clips."""


def in_order(curations: Sequence[Curation]) -> list[Item]:
    """Return every clip once, in an order of which any beginning is spread over interactions.

    A source has every interaction in turn. Its rounds follow one another, those of all sources side
    by side, and within a round the interactions are shuffled, always in the same way.
    """
    round_length = len(repertoire())
    place = np.random.default_rng(0).permutation(round_length)
    found: dict[Path, tuple[tuple[int, int, int], Item]] = {}
    for which, curation in enumerate(curations):
        for number in range(curation.count):
            turn, at = divmod(number, round_length)
            key = turn, which, int(place[at])
            found.setdefault(curation.verdict_file(number), (key, Item(curation, number)))
    return [item for _, item in sorted(found.values(), key=lambda entry: entry[0])]


def curate(
    items: Sequence[Item],
    settings: CurationSettings,
    *,
    jobs: int | None = None,
    progress: Progress = lambda _: None,
) -> list[tuple[Item, Verdict | Lost]]:
    """Judge clips and return what came of each, in the given order.

    A clip that has a verdict by the same settings and versions is not judged again. One whose
    process died, or whose files could not be written, has none and stops no other.

    Args:
        items: What to judge.
        settings: How.
        jobs: Processes at once; one per core if not given.
        progress: Told the share of the clips that are done.
    """
    results: dict[Item, Verdict | Lost] = {}
    work = partial(curate_clip, settings=settings)
    for item, result in in_processes(work, items, min(jobs or cores(), max(1, len(items)))):
        results[item] = result
        progress(len(results) / len(items))
    return [(item, results[item]) for item in items]


def curate_clip(item: Item, *, settings: CurationSettings) -> Verdict:
    """Judge one clip and write the verdict, unless that was done before.

    Raises:
        MotionFileError: A file cannot be written, or what is there is not a verdict.
    """
    curation, number, clips = item.curation, item.number, item.curation.clips
    motion_file, interaction = curation.motion_file(number), clips.interaction(number)
    before = curation.verdict(number)
    if (
        before is not None
        and (before.made_with, before.interaction) == (settings.made_with, interaction)
        and (motion_file.is_file() or not before.kept)
    ):
        return before
    curation.verdict_file(number).unlink(missing_ok=True)
    motion_file.unlink(missing_ok=True)
    start = Cost.now()
    try:
        asked = clips.motion(number)
    except MotionError as error:
        verdict, repaired = _rejected("spoilt", error, interaction), None
    else:
        verdict, repaired = judge(asked, settings)
    cpu = Cost.now().since(start).cpu
    verdict = replace(verdict, cpu_s=cpu, made_with=settings.made_with)
    if repaired is not None:
        write_motion(repaired, motion_file)
    verdict.save(curation.verdict_file(number))
    return verdict


def judge(asked: DuetMotion, settings: CurationSettings) -> tuple[Verdict, DuetMotion | None]:
    """Return the verdict on a motion, and if it is kept, what two simulated people made of it."""
    try:
        rollout = track(asked, settings=settings.tracking)
        report = score(rollout, settings.gate)
    except DuetError as error:
        return _rejected("impossible", error, asked.interaction, asked.text), None
    verdict = Verdict(
        kept=report.passed,
        interaction=asked.interaction,
        text=asked.text,
        reasons=tuple(dict.fromkeys(m.name for m in report.metrics if not m.passed)),
        why=report.failures,
        figures=_figures(report),
    )
    if not report.passed:
        return verdict, None
    repaired = labelled(rollout.as_motion(), asked)
    off = np.linalg.norm(repaired.keypoints - asked.keypoints, axis=-1)
    return replace(verdict, changed_mm=float(off.mean()) * 1000), repaired


def labelled(made: DuetMotion, asked: DuetMotion) -> DuetMotion:
    """Return a motion with the foot contacts of the one that was asked for, where feet do stand.

    Physics lets a standing foot give way by millimetres, so the labels hold, except where a foot
    had to step or slide to keep the balance: there it is neither low nor still.
    """
    people = []
    for person, wanted in zip(made.people, asked.people, strict=True):
        contacts = wanted.foot_contacts
        if contacts is not None:
            still = [standing(person.point(name), made.fps) for name in CONTACT_POINTS]
            contacts = contacts & np.stack(still, axis=1)
        people.append(replace(person, foot_contacts=contacts))
    return replace(made, a=people[0], b=people[1])


def summary(results: Sequence[tuple[Item, Verdict | Lost]]) -> dict[str, Any]:
    """Return how curating went, as plain JSON: in total, and for each interaction."""
    verdicts = [verdict for _, verdict in results if isinstance(verdict, Verdict)]
    names = sorted({verdict.interaction for verdict in verdicts})
    rejected = [verdict for verdict in verdicts if not verdict.kept]
    reasons = Counter(reason for verdict in rejected for reason in verdict.reasons)
    return {
        **_totals(verdicts),
        "lost": [
            {"clip": str(item.curation.verdict_file(item.number)), "why": result.why}
            for item, result in results
            if isinstance(result, Lost)
        ],
        "reasons": dict(reasons.most_common()),
        "figures": _means([verdict.figures for verdict in verdicts if verdict.kept]),
        "interactions": {
            name: _totals([v for v in verdicts if v.interaction == name]) for name in names
        },
    }


def _totals(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    changes = [v.changed_mm for v in verdicts if v.changed_mm is not None]
    kept = sum(v.kept for v in verdicts)
    return {
        "kept": kept,
        "rejected": len(verdicts) - kept,
        "changed_mm": float(np.mean(changes)) if changes else None,
        "cpu_s_per_clip": float(np.mean([v.cpu_s for v in verdicts])) if verdicts else None,
    }


def _means(figures: Sequence[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Return the means over clips of every figure, of those clips that have it."""
    gathered: dict[str, dict[str, list[float]]] = {}
    for clip in figures:
        for of, values in clip.items():
            for name, value in values.items():
                gathered.setdefault(of, {}).setdefault(name, []).append(value)
    return {
        of: {name: float(np.mean(found)) for name, found in values.items()}
        for of, values in gathered.items()
    }


def _figures(report: Report) -> dict[str, dict[str, float]]:
    wanted = {"reference": FIGURES, "simulated": (*FIGURES, *SIMULATED)}
    return {of: {name: report.get(name, of=of) for name in names} for of, names in wanted.items()}


def _rejected(reason: str, error: DuetError, interaction: str, text: str = "") -> Verdict:
    return Verdict(
        kept=False, interaction=interaction, text=text, reasons=(reason,), why=(str(error),)
    )
