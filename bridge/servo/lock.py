"""One owner per serial port: a second player is refused, not interleaved."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path
from types import TracebackType

from robots.errors import PortLost

try:
    import fcntl
except ImportError:  # not a POSIX system: there a serial port has one owner anyway
    fcntl = None


class PortLock:
    """Holds a lock file for a port; the system releases it even if the process is killed."""

    def __init__(self, port: str, *, folder: str | Path | None = None) -> None:
        """Name the lock of a port; links to the same device share it."""
        self.port = port
        name = re.sub(r"[^A-Za-z0-9]+", "-", os.path.realpath(port)).strip("-")
        self.path = Path(folder or tempfile.gettempdir()) / f"pasdedeux-{name}.lock"
        self._file: int | None = None

    def __enter__(self) -> PortLock:
        """Take the lock.

        Raises:
            PortLost: Another process holds it, or the lock file cannot be made.
        """
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        try:
            file = os.open(self.path, flags, 0o666)
        except OSError as error:
            raise PortLost(
                f"cannot make the lock file: {error.strerror}", where=str(self.path)
            ) from error
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.read(file, 32).decode("ascii", "replace").strip()
            os.close(file)
            raise PortLost(
                f"is in use by process {owner or 'unknown'}",
                where=self.port,
                hint="stop the other player first",
            ) from error
        os.ftruncate(file, 0)
        os.lseek(file, 0, os.SEEK_SET)
        os.write(file, f"{os.getpid()}\n".encode())
        self._file = file
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Release it. The file stays: removing it would let two owners hold different files."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
