"""What comes in from disk: motions of any format, rollouts, robots by name or folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from generator.motion import DuetMotion
from robots.files import read_archive

if TYPE_CHECKING:  # MuJoCo is loaded only by what needs it
    from robots.spec import RobotSpec

ROLLOUT_SCHEMA = "pasdedeux.rollout/1"


@dataclass(frozen=True, slots=True)
class MotionRequest:
    """What the caller says of a motion file that the file does not say itself."""

    fps: float | None = None
    """Frames per second."""
    up: Literal["y", "z"] | None = None
    """Axis that points up, ``y`` or ``z``."""
    scale: float | None = None
    """Metres per unit of the file."""


FROM_FILE = MotionRequest()
"""Nothing more than the file says."""


def read(path: Path, request: MotionRequest) -> DuetMotion:
    """Read any motion file, or the simulated motion of a rollout.

    Raises:
        MotionFileError: It cannot be read.
    """
    if schema_of(path) == ROLLOUT_SCHEMA:
        from sim.rollout import Rollout

        return Rollout.load(path).as_motion()
    from generator.io import read_motion

    return read_motion(path, fps=request.fps, up=request.up, scale=request.scale)


def judged_hash(path: Path) -> str | None:
    """Return the hash of the motion that a rollout was made from; ``None`` for a motion."""
    if schema_of(path) != ROLLOUT_SCHEMA:
        return None
    header, _ = read_archive(path, header_only=True)
    return str(header["metadata"].get("input_sha256", "")) if header else None


def schema_of(path: Path) -> str:
    """Return the schema of one of the project's own files; empty for any other motion file."""
    if path.suffix != ".npz":
        return ""
    header, _ = read_archive(path, header_only=True)
    return str(header.get("schema", "")) if header else ""


def load_robots(a: str, b: str) -> tuple[RobotSpec, RobotSpec]:
    """Return the robots of both people, by name or folder.

    Raises:
        SpecError: There is no such robot.
    """
    from robots.registry import load_robot

    return load_robot(a), load_robot(b)
