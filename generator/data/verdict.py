"""What physics said of the choreographer's clips: kept and repaired, or rejected and why.

``ROOT/SPLIT/SEED/NUMBER.json`` is the verdict on a clip. Of one that is kept, ``NUMBER.npz`` beside
it is the motion that two simulated people made of it. The verdict is written last and whole, so it
vouches for what lies beside it, and a clip without one has not been judged.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from generator.data.choreographed import Choreographed, Split
from robots.errors import MotionFileError
from robots.files import plain, write_json

SCHEMA = "pasdedeux.verdict/1"
_MAX_BYTES = 2**20
_HINT = "delete the file; 'pasdedeux curate' judges the clip again"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The verdict on one clip."""

    kept: bool
    """Whether two simulated people performed it and the gate let it pass."""
    interaction: str
    """What is done in it."""
    text: str = ""
    """The first of its sentences."""
    reasons: tuple[str, ...] = ()
    """Why it is rejected, in words that can be counted: names of metrics that missed their
    threshold, or ``spoilt``, ``impossible``."""
    why: tuple[str, ...] = ()
    """The same with numbers, one line each."""
    changed_mm: float | None = None
    """Mean distance of the keypoints, in all frames, from where they were before."""
    figures: dict[str, dict[str, float]] = field(default_factory=dict)
    """Metrics by name, of the ``reference`` as it was given and of what was ``simulated``."""
    cpu_s: float = 0.0
    """Processor time that the verdict took, s."""
    made_with: dict[str, Any] = field(default_factory=dict)
    """Settings and versions that it depends on, as plain JSON."""

    def save(self, path: Path) -> None:
        """Write as JSON.

        Raises:
            MotionFileError: The file cannot be written.
        """
        write_json(path, {"schema": SCHEMA, **plain(self)})

    @classmethod
    def load(cls, path: Path) -> Verdict | None:
        """Read what :meth:`save` wrote; ``None`` if there is no such file.

        Raises:
            MotionFileError: It is not a verdict.
        """
        try:
            with open(path, "rb") as file:
                data = json.loads(file.read(_MAX_BYTES))
            if data["schema"] != SCHEMA or not isinstance(data["kept"], bool):
                raise ValueError(f"schema {data['schema']!r}, kept {data['kept']!r}")
            return cls(
                kept=data["kept"],
                interaction=str(data["interaction"]),
                text=str(data["text"]),
                reasons=tuple(map(str, data["reasons"])),
                why=tuple(map(str, data["why"])),
                changed_mm=None if data["changed_mm"] is None else float(data["changed_mm"]),
                figures={
                    str(of): {str(name): float(value) for name, value in values.items()}
                    for of, values in data["figures"].items()
                },
                cpu_s=float(data["cpu_s"]),
                made_with=dict(data["made_with"]),
            )
        except FileNotFoundError:
            return None
        except OSError as error:
            reason = error.strerror or str(error)
            raise MotionFileError(f"cannot be read: {reason}", where=str(path)) from error
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise MotionFileError(
                f"this is not a verdict ({error})", where=str(path), hint=_HINT
            ) from error


@dataclass(frozen=True, slots=True)
class Curation:
    """The verdicts on the clips of one choreographed source."""

    root: Path
    """Folder of all verdicts."""
    split: Split
    """Which kind of clips."""
    seed: int
    """Decides them."""
    count: int
    """Their number."""

    @property
    def clips(self) -> Choreographed:
        """The clips as they were invented.

        Raises:
            SpecError: The count is not positive, or there is no such split.
        """
        return Choreographed(self.count, seed=self.seed, split=self.split)

    @property
    def folder(self) -> Path:
        """Where their verdicts are."""
        return self.root / self.split / str(self.seed)

    def verdict_file(self, number: int) -> Path:
        """Return the place of a verdict."""
        return self.folder / f"{number}.json"

    def motion_file(self, number: int) -> Path:
        """Return the place of a repaired motion."""
        return self.folder / f"{number}.npz"

    def verdict(self, number: int) -> Verdict | None:
        """Return the verdict on a clip; ``None`` if it has not been judged.

        Raises:
            MotionFileError: The file is not a verdict.
        """
        return Verdict.load(self.verdict_file(number))
