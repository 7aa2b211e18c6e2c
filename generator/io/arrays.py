"""Entries of array files that are not trusted: one ``.npy``, or the members of an ``.npz``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.io.text import MAX_VALUES
from robots.errors import MotionFileError
from robots.files import MAX_BYTES, parse_npy
from robots.skeleton import FloatArray

MAX_TEXT = 10_000
"""Most characters kept of a text entry."""


def read_npy(path: Path) -> NDArray[Any]:
    """Return the array of an ``.npy``.

    Raises:
        MotionFileError: It cannot be read, is too large, or is no plain array.
    """
    try:
        if not path.is_file():
            raise MotionFileError(
                "this is not an ordinary file" if path.exists() else "there is no such file",
                where=str(path),
            )
        if path.stat().st_size > MAX_BYTES:
            raise MotionFileError(
                f"the file has {path.stat().st_size / 2**20:.0f} MiB",
                where=str(path),
                allowed=f"at most {MAX_BYTES / 2**20:.0f} MiB",
            )
        data = path.read_bytes()
    except OSError as error:
        raise MotionFileError(
            f"cannot be read: {error.strerror or error}", where=str(path)
        ) from error
    return parse_npy(data, where=str(path))


def floats(array: NDArray[Any], where: str) -> FloatArray:
    """Return a numeric array as floats.

    Raises:
        MotionFileError: It is not numeric, or too large: small types grow eightfold here.
    """
    if array.size > MAX_VALUES:
        raise MotionFileError(
            f"holds {array.size} numbers", where=where, allowed=f"at most {MAX_VALUES}"
        )
    if array.dtype.kind not in "iuf":
        raise MotionFileError(f"holds {array.dtype}, not numbers", where=where)
    return array.astype(np.float64, copy=False)


def number_entry(arrays: Mapping[str, NDArray[Any]], key: str, where: str) -> float | None:
    """Return a single number of an archive, or ``None`` if it has no such entry.

    Raises:
        MotionFileError: The entry is not a single number.
    """
    if key not in arrays:
        return None
    values = floats(arrays[key], f"{where}[{key}]")
    if values.size != 1:
        raise MotionFileError(
            f"'{key}' has shape {values.shape}", where=where, allowed="one number"
        )
    return float(values.reshape(()))


def text_entry(arrays: Mapping[str, NDArray[Any]], keys: tuple[str, ...], where: str) -> str:
    """Return the text under the first of ``keys`` that an archive has, or ``""``.

    Raises:
        MotionFileError: The entry is not a single text.
    """
    for key in keys:
        if key in arrays:
            array = arrays[key]
            if array.size != 1 or array.dtype.kind not in "SU":
                raise MotionFileError(f"'{key}' is not a text", where=where)
            return _texts(array, f"{where}[{key}]")[0]
    return ""


def name_entries(array: NDArray[Any], where: str, *, most: int) -> list[str]:
    """Return an array of names as texts.

    Raises:
        MotionFileError: It is not a list of at most ``most`` names.
    """
    if array.ndim != 1 or array.dtype.kind not in "SU" or len(array) > most:
        raise MotionFileError(
            f"is {array.dtype} with shape {array.shape}",
            where=where,
            allowed=f"a list of at most {most} names",
        )
    return _texts(array, where)


def _texts(array: NDArray[Any], where: str) -> list[str]:
    try:
        texts = [
            value.decode("utf-8") if isinstance(value, bytes) else str(value)
            for value in array.reshape(-1).tolist()
        ]
        for text in texts:
            text.encode("utf-8")  # lone surrogates cannot be written again
    except ValueError as error:  # UnicodeError is one; numpy raises others for absurd characters
        raise MotionFileError("this is not Unicode text", where=where) from error
    return [text[:MAX_TEXT] for text in texts]
