"""Where a model comes from, and what binds its motions. Torch-free."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where weights come from; travels into every motion made with them."""

    source: str = ""
    """Name of the model or of its file."""
    licence: str = ""
    """Licence that binds its motions; empty if none is known."""
    fps: float = 30.0
    """Frames per second of the motions it was trained on."""
    training: dict[str, Any] = field(default_factory=dict)
    """Facts of the training run: data, steps, losses. Anything that JSON can hold."""
