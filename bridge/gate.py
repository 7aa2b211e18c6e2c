"""Whether two trajectory files may be performed: what was judged must be what will be played.

**The problem.** A report speaks of a motion, and servos are sent trajectories; a trajectory that
merely claims to come from that motion proves nothing. So the chain is checked link by link::

    report.json        input_sha256  ==  motion_sha256  of both trajectories
    retargeting.json   sha256 by person  ==  hash of the trajectory's names, times and positions

The second file is written by ``retarget`` beside the trajectories. A sample changed afterwards, or
files of two retargetings mixed up, break the chain. It guards against accidents, not against
somebody who rewrites all files.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robots.errors import GateRefused

if TYPE_CHECKING:
    from bridge.trajectory import JointTrajectory

RETARGETING = "retargeting.json"
"""File beside the trajectories that vouches for them."""
PEOPLE = ("a", "b")
AGAIN = "run 'pasdedeux retarget' again, and do not change its files"


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is known about a performance before it begins."""

    passed: bool
    """Whether it is plausible."""
    overlap_mm: float = 0.0
    """How deep these two robots would be in each other, mm."""


def vouch(trajectories: Sequence[JointTrajectory]) -> dict[str, Any]:
    """Return what ``retargeting.json`` says so that :func:`verdict` knows the trajectories."""
    hashes = zip(PEOPLE, trajectories, strict=True)
    return {"trajectories": {person: track.content_sha256 for person, track in hashes}}


def verdict(
    report: Path | None, paths: Sequence[Path], trajectories: Sequence[JointTrajectory]
) -> Verdict:
    """Return whether a report lets these trajectories pass.

    Args:
        report: The report on their motion; without one they do not pass.
        paths: Files of a's and b's trajectory.
        trajectories: What was read from them.

    Raises:
        GateRefused: The report speaks of another motion, or a trajectory is not what was written
            when the motion was retargeted.
    """
    from sim.report import Report

    if report is None:
        return Verdict(passed=False)
    judged = Report.load(report)
    overlap = 0.0
    for person, path, trajectory in zip(PEOPLE, paths, trajectories, strict=True):
        if trajectory.metadata.get("motion_sha256") != judged.input_sha256:
            raise GateRefused(
                "the report speaks of another motion than the trajectories",
                where=str(report),
                hint="score the rollout of the same motion",
            )
        record = path.with_name(RETARGETING)
        facts = _read(record)
        hashes = facts.get("trajectories")
        if not isinstance(hashes, dict) or person not in hashes:
            raise GateRefused(
                f"says nothing about the trajectory of {person}", where=str(record), hint=AGAIN
            )
        if hashes[person] != trajectory.content_sha256:
            raise GateRefused(
                f"the trajectory of {person} is not the one that was retargeted: its joints, times"
                f" or positions differ from what {RETARGETING} vouches for",
                where=str(path),
                hint=AGAIN,
            )
        overlap = max(overlap, _number(facts.get("penetration_max_mm")))
    return Verdict(passed=judged.passed, overlap_mm=overlap)


def _number(value: object) -> float:
    """Return a figure of the file; what is no number counts as the worst."""
    return float(value) if isinstance(value, int | float) else float("inf")


def _read(record: Path) -> dict[str, Any]:
    try:
        facts = json.loads(record.read_text("utf-8"))
    except FileNotFoundError:
        raise GateRefused(
            "is missing, so nothing vouches for the trajectories beside it",
            where=str(record),
            hint=AGAIN,
        ) from None
    except (OSError, ValueError) as error:
        raise GateRefused(f"cannot be read: {error}", where=str(record), hint=AGAIN) from error
    return facts if isinstance(facts, dict) else {}
