"""Every error that a pasdedeux package raises on bad input, bad files or bad hardware.

One base class, :class:`DuetError`, so that a caller can catch all of them and nothing else.
Each error carries its parts as attributes and renders them as one line that a person can act on:
*what* is wrong, *where*, what would be *allowed*, and the *hint*: what to do next.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class DuetError(Exception):
    """Base of all errors meant for people.

    Attributes:
        what: What is wrong, as a sentence fragment.
        where: File, field, joint or frame it concerns; empty if nowhere in particular.
        allowed: What would have been accepted; empty if that says nothing.
        hint: What to do next; empty if obvious.
    """

    exit_code = 2
    """Exit status of the command line when this error ends it."""

    def __init__(self, what: str, *, where: str = "", allowed: str = "", hint: str = "") -> None:
        """Keep the parts and render them as one line."""
        self.what = what
        self.where = where
        self.allowed = allowed
        self.hint = hint
        text = f"{where}: {what}" if where else what
        if allowed:
            text += f" (allowed: {allowed})"
        if hint:
            text += f"; {hint}"
        super().__init__(" ".join(text.split()))


class MotionFileError(DuetError):
    """A motion, rollout or trajectory file cannot be read or written."""


class MotionError(DuetError):
    """A motion breaks a promise of its type: shape, finiteness, human scale."""


class SpecError(DuetError):
    """A robot, body or configuration file is wrong or missing."""


class CheckpointError(DuetError):
    """Model weights are missing, damaged or of another architecture."""


class PromptError(DuetError):
    """A sentence asks for something the generator does not know."""

    exit_code = 1


class RenderError(DuetError):
    """No picture can be drawn here, for example because there is no OpenGL."""


class SimDiverged(DuetError):
    """The physics produced non-finite or absurd numbers.

    Attributes:
        time: When in the run, s; ``None`` outside of one.
        trace: What happened until then, a ``sim.simulation.Trace``; ``None`` if nothing did.
    """

    exit_code = 1

    def __init__(
        self, what: str, *, time: float | None = None, trace: Any = None, **parts: str
    ) -> None:
        """Keep the parts; ``where``, ``allowed`` and ``hint`` as in :class:`DuetError`."""
        self.time = time
        self.trace = trace
        super().__init__(what, **parts)


class LimitViolation(DuetError):
    """A trajectory or command leaves the limits of a joint."""

    exit_code = 1


class GateRefused(DuetError):
    """The plausibility report does not allow this performance."""

    exit_code = 1


class BusError(DuetError):
    """A servo bus failed."""

    exit_code = 3


class BusTimeout(BusError):
    """A servo did not answer in time."""


class BusCorrupt(BusError):
    """An answer arrived damaged."""


class ServoFault(BusError):
    """A servo reports an error of its own."""


class PortLost(BusError):
    """The serial port cannot be opened or has gone away."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``"did you mean 'x'?"`` for the closest known name, or an empty string."""
    match = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"did you mean '{match[0]}'?" if match else ""
