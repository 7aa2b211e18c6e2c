"""What can be set about the sampling controller."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from robots.errors import SpecError


@dataclass(frozen=True, slots=True, kw_only=True)
class CostWeights:
    """What a second of deviation from the reference costs, per person."""

    position: float = 10.0
    """Per m2, weighted mean over keypoints."""
    root: float = 20.0
    """Per m2, of the pelvis in addition."""
    orientation: float = 5.0
    """Per rad2, of the pelvis."""
    joints: float = 2.0
    """Per rad2, mean over joints."""
    balance: float = 20.0
    """Per m2, of the centre of mass along the floor."""
    momentum: float = 2.0
    """Per (m/s)2, of the centre of mass."""
    spin: float = 0.02
    """Per (N m s)2, of the angular momentum about the centre of mass."""
    deviation: float = 0.3
    """Per rad2, mean over the deviations of the targets."""
    end: float = 0.2
    """Extra weight of the horizon's last moment, as a share of the horizon."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MppiSettings:
    """How to sample.

    Raises:
        SpecError: A value makes no sense.
    """

    samples: int = 64
    """Variants per plan. Cost grows in proportion; 64 keep walkers up, 24 hardly."""
    horizon: float = 0.6
    """How far a plan looks, s."""
    knots: int = 5
    """Points of the spline that a variant deviates by."""
    rate: float = 15.0
    """Plans per second."""
    temperature: float = 0.1
    """Cost at which a variant counts 1/e of the best, in standard deviations of the better half."""
    clip: float = 0.8
    """Largest deviation of a target in each coordinate, rad."""
    fade: float = 0.9
    """Share of a deviation that is left of it when it is carried beyond the horizon, per step."""
    feed_forward: float = 1.0
    """Share of the torque that inverse dynamics demands which is given ahead of any error."""
    threads: int = 1
    """Threads that roll out; the result does not depend on it."""
    weights: CostWeights = field(default_factory=CostWeights)
    """What counts as good."""

    def __post_init__(self) -> None:
        """Validate."""
        allowed: dict[str, tuple[float, float]] = {
            "samples": (2, 65536),
            "horizon": (0.1, 3.0),
            "knots": (2, 50),
            "rate": (1.0, 120.0),
            "temperature": (1e-3, 100.0),
            "clip": (0.0, 3.0),
            "fade": (0.0, 1.0),
            "feed_forward": (0.0, 1.0),
            "threads": (1, 256),
        }
        for name, (low, high) in allowed.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise SpecError(str(value), where=f"mppi.{name}", allowed=f"{low:g} to {high:g}")
        for weight in fields(self.weights):
            if not 0 <= getattr(self.weights, weight.name) < np.inf:
                raise SpecError(
                    str(getattr(self.weights, weight.name)),
                    where=f"mppi.weights.{weight.name}",
                    allowed="0 or more",
                )
