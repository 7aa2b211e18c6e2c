"""Draws from the repertoire: any style, any two bodies, thrown away if spoilt."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from generator.choreographer.checks import examine
from generator.choreographer.compose import choreograph
from generator.choreographer.style import Style, style_ranges
from generator.motion import DuetMotion
from robots.errors import MotionError
from robots.skeleton import Skeleton, human_skeleton

SIZES = (0.85, 1.15)
"""Range of each person's size, relative to 1.70 m."""
ATTEMPTS = 20
"""Draws that are thrown away before giving up."""


@dataclass(slots=True)
class Tally:
    """What became of the draws of one interaction."""

    drawn: int = 0
    """Motions made."""
    rejected: int = 0
    """Of those, thrown away."""
    faults: Counter[str] = field(default_factory=Counter)
    """How often each bound was broken."""

    @property
    def rate(self) -> float:
        """Share that was thrown away, 0..1."""
        return self.rejected / max(self.drawn, 1)


def random_style(rng: np.random.Generator) -> Style:
    """Return a style drawn evenly over the ranges, with either hand and either person leading."""
    values = {name: float(rng.uniform(low, high)) for name, (low, high) in style_ranges().items()}
    handedness = "left" if rng.random() < 0.5 else "right"
    return Style(**values, handedness=handedness, swap=bool(rng.random() < 0.5))


def random_bodies(rng: np.random.Generator) -> tuple[Skeleton, Skeleton]:
    """Return two bodies of independent size, 0.85 to 1.15 of 1.70 m."""
    one, other = (human_skeleton().scaled(float(rng.uniform(*SIZES))) for _ in range(2))
    return one, other


def sample(
    interaction: str,
    rng: np.random.Generator,
    *,
    style: Style | None = None,
    skeletons: tuple[Skeleton, Skeleton] | None = None,
    tally: Tally | None = None,
) -> tuple[DuetMotion, Style]:
    """Return a duet that passes :func:`~generator.choreographer.checks.examine`, and its style.

    Args:
        interaction: A name of the repertoire.
        rng: Source of chance.
        style: The manner; each attempt draws another by default.
        skeletons: The bodies; each attempt draws others by default.
        tally: Told of every attempt.

    Raises:
        PromptError: There is no such interaction.
        MotionError: :data:`ATTEMPTS` draws in a row were spoilt; the style does not go with the
            interaction.
    """
    tally = Tally() if tally is None else tally
    for _ in range(ATTEMPTS):
        manner = style or random_style(rng)
        bodies = skeletons or random_bodies(rng)
        duet = choreograph(
            interaction, seed=int(rng.integers(2**31)), style=manner, skeletons=bodies
        )
        faults = examine(duet).faults
        tally.drawn += 1
        if not faults:
            return duet, manner
        tally.rejected += 1
        tally.faults.update(faults)
    worst = ", ".join(name for name, _ in tally.faults.most_common(2))
    raise MotionError(
        f"'{interaction}' was spoilt in {ATTEMPTS} draws ({worst})",
        hint="ask for a style nearer the ordinary one",
    )
