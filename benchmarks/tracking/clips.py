"""The duets that trackers are measured on.

``pseudo`` are captured clips, where they are there; ``choreo`` are 60 duets of the choreographer,
over all interactions in which people touch, in styles drawn over their whole ranges; ``dirty`` are
the same 60, spoilt; ``folder`` is whatever motion files the caller has.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks.tracking.corruption import Corruption, corrupt
from generator.choreographer import Style, choreograph, style_ranges
from generator.io import read_motion
from generator.motion import DuetMotion
from robots.errors import SpecError, nearest

SETS = ("pseudo", "choreo", "dirty", "folder")
TOUCHING = (
    *("box", "circle_dance", "fist_bump", "handshake", "high_five"),
    *("hug", "pass_object", "push", "waltz"),
)
"""Interactions with labelled contacts."""
COUNT = 60
"""Duets in ``choreo`` and in ``dirty``."""

CAPTURED = Path(__file__).parents[2].parent / "shared" / "duets" / "pseudo"
"""Captured clips beside a development checkout; not part of the project."""

RUNNING_SPEED = 2.0
"""Speed of a pelvis, m/s, above which a clip counts in a tier of its own."""
_SPEED_WINDOW = 0.2

_STYLE_SEED, _CORRUPTION_SEED = 20, 40


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchClip:
    """How to get one duet; small and plain, so that it can be sent to another process."""

    set: str
    """One of :data:`SETS`."""
    name: str
    """Unique in its set."""
    file: Path | None = None
    """Motion file; ``None`` if choreographed."""
    interaction: str = ""
    """What is choreographed."""
    seed: int = 0
    """Of the choreographer."""
    style: Style = field(default_factory=Style)
    """Of the choreographer."""
    corruption: int | None = None
    """Seed of the noise; ``None`` leaves the motion clean."""

    def load(self) -> DuetMotion:
        """Read or make the motion.

        Raises:
            MotionFileError: The file is not a motion.
        """
        if self.file is not None:
            motion = read_motion(self.file)
        else:
            motion = choreograph(self.interaction, seed=self.seed, style=self.style)
        return motion if self.corruption is None else corrupt(motion, self.corruption)

    def recipe(self) -> dict[str, object]:
        """Return what decides the motion, apart from the bytes of a file."""
        noise = None if self.corruption is None else (self.corruption, Corruption())
        return {
            "interaction": self.interaction,
            "seed": self.seed,
            "style": self.style,
            "corruption": noise,
        }


def clips_of(name: str, folder: Path | None = None) -> list[BenchClip]:
    """Return the clips of a set, always in the same order; none where captured clips are absent.

    Args:
        name: One of :data:`SETS`.
        folder: Motion files of the set ``folder``.

    Raises:
        SpecError: There is no such set, or no such folder.
    """
    if name == "pseudo":
        return _files(name, CAPTURED) if CAPTURED.is_dir() else []
    if name == "choreo":
        return [_choreographed(i) for i in range(COUNT)]
    if name == "dirty":
        return [_choreographed(i, dirty=True) for i in range(COUNT)]
    if name != "folder":
        raise SpecError(f"no set '{name}'", allowed=", ".join(SETS), hint=nearest(name, SETS))
    if folder is None or not folder.is_dir():
        raise SpecError(f"no folder of motion files at {folder}", hint="give one with --folder")
    return _files(name, folder)


def _files(name: str, folder: Path) -> list[BenchClip]:
    files = sorted(f for f in folder.iterdir() if f.is_file() and not f.name.startswith("."))
    return [BenchClip(set=name, name=f.stem, file=f) for f in files]


def _choreographed(index: int, *, dirty: bool = False) -> BenchClip:
    rng = np.random.default_rng([_STYLE_SEED, index])
    numbers = {name: float(rng.uniform(*bounds)) for name, bounds in style_ranges().items()}
    interaction = TOUCHING[index % len(TOUCHING)]
    return BenchClip(
        set="dirty" if dirty else "choreo",
        name=f"{index:02d}_{interaction}",
        interaction=interaction,
        seed=index,
        style=Style(
            **numbers,
            handedness="left" if rng.random() < 0.5 else "right",
            swap=bool(rng.random() < 0.5),
        ),
        corruption=_CORRUPTION_SEED + index if dirty else None,
    )


def tier(motion: DuetMotion) -> str:
    """Return ``running`` where a pelvis is ever faster than 2 m/s over 0.2 s, else ``walking``."""
    window = max(1, round(_SPEED_WINDOW * motion.fps))
    steps = np.diff(motion.keypoints[:, :, 0, :2], axis=0) * motion.fps
    speed = np.linalg.norm(uniform_filter1d(steps, window, axis=0, mode="nearest"), axis=-1)
    return "running" if speed.max() > RUNNING_SPEED else "walking"
