"""What is still plausible, as data: the thresholds of the gate and the terms of the score."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Subject = Literal["reference", "simulated"]
"""What was asked for, or what the physics did."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gate:
    """The worst values with which a duet may still be performed.

    Chosen so that captured duets pass with room and nonsense fails; ``docs/physics.md`` has the
    measured values of both.
    """

    mpjpe_global_mm: float = 150.0
    """Simulated: mean keypoint error of each person."""
    penetration_p95_mm: float = 30.0
    """Simulated: depth of the two people in each other, in 95 % of the time."""
    floor_penetration_p95_mm: float = 40.0
    """Simulated: depth below the floor, in 95 % of the time."""
    assist_mean_percent: float = 50.0
    """Simulated: mean force of the helping hand, body weights."""
    reference_penetration_p95_mm: float = 150.0
    """Asked for: captured contact in other bodies' keypoints reaches 100 mm; one person inside the
    other is deeper."""
    reference_floor_p95_mm: float = 80.0
    """Asked for, kinematic reports: depth below the floor."""
    reference_float_mean_mm: float = 80.0
    """Asked for, kinematic reports: height above the floor, on average."""
    residual_force_mean_percent: float = 60.0
    """Asked for, kinematic reports: force that no floor could give through the feet, body weights;
    100 for people who hover or lie."""
    speed_max: float = 15.0
    """Asked for: speed of the fastest keypoint, m/s."""
    bone_deviation_p95_percent: float = 20.0
    """Asked for: bones that change their length."""
    bend_excess_p95_degrees: float = 10.0
    """Asked for: a trunk, knee or elbow that is folded further than people can."""
    pelvis_height_min_percent: float = 25.0
    """Asked for: lowest pelvis, of its standing height; below that somebody lies or sits."""


@dataclass(frozen=True, slots=True)
class Term:
    """One factor of the score."""

    name: str
    of: Subject
    good: float
    """Up to here the factor is 1."""
    half: float
    """Here it is 1/2."""
    weight: float = 1.0


TRACKED_TERMS = (
    Term("mpjpe_global", "simulated", 30, 150),
    Term("acceleration_error", "simulated", 4, 15, 0.5),
    Term("penetration_p95", "simulated", 10, 40),
    Term("floor_penetration_p95", "simulated", 15, 50, 0.5),
    Term("slide_ratio", "simulated", 5, 40, 0.5),
    Term("assist_mean", "simulated", 10, 50),
    Term("contact_recall", "simulated", 100, 40, 0.5),
    Term("penetration_p95", "reference", 20, 120, 0.5),
    Term("speed_max", "reference", 10, 20),
    Term("bend_excess_p95", "reference", 2, 15),
)
KINEMATIC_TERMS = (
    Term("penetration_p95", "reference", 10, 80),
    Term("floor_penetration_p95", "reference", 20, 80),
    Term("float_mean", "reference", 20, 80),
    Term("slide_ratio", "reference", 5, 40, 0.5),
    Term("ground_shift", "reference", 30, 100, 0.5),
    Term("residual_force_mean", "reference", 10, 50),
    Term("bone_deviation_p95", "reference", 3, 15, 0.5),
    Term("speed_max", "reference", 10, 20),
    Term("bend_excess_p95", "reference", 2, 15),
)
