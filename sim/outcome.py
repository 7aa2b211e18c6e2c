"""How tracking a duet went, in the figures that two-person trackers are compared by.

A :class:`~sim.report.Report` asks whether a duet may be performed; an outcome says what tracking it
was like, and what it cost.
"""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.motion import DuetMotion
from robots.files import plain, write_json
from sim.metrics import contact, effort, ground, tracking
from sim.metrics.penetration import overlap
from sim.rollout import Rollout, motion_sha256
from sim.scene import PEOPLE
from sim.track import TrackSettings

SCHEMA = "pasdedeux.outcome/1"
_MAX_BYTES = 4 * 2**20

PerPerson = dict[str, float]
"""A figure for ``a`` and one for ``b``."""
BeforeAfter = dict[str, float]
"""A figure for the ``reference`` as it was given, and one for what was ``simulated``."""


@dataclass(frozen=True, slots=True)
class Cost:
    """What some work took."""

    cpu: float
    """Processor time of all threads of this process, s."""
    wall: float
    """s"""

    @classmethod
    def now(cls) -> Cost:
        """Return the readings of both clocks; the difference of two is a cost."""
        return cls(time.process_time(), time.perf_counter())

    def since(self, start: Cost) -> Cost:
        """Return what was spent between two readings."""
        return Cost(self.cpu - start.cpu, self.wall - start.wall)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOutcome:
    """How tracking went; errors, recall and penetration are over the part that was simulated."""

    success: bool
    """Whether the whole motion was simulated and nobody fell."""
    fell: dict[str, bool]
    """Whether each person's keypoints were ever more than 0.5 m off on average."""
    fall_time_s: dict[str, float | None]
    """When that began."""
    finished: bool
    """Whether the whole motion was simulated."""
    ended_because: str | None
    """Why it was not, and when."""
    duration_s: float
    """Of the motion."""
    simulated_s: float
    """Of the part that was simulated."""
    mpjpe_global_mm: PerPerson
    """Mean distance of keypoints from those of the motion."""
    mpjpe_root_mm: PerPerson
    """The same with the pelvises put together."""
    accel_error_mm_per_frame2: PerPerson
    """Mean error of keypoint accelerations; a frame is 1/30 s."""
    max_mean_error_m: PerPerson
    """Largest distance of keypoints from those of the motion, mean over keypoints."""
    assist_max_bodyweight: float
    """Largest force that a helping hand gave, body weights."""
    torque_over_limit_percent: PerPerson
    """Share of the time in which some joint works beyond its limit."""
    penetration_max_mm: BeforeAfter
    """Deepest that the people are in each other."""
    penetration_p95_mm: BeforeAfter
    """The same in 95 % of the time."""
    floor_penetration_p95_mm: PerPerson
    """Depth of each simulated person below the floor in 95 % of the time."""
    contact_recall: float | None
    """Share, 0 to 1, of wanted touches that happen within 5 cm; ``None`` if none was wanted."""
    recoveries: int
    """How often the controller went back and tried again; the rollout's metadata says where."""
    repairs: dict[str, Any]
    """What was changed in the motion before control."""
    least_assist: dict[str, Any] | None
    """The least help with which the motion can be tracked, if that was asked for."""
    cpu_seconds_per_second: float
    """Processor time per simulated second, of everything from the motion to the rollout."""
    wall_seconds_per_second: float
    """The same by the clock."""
    controller: str
    """Who moved the joints."""
    seed: int
    """Of the controller."""
    settings: dict[str, Any]
    """How it was tracked; :class:`sim.track.TrackSettings`."""
    input_sha256: str
    """Hash of the motion (:func:`sim.rollout.motion_sha256`)."""
    mujoco_version: str
    """Of the physics."""
    versions: dict[str, str]
    """Of this project and of what else the numbers depend on."""

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON without NaN."""
        return {"schema": SCHEMA, **plain(asdict(self))}

    def save(self, path: str | Path) -> None:
        """Write as JSON.

        Raises:
            MotionFileError: The file cannot be written.
        """
        write_json(path, self.to_json())


def outcome(
    rollout: Rollout, cost: Cost, *, least_assist: dict[str, Any] | None = None
) -> TrackOutcome:
    """Return how the tracking that made a rollout went.

    Args:
        rollout: What :func:`sim.track.track` returned.
        cost: What that took.
        least_assist: What :func:`sim.least_assist.least_assist` found, as plain JSON.

    Raises:
        SpecError: The rollout's scene is not one of this project.
    """
    info, seconds, scene = rollout.metadata, float(rollout.times[-1]), rollout.scene()
    keypoints, reference = rollout.keypoints, rollout.reference
    made, asked = overlap(scene, rollout.qpos), overlap(scene, rollout.as_given(scene))
    ended = rollout.ended
    over_limit = effort.effort_ratio(rollout.torque, rollout.bodies) > 1
    return TrackOutcome(
        success=ended is None and not any(rollout.fell.values()),
        fell=rollout.fell,
        fall_time_s=rollout.fall_time,
        finished=ended is None,
        ended_because=None if ended is None else ended["why"],
        duration_s=float(info.get("duration_s", seconds)),
        simulated_s=seconds,
        mpjpe_global_mm=_people(tracking.mpjpe(keypoints, reference) * 1000),
        mpjpe_root_mm=_people(tracking.mpjpe_root(keypoints, reference) * 1000),
        accel_error_mm_per_frame2=_people(
            tracking.acceleration_error(keypoints, reference, rollout.rate) * 1000
        ),
        max_mean_error_m={person: float(rollout.error[:, p].max()) for p, person in _NUMBERED},
        assist_max_bodyweight=float(effort.force_share(rollout.assist, rollout.bodies).max()),
        torque_over_limit_percent=_people(over_limit * 100.0),
        penetration_max_mm={
            "reference": float(asked.depth.max()) * 1000,
            "simulated": float(made.depth.max()) * 1000,
        },
        penetration_p95_mm={"reference": _p95_mm(asked.depth), "simulated": _p95_mm(made.depth)},
        floor_penetration_p95_mm={
            person: _p95_mm(ground.floor_penetration(made.lowest)[:, p]) for p, person in _NUMBERED
        },
        contact_recall=_recall(rollout),
        recoveries=len(info.get("recoveries", ())),
        repairs=dict(info.get("repairs", {})),
        least_assist=least_assist,
        cpu_seconds_per_second=cost.cpu / seconds,
        wall_seconds_per_second=cost.wall / seconds,
        controller=str(info.get("controller", "")),
        seed=int(info.get("settings", {}).get("seed", 0)),
        settings=dict(info.get("settings", {})),
        input_sha256=str(info.get("input_sha256", "")),
        mujoco_version=str(info.get("mujoco_version", "")),
        versions=versions(),
    )


def recorded(path: str | Path) -> dict[str, Any] | None:
    """Return the JSON that :meth:`TrackOutcome.save` wrote; ``None`` if there is none at a path."""
    try:
        with open(path, "rb") as file:
            data = json.loads(file.read(_MAX_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and data.get("schema") == SCHEMA else None


def is_of(record: dict[str, Any], motion: DuetMotion, settings: TrackSettings) -> bool:
    """Return whether a record is of the same motion, settings and versions."""
    return (
        record.get("input_sha256") == motion_sha256(motion)
        and record.get("settings") == plain(settings)
        and record.get("versions") == versions()
    )


def versions() -> dict[str, str]:
    """Return the versions of what a rollout depends on."""
    return {name: metadata.version(name) for name in ("pasdedeux", "mujoco", "numpy", "scipy")}


_NUMBERED = tuple(enumerate(PEOPLE))


def _people(series: NDArray) -> PerPerson:
    """Return the means of ``series [N, 2]``."""
    return {person: float(series[:, p].mean()) for p, person in _NUMBERED}


def _p95_mm(depth: NDArray) -> float:
    return float(np.percentile(depth, 95)) * 1000


def _recall(rollout: Rollout) -> float | None:
    a, b = rollout.bodies
    wanted, met = contact.wanted_and_met(
        rollout.times,
        rollout.keypoints,
        rollout.reference,
        (a.skeleton, b.skeleton),
        rollout.contacts,
    )
    return float((wanted & met).sum() / wanted.sum()) if wanted.any() else None
