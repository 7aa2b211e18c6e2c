"""The project's own motions: every ``.npz`` below a folder."""

from __future__ import annotations

from pathlib import Path

from generator.data.clip import Clip, clip_of
from generator.io import MOTION_SCHEMA, read_motion
from robots.errors import MotionFileError
from robots.files import read_archive

_OURS = "pasdedeux."
_MOTIONS = MOTION_SCHEMA.split("/")[0] + "/"


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


def _may_be_motion(path: Path) -> bool:
    try:
        header, _ = read_archive(path, header_only=True)
    except MotionFileError:
        return True  # the error is to be raised, and not a clip to be lost, when it is read
    schema = str((header or {}).get("schema", MOTION_SCHEMA))
    return schema.startswith(_MOTIONS) or not schema.startswith(_OURS)


class DuetFolder:
    """Motion files as ``generate``, ``track`` and ``run`` write them, also in subfolders.

    So does physics reach the training: motions that the simulation repaired are read from disk.
    Other files of this project, such as rollouts and trajectories, are left out; a damaged or
    foreign file is an error when its turn comes.
    """

    def __init__(self, root: str | Path) -> None:
        """List the files; their arrays are read when asked for.

        Raises:
            MotionFileError: The folder does not exist or holds no motion.
        """
        self._root = Path(root)
        self._paths = [path for path in sorted(self._root.rglob("*.npz")) if _may_be_motion(path)]
        if not self._paths:
            raise MotionFileError("there is no motion (.npz) in this folder", where=str(root))

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
