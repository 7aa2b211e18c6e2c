"""What is said about a motion file: frame rate, up axis and unit, by its format or by the caller.

**The problem.** A file of numbers does not tell metres from inches or y-up from z-up, and a reader
that guesses is right until the day it is silently wrong. So each of the three facts has exactly one
author. Where the format states it, the caller need not, and may not say otherwise; where the format
is silent, the caller must speak; the only value a caller may overrule is one that files of the
format are known to state wrongly (the frame time of a BVH).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeVar, cast

from robots.errors import MotionFileError

UpAxis = Literal["y", "z"]
_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class Statement:
    """What the caller says about a file; ``None`` where the caller says nothing.

    Raises:
        MotionFileError: A value makes no sense.
    """

    fps: float | None = None
    """Frames per second."""
    up: UpAxis | None = None
    """The axis of the file's world that points up."""
    scale: float | None = None
    """Metres per unit of length of the file."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.fps is not None and not (math.isfinite(self.fps) and 1 <= self.fps <= 1000):
            raise MotionFileError(f"--fps {self.fps} makes no sense", allowed="1 to 1000")
        if self.up not in (None, "y", "z"):
            raise MotionFileError(f"--up {self.up} makes no sense", allowed="y, z")
        if self.scale is not None and not (math.isfinite(self.scale) and 1e-6 <= self.scale <= 1e3):
            raise MotionFileError(
                f"--scale {self.scale} makes no sense", allowed="metres per unit, 0.000001 to 1000"
            )

    def settle_fps(
        self, where: str, stated: float | None = None, *, correctable: bool = False
    ) -> float:
        """Return the frame rate.

        Args:
            where: The file, for the error.
            stated: What the file or its format states, if anything.
            correctable: Files of this format are known to be wrong; the caller may overrule.

        Raises:
            MotionFileError: Nobody states it, or the caller contradicts the file.
        """
        if stated is not None and not (math.isfinite(stated) and 1 <= stated <= 1000):
            if correctable and self.fps is not None:
                return self.fps
            raise MotionFileError(
                f"states {stated:g} frames per second",
                where=where,
                allowed="1 to 1000",
                hint="give the true rate with --fps" if correctable else "",
            )
        if self.fps is None or stated is None or correctable:
            value = self.fps if self.fps is not None else stated
            return _known(value, where, "the frame rate", "give it, for example --fps 30")
        if not math.isclose(self.fps, stated, rel_tol=1e-3):
            raise _contradiction(where, f"{stated:g} frames per second", f"--fps {self.fps:g}")
        return stated

    def settle_up(self, where: str, stated: UpAxis | None = None) -> UpAxis:
        """Return the up axis; see :meth:`settle_fps`."""
        if self.up is not None and stated is not None and self.up != stated:
            raise _contradiction(where, f"that {stated} is up", f"--up {self.up}")
        value = self.up if self.up is not None else stated
        return _known(value, where, "which axis is up", "give --up y or --up z")

    def settle_scale(self, where: str, stated: float | None, hint: str = "") -> float:
        """Return the metres per unit; see :meth:`settle_fps`."""
        if self.scale is not None and stated is not None:
            if not math.isclose(self.scale, stated, rel_tol=1e-3):
                raise _contradiction(where, f"its unit ({stated:.6g} m)", f"--scale {self.scale:g}")
            return stated
        value = self.scale if self.scale is not None else stated
        return _known(value, where, "its unit of length", hint or "give --scale METRES_PER_UNIT")


def up_axis(text: str, where: str) -> UpAxis:
    """Return an up axis that a file states.

    Raises:
        MotionFileError: It is neither ``y`` nor ``z``.
    """
    value = text.strip().lower()
    if value not in ("y", "z"):
        raise MotionFileError(f"states the up axis '{text[:20]}'", where=where, allowed="y, z")
    return cast(UpAxis, value)


def _known(value: _Value | None, where: str, what: str, hint: str) -> _Value:
    if value is None:
        raise MotionFileError(f"the file does not say {what}", where=where, hint=hint)
    return value


def _contradiction(where: str, stated: str, said: str) -> MotionFileError:
    return MotionFileError(
        f"the file states {stated}, which contradicts {said}",
        where=where,
        hint=f"leave out {said.split()[0]}",
    )
