"""Weights on disk: safetensors for the numbers, JSON (``generator.model_folder``) for the rest."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from generator.model_folder import HEADER, checked_file, place_file, read_header, remove_others
from robots.errors import CheckpointError, MotionFileError, nearest
from robots.files import write_json

INSTALL = "pip install 'pasdedeux[train]'"


def save_weights(
    folder: str | Path,
    header: Mapping[str, Any],
    tensors: Mapping[str, Tensor],
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
        entry = place_file(folder, "weights", "safetensors", lambda path: save_file(plain, path))
        write_json(folder / HEADER, {**header, "weights": entry})
        remove_others(folder, entry)
    except (OSError, MotionFileError) as error:
        raise CheckpointError(f"cannot be written: {error}", where=str(folder)) from error
    except (TypeError, ValueError) as error:
        raise CheckpointError(f"the header is not JSON: {error}", where=str(folder)) from error
    return entry["sha256"]


def load_weights(folder: str | Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read what :func:`save_weights` wrote.

    Raises:
        CheckpointError: A file is missing, damaged, or not the one the header was written for.
    """
    folder = Path(folder)
    header = read_header(folder)
    path = checked_file(folder, header, "weights")
    header.pop("weights")
    try:
        return header, _safetensors().load_file(path)
    except CheckpointError:
        raise
    except Exception as error:  # safetensors raises an exception type of its own
        raise CheckpointError(f"cannot be read: {error}", where=str(path)) from error


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


def _safetensors() -> Any:
    try:
        from safetensors import torch as library
    except ImportError as error:
        raise CheckpointError("reading weights needs safetensors", hint=INSTALL) from error
    return library
