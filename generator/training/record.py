"""The curves of a run: a line of JSON per entry, and TensorBoard events where that is installed."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from robots.errors import CheckpointError
from robots.files import whole_file

log = logging.getLogger(__name__)


class Record:
    """Figures of training, appended as it goes."""

    def __init__(self, path: Path, *, after: int, tensorboard: bool) -> None:
        """Open a log; entries after step ``after`` are those of a part that was lost, and go.

        Args:
            path: The file of JSON lines.
            after: Steps that are done.
            tensorboard: Also write events, into ``tensorboard/`` beside it, if it is installed.

        Raises:
            CheckpointError: The file cannot be written.
        """
        try:
            kept = [line for line in _lines(path) if _step(line) <= after]
            with whole_file(path) as file:
                file.write("".join(kept).encode())
            self._file: IO[str] = open(path, "a", encoding="utf-8")  # noqa: SIM115 - closed later
        except OSError as error:
            raise CheckpointError(f"cannot be written: {error}", where=str(path)) from error
        self._events = _events(path.parent / "tensorboard", after) if tensorboard else None

    def write(self, step: int, figures: Mapping[str, float]) -> None:
        """Append an entry, so that it is on its way to the disk."""
        self._file.write(json.dumps({"step": step, **figures}) + "\n")
        self._file.flush()
        if self._events is not None:
            for name, value in figures.items():
                self._events.add_scalar(name, value, step)

    def close(self) -> None:
        """Close the files."""
        self._file.close()
        if self._events is not None:
            self._events.close()


def read_record(path: str | Path) -> list[dict[str, Any]]:
    """Return the entries of a log; a last line that was cut off is left out."""
    return [json.loads(line) for line in _lines(Path(path)) if _step(line) < float("inf")]


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text("utf-8").splitlines(keepends=True)
    except FileNotFoundError:
        return []


def _step(line: str) -> float:
    """Return the step of a line; ``inf`` for one that was cut off by a crash."""
    try:
        return int(json.loads(line)["step"])
    except (ValueError, KeyError, TypeError):
        return float("inf")


def _events(folder: Path, after: int) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        log.info("tensorboard is not installed: the curves are in log.jsonl alone")
        return None
    return SummaryWriter(str(folder), purge_step=after + 1)
