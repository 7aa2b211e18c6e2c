"""InterHuman, from a copy on the user's disk.

Its licence forbids passing it on, so nothing of it ships.

What is read of the folder:

    motions_processed/person1/<id>.npy, person2/<id>.npy   (T, 492), 30 frames per second
    annots/<id>.txt                                        sentences, one a line
    train.txt, val.txt, test.txt, ignore_list.txt          here or in split/; one id a line

The rotations are used as the files give them, in SMPL's rest frames.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np

from generator.data.clip import Clip
from generator.data.duets import fingerprint_of
from generator.features import Poses, release_poses
from generator.io.arrays import floats, read_npy
from generator.io.assembly import require_frames, same_length
from generator.io.interhuman import FPS, LICENCE, WIDTH
from generator.io.text import word_lines
from robots.errors import MotionError, MotionFileError

log = logging.getLogger(__name__)

_ID = re.compile(r"\w[\w.-]{0,99}")
_PROCESSED = "motions_processed"
_MAX_TEXT = 1000
"""Characters kept of a sentence."""


class InterHuman:
    """The clips of one split, or all of them."""

    def __init__(self, root: str | Path, split: str | None = "train") -> None:
        """List the clips; they are opened when asked for.

        Listed clips whose files are missing are left out with a warning, as the release does.

        Args:
            root: The folder of the dataset.
            split: ``train``, ``val``, ``test``, or ``None`` for every clip that is not ignored.

        Raises:
            MotionFileError: The folder does not hold the processed motions, there is no such split
                list, it holds no usable clip, or an id in it is not a file name.
        """
        self._root = Path(root)
        self._split = split
        self._first, self._second = (self._root / _PROCESSED / f"person{p}" for p in "12")
        self._require_processed()
        present = {path.stem for path in self._first.glob("*.npy")}
        listed = sorted(present) if split is None else self._list(split)
        ignored = set(self._list("ignore_list", needed=False))
        wanted = [name for name in dict.fromkeys(listed) if name not in ignored]
        self._ids = [name for name in wanted if name in present]
        missing = [name for name in wanted if name not in present]
        if not self._ids:
            raise MotionFileError(
                f"none of the {len(wanted)} clips of '{split or 'all'}' is there",
                where=str(self._first),
            )
        if missing:
            log.warning(
                "%s: %d of %d listed clips have no file, the first is %s",
                self._first,
                len(missing),
                len(wanted),
                missing[0],
            )

    @property
    def name(self) -> str:
        """The dataset and the split."""
        return f"InterHuman {self._split or 'all'}"

    @property
    def fingerprint(self) -> str:
        """Names, sizes and times of all files that are read."""
        paths = [folder / f"{name}.npy" for name in self._ids for folder in self._folders]
        paths += [path for name in self._ids if (path := self._annotation(name)).is_file()]
        return f"interhuman {self._split}\n" + fingerprint_of(self._root, paths)

    def __len__(self) -> int:
        """Return the number of clips."""
        return len(self._ids)

    def clip(self, index: int) -> Clip:
        """Return a clip.

        Raises:
            MotionFileError: A file is cut short or damaged, or the two do not belong together.
        """
        name = self._ids[index]
        paths = [folder / f"{name}.npy" for folder in self._folders]
        columns = [_columns(path) for path in paths]
        first, second = same_length(columns[0], columns[1], f"{paths[0]}, {paths[1].parent.name}")
        a, b = (_poses(x, path) for x, path in zip((first, second), paths, strict=True))
        return Clip(name, (a, b), FPS, self._texts(name), LICENCE)

    @property
    def _folders(self) -> tuple[Path, Path]:
        return self._first, self._second

    def _annotation(self, name: str) -> Path:
        return self._root / "annots" / f"{name}.txt"

    def _texts(self, name: str) -> tuple[str, ...]:
        path = self._annotation(name)
        if not path.is_file():
            log.warning("%s: there is no sentence for this clip", path)
            return ("",)
        texts = tuple(" ".join(words)[:_MAX_TEXT] for _, words in word_lines(path))
        return texts or ("",)

    def _list(self, name: str, *, needed: bool = True) -> list[str]:
        """Return the ids of a list; the last line may lack its newline."""
        places = [folder / f"{name}.txt" for folder in (self._root, self._root / "split")]
        found = next((path for path in places if path.is_file()), None)
        if found is None:
            if not needed:
                return []
            raise MotionFileError(
                f"there is no list of the split '{name}'",
                where=str(self._root),
                allowed=" or ".join(str(path.relative_to(self._root)) for path in places),
            )
        ids = []
        for place, words in word_lines(found):
            if len(words) != 1 or not _ID.fullmatch(words[0]) or ".." in words[0]:
                raise MotionFileError("this is not a clip's id", where=place)
            ids.append(words[0])
        return ids

    def _require_processed(self) -> None:
        if self._first.is_dir() and self._second.is_dir():
            return
        raw = next((self._root / "motions").glob("*.pkl"), None)
        if raw is not None:
            raise MotionFileError(
                "these are the raw motions, in pickles, which are never opened because they can"
                " run code",
                where=str(raw.parent),
                allowed=f"the processed motions of the same dataset, in {_PROCESSED}/",
            )
        raise MotionFileError(
            f"there are no folders {_PROCESSED}/person1 and person2",
            where=str(self._root),
            hint="give the folder that InterHuman was unpacked to",
        )


def _columns(path: Path) -> np.ndarray:
    array = read_npy(path)
    if array.ndim != 2 or array.shape[1] != WIDTH:
        raise MotionFileError(
            f"has shape {array.shape}", where=str(path), allowed=f"(frames, {WIDTH})"
        )
    require_frames(len(array), str(path))
    return floats(array, str(path))


def _poses(columns: np.ndarray, path: Path) -> Poses:
    try:
        return release_poses(columns)
    except MotionError as error:
        raise MotionFileError(error.what, where=str(path)) from error
