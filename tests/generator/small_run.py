"""A training run of a few steps, for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from generator.training.config import RunConfig, parse

TINY = {"width": 16, "layers": 1, "heads": 2, "feedforward": 16, "dropout": 0.1}


def small(folder: Path, **tables: dict[str, Any]) -> RunConfig:
    """A run of a few steps on the three duets."""
    data = {
        "cache": str(folder / "cache"),
        "frames": 16,
        "source": [{"kind": "duets", "root": str(folder / "duets")}],
    }
    plain: dict[str, Any] = {
        "name": "small",
        "model": TINY,
        "data": data,
        "training": {"batch": 4, "steps": 6, "warmup_steps": 2, "learning_rate": 1e-3},
        "log": {"steps": 2, "tensorboard": False},
    }
    for name, table in tables.items():
        plain[name] = {**plain.get(name, {}), **table}
    return parse(plain)
