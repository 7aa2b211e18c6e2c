"""Lines of a text file that is not trusted: bounded in size, in line length, and in encoding."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from robots.errors import MotionFileError
from robots.skeleton import FloatArray

MAX_TEXT_BYTES = 256 * 2**20
"""Largest text file that is read, bytes."""

MAX_LINE_BYTES = 2**20
"""Longest line that is read, bytes."""

MAX_VALUES = 32 * 2**20
"""Most numbers that are kept of one text file (256 MiB of them)."""

Lines = Iterator[tuple[str, list[str]]]
"""Pairs of a line's place (``file, line 7``) and its words."""


def word_lines(path: Path) -> Lines:
    """Yield the place and the words of every line that has any, reading as little as is asked for.

    Raises:
        MotionFileError: The file cannot be read, is no ordinary file, is too large, has an endless
            line, or is not UTF-8 text.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise MotionFileError("this is not an ordinary file", where=str(path))
        if status.st_size > MAX_TEXT_BYTES:
            raise MotionFileError(
                f"the file has {status.st_size / 2**20:.0f} MiB",
                where=str(path),
                allowed=f"at most {MAX_TEXT_BYTES / 2**20:.0f} MiB",
            )
        with open(path, "rb") as file:
            number = 0
            while line := file.readline(MAX_LINE_BYTES + 1):
                number += 1
                place = f"{path}, line {number}"
                if len(line) > MAX_LINE_BYTES:
                    raise MotionFileError(
                        "the line is too long", where=place, allowed=f"{MAX_LINE_BYTES} bytes"
                    )
                words = _decoded(line, number, place).split()
                if words:
                    yield place, words
    except FileNotFoundError as error:
        raise MotionFileError("there is no such file", where=str(path)) from error
    except OSError as error:
        raise MotionFileError(
            f"cannot be read: {error.strerror or error}", where=str(path)
        ) from error


def numbers(words: list[str], place: str) -> FloatArray:
    """Return words as finite numbers.

    Raises:
        MotionFileError: A word is no number, or is not finite.
    """
    try:
        values = np.array(words, dtype=np.float64)
    except (ValueError, OverflowError) as error:
        raise MotionFileError("expected numbers", where=place) from error
    if not np.isfinite(values).all():
        raise MotionFileError("a number is not finite", where=place, hint="repair the file there")
    return values


def whole_number(word: str, place: str, what: str, *, most: int) -> int:
    """Return a word as a whole number between 0 and ``most``.

    Raises:
        MotionFileError: It is not one.
    """
    if not (word.isascii() and word.isdigit() and len(word) <= 18):
        raise MotionFileError(f"{what} is '{word[:40]}'", where=place, allowed=f"0 to {most}")
    value = int(word)
    if value > most:
        raise MotionFileError(f"claims {value} {what}", where=place, allowed=f"at most {most}")
    return value


def _decoded(line: bytes, number: int, place: str) -> str:
    try:
        return line.decode("utf-8-sig" if number == 1 else "utf-8")
    except UnicodeDecodeError as error:
        raise MotionFileError("this is not UTF-8 text", where=place) from error
