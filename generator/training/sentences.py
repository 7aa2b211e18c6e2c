"""Vectors of sentences on disk, shared by every run that has the same encoder and cache.

**The problem.** The clips of a run have tens of thousands of sentences, and each takes the encoder
some 10 ms: minutes of a core that every resumed run, every ablation and every judge would spend on
the same vectors. So they are kept in one SQLite file beside the cached clips; several processes may
read and write it at once.
"""

from __future__ import annotations

import logging
import sqlite3
import threading
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Row = NDArray[np.float16 | np.float32]

_WAIT = 30.0
"""Seconds for which another process may hold the file."""
_log = logging.getLogger(__name__)


class SentenceStore:
    """Vectors by sentence, in a file.

    Whatever is wrong with the file, there are just no vectors: it holds nothing that cannot be
    computed again.
    """

    def __init__(self, path: Path) -> None:
        """Open the file, or make it."""
        self._path, self._lock = path, threading.Lock()
        self._connection: sqlite3.Connection | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(path, timeout=_WAIT, check_same_thread=False)
            connection.execute("PRAGMA journal_mode=WAL")
            connection.execute("PRAGMA synchronous=NORMAL")
            connection.execute(
                "CREATE TABLE IF NOT EXISTS vectors"
                " (sentence TEXT PRIMARY KEY, width INTEGER, bits INTEGER, numbers BLOB)"
            )
            self._connection = connection
        except (OSError, sqlite3.Error) as error:
            self._give_up(error)

    def get(self, sentence: str) -> tuple[Row, int] | None:
        """Return a vector without the zeros at its end and its whole width, if it is there."""
        with self._lock:
            if self._connection is None:
                return None
            try:
                found = self._connection.execute(
                    "SELECT width, bits, numbers FROM vectors WHERE sentence = ?", (sentence,)
                ).fetchone()
                if found is None:
                    return None
                width, bits, numbers = found
                row = np.frombuffer(numbers, np.float16 if bits == 16 else np.float32)
                return (row, int(width)) if len(row) <= width else None
            except (sqlite3.Error, TypeError, ValueError) as error:
                self._give_up(error)
                return None

    def put(self, rows: Mapping[str, Row], width: int) -> None:
        """Keep vectors that all have the same whole width."""
        with self._lock:
            if self._connection is None or not rows:
                return
            values = [
                (sentence, width, 8 * row.itemsize, row.tobytes()) for sentence, row in rows.items()
            ]
            try:
                with self._connection:
                    self._connection.executemany(
                        "INSERT OR REPLACE INTO vectors VALUES (?, ?, ?, ?)", values
                    )
            except sqlite3.Error as error:
                self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        _log.warning("vectors of sentences are not kept in %s: %s", self._path, error)
        self._connection = None
