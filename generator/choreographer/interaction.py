"""The repertoire: interactions by name, and the decorator that adds one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from generator.choreographer.spacing import Spacing
from generator.choreographer.stage import Stage
from robots.errors import PromptError, nearest

Staging = Callable[[Stage], None]


@dataclass(frozen=True, slots=True)
class Interaction:
    """One entry of the repertoire."""

    name: str
    """Identifier, for example ``high_five``."""
    summary: str
    """What happens, in one sentence."""
    spacing: Spacing
    """What decides how near the two stand."""
    staging: Staging
    """Writes the parts of both roles onto a stage."""
    overlap: float = 0.01
    """How deep the two bodies may sink into each other, m: soft bodies that press together."""


_REPERTOIRE: dict[str, Interaction] = {}


def interaction(spacing: Spacing, *, overlap: float = 0.01) -> Callable[[Staging], Staging]:
    """Add the decorated function to the repertoire under its own name.

    The first line of its docstring becomes the summary.
    """

    def add(staging: Staging) -> Staging:
        summary = (staging.__doc__ or "").strip().splitlines()[0]
        _REPERTOIRE[staging.__name__] = Interaction(
            staging.__name__, summary, spacing, staging, overlap
        )
        return staging

    return add


def repertoire() -> tuple[str, ...]:
    """Return the names of all interactions, in alphabetical order."""
    return tuple(sorted(_REPERTOIRE))


def lookup(name: str) -> Interaction:
    """Return an interaction by name.

    Raises:
        PromptError: There is no such interaction.
    """
    try:
        return _REPERTOIRE[name]
    except KeyError:
        raise PromptError(
            f"no interaction '{name}'",
            allowed=", ".join(repertoire()),
            hint=nearest(name, repertoire()),
        ) from None
