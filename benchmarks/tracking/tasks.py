"""One measurement: a clip, a controller and its options, tracked in whatever process."""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.tracking.clips import BenchClip, tier
from benchmarks.tracking.figures import ACCELERATION_CLEAN
from benchmarks.tracking.results import Key, Record
from generator.motion import DuetMotion
from robots.errors import DuetError
from robots.files import plain
from sim.metrics.tracking import acceleration_error
from sim.outcome import Cost, outcome
from sim.rollout import Rollout
from sim.track import TrackSettings, track

SCHEMA = "pasdedeux.bench-track/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What to measure; made of plain values, because it travels to another process."""

    clip: BenchClip
    controller: str
    options: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the controller's own settings that differ from the defaults."""
    variant: str = ""
    """Name of these options; empty for the defaults."""
    jobs: int = 1
    """How many processes share the machine."""
    rollouts: Path | None = None
    """Folder for the rollout; ``None`` throws it away."""

    @property
    def settings(self) -> TrackSettings:
        """The controller's defaults, with :attr:`options` in their place.

        Processes side by side have one core each, so that ``ilqr`` plans on one thread then.

        Raises:
            SpecError: There is no such controller, or an option has no sensible value.
        """
        settings = TrackSettings(controller=self.controller)
        if self.jobs > 1:
            settings = replace(settings, ilqr=replace(settings.ilqr, threads=1))
        if not self.options:
            return settings
        own = replace(getattr(settings, self.controller), **self.options)
        return replace(settings, **{self.controller: own})

    @property
    def key(self) -> Key:
        """What the result is filed under."""
        return (self.clip.set, self.clip.name, self.controller, self.settings_hash)

    @property
    def settings_hash(self) -> str:
        """Hash of everything that decides the result except the code and the bytes of a file."""
        parts = plain((self.settings, self.clip.recipe(), mujoco.__version__))
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:12]


def perform(task: Task) -> Record:
    """Track one clip and return its line; a motion or run that fails is a result, too."""
    clip = task.clip
    record: Record = {
        "bench_schema": SCHEMA,
        "set": clip.set,
        "clip": clip.name,
        "controller": task.controller,
        "variant": task.variant,
        "settings_hash": task.settings_hash,
        "jobs": task.jobs,
        "revision": revision(),
        "interaction": clip.interaction,
    }
    try:
        motion = clip.load()
        record["tier"] = tier(motion)
        start = Cost.now()
        rollout = track(motion, settings=task.settings)
        figures = outcome(rollout, Cost.now().since(start)).to_json()
        if clip.corruption is not None:
            clean = replace(clip, corruption=None).load()
            figures[ACCELERATION_CLEAN] = acceleration_error_from(clean, rollout)
        if task.rollouts is not None:
            name = f"{clip.name}.{task.variant or task.controller}.npz"
            rollout.save(task.rollouts / clip.set / name)
    except DuetError as error:
        return {"tier": "walking", **record, "success": False, "ended_because": str(error)}
    return {**figures, **record}


def acceleration_error_from(motion: DuetMotion, rollout: Rollout) -> dict[str, float]:
    """Return each person's mean acceleration error from another motion, mm/frame².

    A spoilt motion shakes, and following it truly is no merit. This says how a rollout moves beside
    the motion that was spoilt; where the two stand does not enter into accelerations.
    """
    times = np.minimum(rollout.times, motion.duration)
    asked = CubicSpline(motion.a.times, motion.keypoints)(times)
    error = acceleration_error(rollout.keypoints, asked, rollout.rate).mean(axis=0)
    return dict(zip("ab", (error * 1000).tolist(), strict=True))


@cache
def revision() -> str:
    """Return the commit of the checkout, with ``+`` if files differ from it; empty outside git."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty=+"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""
