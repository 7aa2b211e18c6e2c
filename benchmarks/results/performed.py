"""What two simulated people make of a motion, on their own feet: how trackable it is."""

from __future__ import annotations

from typing import Any

from benchmarks.results.figures import Figures
from generator.motion import DuetMotion
from sim.curation import CurationSettings, judge

SETTINGS = CurationSettings()
"""Those that clips are curated with."""
SIMULATED = {
    "off": "mpjpe_global",
    "performed_overlap": "penetration_p95",
    "performed_floor": "floor_penetration_p95",
    "performed_slide": "slide_speed",
}
"""Figures of what was simulated, and their metrics; of the worse person, mm and m/s."""
NAMES = ("passed", "upright", *SIMULATED)
"""Figures of one motion."""


def performed(motion: DuetMotion) -> Figures:
    """Return whether the gate lets the performance pass, whether both keep their feet, and figures.

    Args:
        motion: Two people of which nothing is out of joint: finished.
    """
    verdict, _ = judge(motion, SETTINGS)
    simulated = verdict.figures.get("simulated", {})
    found: Figures = {
        "passed": float(verdict.kept),
        "upright": float(not {"fell", "impossible"} & set(verdict.reasons)),
    }
    return found | {name: simulated.get(metric) for name, metric in SIMULATED.items()}


def made_with() -> dict[str, Any]:
    """Return everything that the figures depend on beside the motion and versions."""
    known = SETTINGS.made_with
    return {name: known[name] for name in ("settings", "gate")}
