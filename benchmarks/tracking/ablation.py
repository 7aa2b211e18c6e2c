"""What each part of the receding-horizon controller is worth: the same clips without it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from benchmarks.tracking.clips import TOUCHING, BenchClip, clips_of
from benchmarks.tracking.tasks import Task

CONTROLLER = "ilqr"
VARIANTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "everything": {},
        "ghost in all clips": {"ghost": "yielding"},
        "without feedback": {"feedback": False},
        "without contact cost": {"touch": False},
        "without derivative cache": {"cache": 0.0},
        "without recovery": {"recovery": 0},
        "exact derivatives": {"exact": True},
    }
)
"""Names of variants and the fields of ``IlqrSettings`` that make them."""

DIRTY = ("handshake", "hug", "waltz")
"""Interactions whose spoilt clips are in the subset too."""


def ablation_clips() -> list[BenchClip]:
    """Return twelve clips: three spoilt ones, and one per interaction."""
    clean = clips_of("choreo")[: len(TOUCHING)]
    spoilt = [c for c in clips_of("dirty")[: len(TOUCHING)] if c.interaction in DIRTY]
    return [*spoilt, *clean]


def ablation_tasks(
    *, jobs: int = 1, rollouts: Path | None = None, limit: int | None = None
) -> list[Task]:
    """Return every variant on every clip, one variant after the other."""
    return [
        Task(
            clip=clip,
            controller=CONTROLLER,
            options=dict(options),
            variant=name,
            jobs=jobs,
            rollouts=rollouts,
        )
        for name, options in VARIANTS.items()
        for clip in ablation_clips()[:limit]
    ]
