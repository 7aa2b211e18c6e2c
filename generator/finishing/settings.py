"""What finishing does, and how far it may go."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from robots.errors import SpecError


@dataclass(frozen=True, slots=True, kw_only=True)
class Finishing:
    """Settings of :func:`generator.finishing.finish`.

    Raises:
        SpecError: A number is negative or not finite.
    """

    smoothing: float = 1.0
    """How much of what looks like noise is taken out: 1 as much as was measured, 0 nothing."""
    jolt: float = 80.0
    """Acceleration of a keypoint that no body has, m/s^2; motion is smoothed around it."""
    rotations: float = 0.0
    """Share of the way that keypoints go to where the motion's own rotations put them, 0 to 1."""
    feet: bool = True
    """Whether feet that stand are put on the floor and held still."""
    hands: bool = True
    """Whether intended touches are closed."""
    apart: bool = True
    """Whether people whose bodies overlap are moved apart."""
    detect: bool = True
    """Whether touches of two hands are looked for where the motion has no labels."""
    max_plant: float = 0.25
    """Farthest that a standing foot is moved to where it stands still, m; feet that glide farther
    are left gliding."""
    max_level: float = 0.15
    """Farthest that a person is moved up or down to the floor, m."""
    max_gap: float = 0.40
    """Largest miss of an intended touch that is closed, m."""
    max_step: float = 0.15
    """Farthest that each person is moved along the floor towards a touch that is meant, m."""
    detect_gap: float = 0.15
    """Largest miss of a touch that nobody announced, m."""

    def __post_init__(self) -> None:
        """Validate."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not isinstance(value, bool) and not (np.isfinite(value) and value >= 0):
                raise SpecError(
                    f"{field.name} is {value}", where="finishing", allowed="0 or a positive number"
                )
        if self.rotations > 1:
            raise SpecError(f"{self.rotations}", where="finishing: rotations", allowed="0 to 1")


DRAWN = Finishing(rotations=0.9, jolt=30.0)
"""For what a network drew, with rotations of its own, which are better than its keypoints; of the
moments that it learnt from 99.7 % have less of a jolt."""
