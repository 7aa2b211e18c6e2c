"""The type that a servo chain performs: joint positions over time, with names."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robots.errors import LimitViolation, MotionFileError
from robots.files import read_archive, write_archive
from robots.skeleton import FloatArray, read_only

SCHEMA = "pasdedeux.trajectory/1"


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectory:
    """Joint positions of one robot over time.

    Raises:
        LimitViolation: Times do not start at 0 and increase, shapes differ, or a number is not
            finite. Joint limits are checked against a robot where one is at hand.
    """

    times: FloatArray
    """``[N]`` s, strictly increasing from 0. Both robots of a duet share one clock."""
    position: FloatArray
    """``[N, D]`` rad (m for sliding joints)."""
    joint_names: tuple[str, ...]
    """Names of the D columns, as in the robot's ``robot.toml``."""
    robot: str
    """Name of the robot it was made for."""
    metadata: dict[str, Any] = field(default_factory=dict)
    """Plain JSON: person (``a`` or ``b``), text, licence, ``slowed_by``, hashes of the inputs."""
    base: FloatArray | None = None
    """``[N, 7]`` m and wxyz: where the robot's base is meant to be on the stage that both robots
    share. Nothing commands it; pictures and reports need it. ``None`` if unknown."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        times, position = np.asarray(self.times), np.asarray(self.position)
        if times.ndim != 1 or len(times) < 2:
            raise LimitViolation("a trajectory needs at least two moments")
        if position.shape != (len(times), len(self.joint_names)):
            raise LimitViolation(
                f"positions have shape {position.shape}",
                allowed=f"({len(times)}, {len(self.joint_names)})",
            )
        if len(set(self.joint_names)) != len(self.joint_names):
            raise LimitViolation("two columns carry the same joint name")
        if not np.isfinite(times).all() or times[0] != 0 or (np.diff(times) <= 0).any():
            raise LimitViolation("times must start at 0 and strictly increase")
        bad = np.argwhere(~np.isfinite(position))
        if len(bad):
            row, column = bad[0]
            raise LimitViolation(
                f"position is not finite at {times[row]:.3f} s", where=self.joint_names[column]
            )
        object.__setattr__(self, "times", read_only(times))
        object.__setattr__(self, "position", read_only(position))
        if self.base is not None:
            base = np.asarray(self.base)
            if base.shape != (len(times), 7) or not np.isfinite(base).all():
                raise LimitViolation(
                    f"base poses have shape {base.shape} or are not finite",
                    allowed=f"({len(times)}, 7)",
                )
            object.__setattr__(self, "base", read_only(base))

    @property
    def duration(self) -> float:
        """Last moment, s."""
        return float(self.times[-1])

    @property
    def content_sha256(self) -> str:
        """Hash of what servos would be told: robot, joint names, times and positions."""
        names = json.dumps([self.robot, *self.joint_names])
        digest = hashlib.sha256(names.encode())
        for array in (self.times, self.position):
            digest.update(np.ascontiguousarray(array, "<f8").tobytes())
        return digest.hexdigest()

    def save(self, path: str | Path) -> None:
        """Write as npz with a JSON header."""
        header = {
            "schema": SCHEMA,
            "robot": self.robot,
            "joint_names": list(self.joint_names),
            "metadata": self.metadata,
        }
        arrays = {"times": self.times, "position": self.position}
        if self.base is not None:
            arrays["base"] = self.base
        write_archive(path, header, arrays)

    @classmethod
    def load(cls, path: str | Path) -> JointTrajectory:
        """Read what :meth:`save` wrote.

        Raises:
            MotionFileError: The file is not such a trajectory.
        """
        header, arrays = read_archive(path)
        if header is None or header.get("schema") != SCHEMA:
            raise MotionFileError(
                "this is not a joint trajectory", where=str(path), hint="make one with 'retarget'"
            )
        try:
            return cls(
                arrays["times"],
                arrays["position"],
                tuple(str(name) for name in header["joint_names"]),
                str(header["robot"]),
                dict(header["metadata"]),
                arrays.get("base"),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise MotionFileError(f"incomplete trajectory: {error!r}", where=str(path)) from error
        except LimitViolation as error:
            raise MotionFileError(str(error), where=str(path)) from error
