"""How the receding-horizon controller plans: sizes, weights, and what can be left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from robots.errors import SpecError


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """Weights of the quadratic tracking cost, per knot: balance before place, place before pose."""

    root_position: float = 20.0
    """1/m2."""
    root_rotation: float = 10.0
    """1/rad2."""
    joint: float = 1.0
    """1/rad2: each joint's rotation."""
    body: float = 30.0
    """1/m2: keypoints, shared out by :attr:`keypoint_share`."""
    foot_rotation: float = 2.0
    """1/rad2: orientation of ankles and toes in the world."""
    foot_velocity: float = 0.02
    """s2/m2: velocity of ankles and toes."""
    com: float = 50.0
    """1/m2: centre of mass."""
    com_velocity: float = 3.0
    """s2/m2."""
    angular_momentum: float = 0.03
    """s2/(kg2 m4): about the centre of mass."""
    joint_velocity: float = 0.004
    """s2/rad2."""
    control: float = 0.2
    """Change of a joint target, in units of :attr:`control_scale`."""
    touch: float = 60.0
    """1/m2: a hand that is to touch the partner, relative to where the partner will be."""
    terminal: float = 3.0
    """Factor on the cost of the last knot."""
    keypoint_share: Mapping[str, float] = field(
        default_factory=lambda: {"ankle": 3.0, "foot": 3.0, "wrist": 2.0, "head": 2.0}
    )
    """Weight of keypoints relative to the others', which is 1; over the number of keypoints."""
    control_scale: Mapping[str, float] = field(
        default_factory=lambda: {
            **{"hip": 1.2, "knee": 1.2, "ankle": 1.5, "foot": 0.5},
            **{"spine1": 0.6, "spine2": 0.5, "spine3": 0.5, "neck": 0.2, "head": 0.2},
            **{"collar": 0.3, "shoulder": 0.8, "elbow": 0.5, "wrist": 0.2},
        }
    )
    """How far targets of each joint may cheaply move from the reference, 0.1 rad: balance is kept
    with hips, knees and ankles, not with the head."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IlqrSettings:
    """How to plan.

    Raises:
        SpecError: A value makes no sense.
    """

    horizon: float = 0.5
    """How far ahead each plan looks, s."""
    replan: int = 4
    """Ticks between plans."""
    iterations: int = 1
    """Sweeps (derivatives, backward pass, line search) per plan."""
    regularisation: float = 1e-3
    """Added to the Hessian of the controls."""
    effort_factor: float = 1.5
    """Targets stay within this many times effort / stiffness of the reference's."""
    cache: float = 3.0
    """How far a knot may have moved for its derivatives to be kept, in units of 0.01 rad, 0.3 rad/s
    and 0.05 rad of control; 0 takes all of them anew for every plan."""
    ghost: bool | Literal["yielding", "auto"] = "auto"
    """Whether plans see the partner: as bodies that can be pushed away with the partner's weight
    (``yielding``), as ones that nothing moves (True), or not at all; ``auto``: yielding where the
    reference has somebody lean (:mod:`sim.support`), else not at all."""
    feedback: bool = True
    """Whether the time-varying LQR gains act between plans."""
    touch: bool = True
    """Whether hands that are to touch the partner are tracked relative to the partner."""
    feed_forward: float = 0.0
    """Share of the torque of inverse dynamics in the nominal targets."""
    recovery: int = 8
    """Most times to go back and try harder, and at most once per second of motion, twice in short
    ones; 0 never."""
    refinements: int = 0
    """Further runs of the whole clip, each starting from the controls of the best so far."""
    exact: bool = False
    """Whether derivatives are taken in full instead of the quick way."""
    threads: int = 2
    """Planners at work at once: one per person, or 1."""
    weights: Weights = field(default_factory=Weights)
    """Of the cost."""

    def __post_init__(self) -> None:
        """Validate."""
        bounds = {
            "horizon": (0.1, 3.0),
            "replan": (1, 20),
            "iterations": (1, 50),
            "regularisation": (0.0, 100.0),
            "effort_factor": (0.1, 10.0),
            "cache": (0.0, 20.0),
            "feed_forward": (0.0, 1.5),
            "recovery": (0, 100),
            "refinements": (0, 10),
            "threads": (1, 2),
        }
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise SpecError(f"{value}", where=f"ilqr.{name}", allowed=f"{low:g} to {high:g}")
        if self.ghost not in (True, False, "yielding", "auto"):
            allowed = "true, false, yielding, auto"
            raise SpecError(f"{self.ghost}", where="ilqr.ghost", allowed=allowed)


QUALITIES: dict[str, IlqrSettings] = {
    "preview": IlqrSettings(horizon=0.4, replan=6, cache=5.0, recovery=2),
    "normal": IlqrSettings(),
    "high": IlqrSettings(replan=2, iterations=2, cache=1.5, refinements=1),
}
"""Ready-made settings, by name."""
