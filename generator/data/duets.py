"""The project's own motions: every ``.npz`` below a folder."""

from __future__ import annotations

from pathlib import Path

from generator.data.clip import Clip, clip_of
from generator.io import read_motion
from robots.errors import MotionFileError


def fingerprint_of(root: Path, paths: list[Path]) -> str:
    """Return names, sizes and times of change of files, one a line.

    Raises:
        MotionFileError: A file has vanished.
    """
    lines = []
    for path in paths:
        try:
            status = path.stat()
        except OSError as error:
            raise MotionFileError(
                f"cannot be read: {error.strerror or error}", where=str(path)
            ) from error
        lines.append(f"{path.relative_to(root)} {status.st_size} {status.st_mtime_ns}")
    return "\n".join(lines)


class DuetFolder:
    """Motion files as ``generate``, ``track`` and ``run`` write them, also in subfolders.

    So does physics reach the training: motions that the simulation repaired are read from disk.
    """

    def __init__(self, root: str | Path) -> None:
        """List the files; they are opened when asked for.

        Raises:
            MotionFileError: The folder does not exist or holds no motion.
        """
        self._root = Path(root)
        self._paths = sorted(self._root.rglob("*.npz"))
        if not self._paths:
            raise MotionFileError("there is no .npz in this folder", where=str(root))

    @property
    def name(self) -> str:
        """The folder."""
        return f"duets in {self._root}"

    @property
    def fingerprint(self) -> str:
        """Names, sizes and times of the files."""
        return "duets\n" + fingerprint_of(self._root, self._paths)

    def __len__(self) -> int:
        """Return the number of files."""
        return len(self._paths)

    def clip(self, index: int) -> Clip:
        """Return the motion of a file.

        Raises:
            MotionFileError: It is damaged, or in a format that does not state its frame rate.
        """
        path = self._paths[index]
        return clip_of(read_motion(path), str(path.relative_to(self._root)))
