"""Models on disk: a folder with ``model.json`` and the files it names by their hashes. Torch-free.

A file's name contains its own hash, and the JSON is replaced last and in one step, so a crash at
any moment leaves either the old model or the new one, never half of each. Nothing in a folder can
run code.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from robots.errors import CheckpointError, DuetError, nearest

HEADER = "model.json"
SHIPPED = Path(__file__).parent / "runtime" / "shipped"
"""The model that comes with the package, if one does."""
MAX_HEADER_BYTES = 16 * 2**20
_FILE_NAME = re.compile(r"[a-z]+-[0-9a-f]{16}\.[a-z]+")


def shipped_folder() -> Path | None:
    """Return the folder of the model that comes with the package; ``None`` if none does."""
    return SHIPPED if (SHIPPED / HEADER).is_file() else None


def read_header(folder: str | Path) -> dict[str, Any]:
    """Return the JSON of a model's folder, as it stands.

    Raises:
        CheckpointError: It is missing or not JSON.
    """
    path = Path(folder) / HEADER
    try:
        with open(path, "rb") as file:
            text = file.read(MAX_HEADER_BYTES + 1)
        header = json.loads(text) if len(text) <= MAX_HEADER_BYTES else None
    except FileNotFoundError as error:
        raise CheckpointError(
            f"there is no {HEADER}", where=str(folder), hint="a model is a folder with this file"
        ) from error
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"cannot be read: {error}", where=str(path)) from error
    if not isinstance(header, dict):
        raise CheckpointError("the header is not a JSON object", where=str(path))
    return header


def require_format(header: Mapping[str, Any], name: str, version: int, where: str) -> None:
    """Do nothing if a header is of this format.

    Raises:
        CheckpointError: It is of another, or of another version.
    """
    if header.get("format") != name or header.get("version") != version:
        raise CheckpointError(
            f"the format is {header.get('format')!r} version {header.get('version')!r}",
            where=where,
            allowed=f"{name} version {version}",
        )


def from_json(kind: type, value: Any, where: str) -> Any:
    """Return the dataclass ``kind`` that a header holds as an object.

    Raises:
        CheckpointError: An entry is unknown or wrong.
    """
    if not isinstance(value, dict):
        raise CheckpointError(f"the header has no {kind.__name__}", where=where)
    known = {item.name for item in fields(kind)}
    for key in value:
        if key not in known:
            raise CheckpointError(
                f"the header has an unknown entry '{key}'", where=where, hint=nearest(key, known)
            )
    try:
        return kind(**value)
    except (DuetError, TypeError) as error:
        raise CheckpointError(f"the header is wrong: {error}", where=where) from error


def checked_file(folder: str | Path, header: Mapping[str, Any], entry: str) -> Path:
    """Return the path of a file that a header names, after comparing its hash.

    Args:
        folder: Of the model.
        header: What :func:`read_header` gave.
        entry: Key of the object that holds ``file`` and ``sha256``.

    Raises:
        CheckpointError: The header names no such file, or it is missing or damaged.
    """
    folder = Path(folder)
    found = header.get(entry)
    if not isinstance(found, dict) or not _FILE_NAME.fullmatch(str(found.get("file", ""))):
        raise CheckpointError(f"the header names no {entry}", where=str(folder / HEADER))
    path = folder / found["file"]
    try:
        damaged = _digest(path) != found.get("sha256")
    except OSError as error:
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else error
        raise CheckpointError(f"cannot be read: {reason}", where=str(path)) from error
    if damaged:
        raise CheckpointError(
            f"the {entry} are damaged: the SHA-256 is not the one in the header",
            where=str(path),
            hint="copy or make the model again",
        )
    return path


def place_file(
    folder: Path, kind: str, suffix: str, write: Callable[[str], None]
) -> dict[str, str]:
    """Let ``write`` make a file, and return the entry that names it by its hash.

    Older files of the kind stay, for the header that names them is still in place; see
    :func:`remove_others`.

    Args:
        folder: Of the model; made if it does not exist.
        kind: First part of the file's name, small letters.
        suffix: Last part, without the dot.
        write: Given the path to write to.

    Raises:
        OSError: It cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=folder, prefix=f".{kind}-")
    os.close(handle)
    try:
        write(temporary)
        digest = _digest(Path(temporary))
        name = f"{kind}-{digest[:16]}.{suffix}"
        _flush(Path(temporary))
        os.chmod(temporary, 0o644)
        os.replace(temporary, folder / name)
    finally:
        Path(temporary).unlink(missing_ok=True)
    return {"file": name, "sha256": digest}


def remove_others(folder: Path, entry: Mapping[str, str]) -> None:
    """Delete older files of the kind that an entry names."""
    kind, suffix = entry["file"].partition("-")[0], Path(entry["file"]).suffix
    for old in folder.glob(f"{kind}-*{suffix}"):
        if old.name != entry["file"] and _FILE_NAME.fullmatch(old.name):
            old.unlink(missing_ok=True)


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _flush(path: Path) -> None:
    """Make sure that the bytes are on the disk before a name points to them."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())
