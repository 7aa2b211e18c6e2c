"""Weights on disk: safetensors for the numbers, JSON for everything else. Nothing can run code.

A folder holds ``model.json`` and the file of tensors it names, whose name contains its own hash.
The JSON is replaced last and in one step, so a crash at any moment leaves either the old model or
the new one, never half of each.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from robots.errors import CheckpointError, MotionFileError, nearest
from robots.files import write_json

HEADER = "model.json"
MAX_HEADER_BYTES = 16 * 2**20
_FILE_NAME = re.compile(r"weights-[0-9a-f]{16}\.safetensors")
INSTALL = "pip install 'pasdedeux[train]'"


def save_weights(
    folder: str | Path, header: Mapping[str, Any], tensors: Mapping[str, Tensor]
) -> str:
    """Write tensors and their header, whole or not at all.

    Args:
        folder: Made if it does not exist; an older model in it is replaced.
        header: What :func:`load_weights` gives back. Anything that JSON can hold.
        tensors: By name; written contiguous, from the CPU.

    Returns:
        The SHA-256 of the file of tensors, in hex.

    Raises:
        CheckpointError: The folder cannot be written to, or the header is not JSON.
    """
    save_file = _safetensors().save_file
    folder = Path(folder)
    plain = {key: value.detach().cpu().contiguous() for key, value in tensors.items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=folder, prefix=".weights-")
        os.close(handle)
        try:
            save_file(plain, temporary)
            digest = _digest(Path(temporary))
            name = f"weights-{digest[:16]}.safetensors"
            _flush(Path(temporary))
            os.chmod(temporary, 0o644)
            os.replace(temporary, folder / name)
        finally:
            Path(temporary).unlink(missing_ok=True)
        write_json(folder / HEADER, {**header, "weights": {"file": name, "sha256": digest}})
        for old in folder.glob("weights-*.safetensors"):
            if old.name != name and _FILE_NAME.fullmatch(old.name):
                old.unlink(missing_ok=True)
    except (OSError, MotionFileError) as error:
        raise CheckpointError(f"cannot be written: {error}", where=str(folder)) from error
    except (TypeError, ValueError) as error:
        raise CheckpointError(f"the header is not JSON: {error}", where=str(folder)) from error
    return digest


def load_weights(folder: str | Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read what :func:`save_weights` wrote.

    Raises:
        CheckpointError: A file is missing, damaged, or not the one the header was written for.
    """
    folder = Path(folder)
    header = read_header(folder)
    entry = header.pop("weights", None)
    if not isinstance(entry, dict) or not _FILE_NAME.fullmatch(str(entry.get("file", ""))):
        raise CheckpointError("the header names no weights", where=str(folder / HEADER))
    path = folder / entry["file"]
    try:
        digest = _digest(path)
        if digest != entry.get("sha256"):
            raise CheckpointError(
                "the weights are damaged: their SHA-256 is not the one in the header",
                where=str(path),
                hint="copy or make the model again",
            )
        return header, _safetensors().load_file(path)
    except CheckpointError:
        raise
    except Exception as error:  # safetensors raises an exception type of its own
        reason = "there is no such file" if isinstance(error, FileNotFoundError) else error
        raise CheckpointError(f"cannot be read: {reason}", where=str(path)) from error


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


def adopt(module: nn.Module, tensors: Mapping[str, Tensor], *, where: str) -> None:
    """Give a module (which may be on the meta device) its weights: all of them, and no others.

    Raises:
        CheckpointError: A key is missing, unknown, of another shape, or not finite.
    """
    expected = module.state_dict()
    require({key: tuple(value.shape) for key, value in expected.items()}, tensors, where=where)
    same_type = {key: value.to(expected[key].dtype) for key, value in tensors.items()}
    module.load_state_dict(same_type, assign=True)


def require(
    shapes: Mapping[str, tuple[int, ...]], tensors: Mapping[str, Tensor], *, where: str
) -> None:
    """Check that exactly these keys are there, with these shapes and finite numbers.

    Raises:
        CheckpointError: Names the first key for which that is not so.
    """
    for key, shape in shapes.items():
        if key not in tensors:
            others = [name for name in tensors if name not in shapes]
            raise CheckpointError(f"key '{key}' is missing", where=where, hint=nearest(key, others))
        if tuple(tensors[key].shape) != tuple(shape):
            raise CheckpointError(
                f"key '{key}' has shape {tuple(tensors[key].shape)}",
                where=where,
                allowed=str(tuple(shape)),
            )
    for key, value in tensors.items():
        if key not in shapes:
            raise CheckpointError(
                f"key '{key}' does not belong to this architecture",
                where=where,
                hint=nearest(key, shapes),
            )
        if not torch.isfinite(value).all():
            raise CheckpointError(f"key '{key}' holds numbers that are not finite", where=where)


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _flush(path: Path) -> None:
    """Make sure that the bytes are on the disk before a name points to them."""
    with open(path, "rb") as file:
        os.fsync(file.fileno())


def _safetensors() -> Any:
    try:
        from safetensors import torch as library
    except ImportError as error:
        raise CheckpointError("reading weights needs safetensors", hint=INSTALL) from error
    return library


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
