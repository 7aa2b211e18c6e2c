"""A file of results that survives being killed: one line of JSON each, on disk before the next."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robots.errors import MotionFileError

Record = dict[str, Any]
"""One line: what was tracked and how, then the keys of ``track.json``."""
Key = tuple[str, ...]
"""Set, clip, controller, hash of settings and recipe."""


def key_of(record: Record) -> Key:
    """Return what a record is a result of."""
    return (record["set"], record["clip"], record["controller"], record["settings_hash"])


class Results:
    """An append-only file of records. The last of several with one key counts."""

    def __init__(self, path: Path, key: Callable[[Record], Key] = key_of) -> None:
        """Take the file, which need not exist yet, and what tells its records apart."""
        self.path, self._key = path, key

    def read(self) -> dict[Key, Record]:
        """Return all whole records; a line that was cut off when the writer died is left out.

        Raises:
            MotionFileError: A line other than the last is damaged.
        """
        if not self.path.exists():
            return {}
        lines = self.path.read_bytes().split(b"\n")
        records: dict[Key, Record] = {}
        for number, line in enumerate(lines[:-1], start=1):
            try:
                record = json.loads(line)
                records.pop(self._key(record), None)  # so that the order is that of the last lines
                records[self._key(record)] = record
            except (ValueError, KeyError, TypeError) as error:
                raise MotionFileError(
                    "is not a result", where=f"{self.path}:{number}", hint="delete that line"
                ) from error
        return records

    def append(self, record: Record) -> None:
        """Write one record and wait until it is on disk."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        line = json.dumps(record, allow_nan=False, ensure_ascii=False).encode() + b"\n"
        with open(self.path, "ab+") as file:
            self._cut_torn_line(file)
            file.write(line)
            file.flush()
            os.fsync(file.fileno())

    @staticmethod
    def _cut_torn_line(file: Any) -> None:
        size = file.seek(0, os.SEEK_END)
        while size > 0:
            file.seek(size - 1)
            if file.read(1) == b"\n":
                break
            size -= 1
        file.truncate(size)
        file.seek(0, os.SEEK_END)
