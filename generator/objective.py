"""What training minimises (Sec. 4.3), as data that is saved beside the weights. Torch-free."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Literal

from robots.errors import SpecError


@dataclass(frozen=True, slots=True)
class ObjectiveConfig:
    """Weights and thresholds of eq. (12), (14) and (15).

    The defaults are those of Sec. 5.1. The paper does not give the threshold of the distance map;
    1 m is what the public release uses. Table 3 drops a term by weight 0, Table 4 varies
    ``damping``; its row "None" is ``regularisation=0``.

    Raises:
        SpecError: A number is negative, not finite, or out of range.
    """

    velocity: float = 30.0
    """Weight of the velocity loss."""
    foot: float = 30.0
    """Weight of the foot contact loss."""
    bone_length: float = 10.0
    """Weight of the bone length loss, eq. (11)."""
    distance_map: float = 3.0
    """Weight of the masked joint distance map loss, eq. (12)."""
    relative_orientation: float = 0.01
    """Weight of the relative orientation loss, eq. (13)."""
    regularisation: float = 1.0
    """Weight of all of the above together, eq. (15)."""
    near: float = 1.0
    """Horizontal distance of two keypoints, in the truth, below which eq. (12) counts them, m."""
    damping: float = 0.7
    """Share of the diffusion steps up to which eq. (15) regularises: t <= damping * steps."""
    steps: int = 1000
    """Diffusion steps T."""
    representation: Literal["non_canonical", "canonical"] = "non_canonical"
    """Which features are learnt; the terms are computed from keypoints in either case."""

    def __post_init__(self) -> None:
        """Validate."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float | int) and not (math.isfinite(value) and value >= 0):
                raise SpecError(f"{value}", where=field.name, allowed="0 or more")
        if self.damping > 1:
            raise SpecError(f"{self.damping}", where="damping", allowed="0 to 1")
        if self.steps < 1:
            raise SpecError(f"{self.steps}", where="steps", allowed="1 or more")
        if self.representation not in ("non_canonical", "canonical"):
            raise SpecError(
                f"'{self.representation}'",
                where="representation",
                allowed="non_canonical, canonical",
            )

    @property
    def last_regularised_step(self) -> float:
        """The threshold of eq. (15) as a diffusion step."""
        return self.damping * self.steps
