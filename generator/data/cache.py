"""Clips in a memory-mapped file, computed once.

A cache is a folder named after the hash of everything it depends on: the source's fingerprint, the
frame rate and the format. In it, ``poses.npy`` holds all frames of all clips one after the other,
``[N, 2, 196]`` float32 (22 positions, 21 rotations and 4 contacts per person, y-up), and
``index.json`` says which are whose. The folder appears under its name only when it is complete; one
that was interrupted stays behind as ``.*.partial`` and may be deleted.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from generator.data.clip import Clip, ClipSource, Symmetric, resampled
from generator.features import LOCAL_ROTATIONS, POINTS, Poses
from robots.errors import DuetError, MotionError, MotionFileError
from robots.files import write_json
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

FORMAT = "pasdedeux.clips/2"
WIDTH = 3 * POINTS + 6 * LOCAL_ROTATIONS + 4

_POSES, _INDEX = "poses.npy", "index.json"
_SPLITS = (3 * POINTS, 3 * POINTS + 6 * LOCAL_ROTATIONS)
_HINT = "delete the folder; it is made again"

Progress = Callable[[int, int], None]


class ClipCache:
    """Clips of a cache folder; frames are read from disk when they are needed."""

    def __init__(self, folder: str | Path) -> None:
        """Open a folder.

        Raises:
            MotionFileError: Something is missing, damaged, or of another version.
        """
        self.folder = Path(folder)
        where = str(self.folder)
        try:
            index = json.loads((self.folder / _INDEX).read_bytes())
            if index["format"] != FORMAT:
                raise MotionFileError(
                    f"this is a '{index['format']}'", where=where, allowed=FORMAT, hint=_HINT
                )
            self.name, self.fps = str(index["source"]), float(index["fps"])
            self._clips = [_entry(entry) for entry in index["clips"]]
            # np.lib.format.open_memmap would follow a header that claims more than the file holds.
            data = np.load(self.folder / _POSES, mmap_mode="r", allow_pickle=False)
        except MotionFileError:
            raise
        except (OSError, EOFError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise MotionFileError(
                f"the cache is damaged ({error})", where=where, hint=_HINT
            ) from error
        ends = [start + frames for _, start, frames, *_ in self._clips]
        if data.dtype != np.float32 or data.shape != (max(ends, default=0), 2, WIDTH):
            raise MotionFileError(
                f"{_POSES} is {data.dtype} with shape {data.shape}, which the index contradicts",
                where=where,
                hint=_HINT,
            )
        self._data = data

    def __len__(self) -> int:
        """Return the number of clips."""
        return len(self._clips)

    @property
    def lengths(self) -> list[int]:
        """Frames of every clip."""
        return [frames for _, _, frames, *_ in self._clips]

    @property
    def licences(self) -> tuple[str, ...]:
        """The licences of its clips, each once; what is trained on them must carry them."""
        return tuple(sorted({licence for *_, licence, _ in self._clips if licence}))

    def clip(self, index: int) -> Clip:
        """Return a clip.

        Raises:
            MotionFileError: The file holds numbers that are not finite.
        """
        name, start, frames, labelled, texts, licence, symmetric = self._clips[index]
        block = np.asarray(self._data[start : start + frames], float)
        try:
            a, b = (_unpacked(block[:, i], labelled) for i in range(2))
            return Clip(name, (a, b), self.fps, texts, licence, symmetric)
        except MotionError as error:
            raise MotionFileError(
                f"clip '{name}': {error.what}", where=str(self.folder), hint=_HINT
            ) from error


_Entry = tuple[str, int, int, bool, tuple[str, ...], str, Symmetric | None]


def _entry(data: dict[str, Any]) -> _Entry:
    name, start, frames = str(data["name"]), int(data["start"]), int(data["frames"])
    if start < 0 or frames < 2:
        raise ValueError(f"clip '{name}' has {frames} frames from {start}")
    texts = tuple(str(text) for text in data["texts"]) or ("",)
    symmetric = None
    if data["symmetric"] is not None:
        symmetric = Symmetric(*(tuple(map(str, group)) for group in data["symmetric"]))
    return name, start, frames, bool(data["labelled"]), texts, str(data["licence"]), symmetric


def cached(
    source: ClipSource,
    root: str | Path,
    *,
    fps: float = 30.0,
    progress: Progress | None = None,
) -> ClipCache:
    """Return the cache of a source, made now unless it is there already.

    Args:
        source: Where the clips come from.
        root: Folder of all caches.
        fps: Frames per second to which every clip is brought.
        progress: Called with the number of clips done and their total.

    Raises:
        MotionFileError: A clip cannot be read, or the cache cannot be written.
    """
    key = hashlib.sha256(f"{FORMAT}\n{fps!r}\n{source.fingerprint}".encode()).hexdigest()[:20]
    folder = Path(root) / key
    if folder.is_dir():
        return ClipCache(folder)
    log.info("caching %s at %g frames per second in %s", source.name, fps, folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(dir=root, prefix=f".{key}.", suffix=".partial"))
        try:
            _write(source, partial, fps, progress)
            _publish(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise MotionFileError(
            f"cannot be written: {error.strerror or error}", where=str(folder)
        ) from error
    return ClipCache(folder)


def _publish(partial: Path, folder: Path) -> None:
    try:
        partial.rename(folder)
    except OSError:
        if not folder.is_dir():  # else another process was faster, with the same content
            raise


def _write(source: ClipSource, folder: Path, fps: float, progress: Progress | None) -> None:
    entries: list[dict[str, Any]] = []
    start = 0
    with open(folder / _POSES, "wb") as file:
        header = _write_header(file, 0)
        for index in range(len(source)):
            clip = _resampled(source.clip(index), fps)
            labelled = all(person.contacts is not None for person in clip.poses)
            block = np.stack([_packed(person) for person in clip.poses], axis=1)
            file.write(np.ascontiguousarray(block, "<f4").tobytes())
            entries.append(
                {
                    "name": clip.name,
                    "start": start,
                    "frames": clip.frames,
                    "labelled": labelled,
                    "texts": list(clip.texts),
                    "licence": clip.licence,
                    "symmetric": clip.symmetric,
                }
            )
            start += clip.frames
            if progress is not None:
                progress(index + 1, len(source))
        file.seek(0)
        if _write_header(file, start) != header:
            raise OSError("the header of the array grew")  # numpy leaves room for the first axis
    write_json(
        folder / _INDEX, {"format": FORMAT, "source": source.name, "fps": fps, "clips": entries}
    )


def _resampled(clip: Clip, fps: float) -> Clip:
    try:
        return resampled(clip, fps)
    except DuetError as error:
        raise MotionFileError(error.what, where=clip.name, hint=error.hint) from error


def _write_header(file: IO[bytes], frames: int) -> int:
    buffer = io.BytesIO()
    header = {"descr": "<f4", "fortran_order": False, "shape": (frames, 2, WIDTH)}
    np.lib.format.write_array_header_1_0(buffer, header)
    return file.write(buffer.getvalue())


def _packed(person: Poses) -> FloatArray:
    rows = person.frames
    contacts = np.zeros((rows, 4)) if person.contacts is None else person.contacts
    flat = (person.positions.reshape(rows, -1), person.rotations.reshape(rows, -1), contacts)
    return np.concatenate(flat, axis=1)


def _unpacked(rows: FloatArray, labelled: bool) -> Poses:
    positions, rotations, contacts = np.split(rows, _SPLITS, axis=1)
    return Poses(
        positions.reshape(-1, POINTS, 3),
        rotations.reshape(-1, LOCAL_ROTATIONS, 6),
        contacts if labelled else None,
    )
