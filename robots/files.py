"""Files that are whole or absent, and archives that are safe to open.

**The problem.** ``numpy.load`` raises five kinds of exception on a damaged file, executes pickles
unless told not to, and allocates whatever a header claims: a file of a few hundred bytes can ask
for terabytes. Every array file of this project therefore passes through here. An archive is a plain
``.npz`` with one extra member ``header.json``; sizes and types are checked against the directory of
the zip before memory is taken, and every failure comes out as :class:`MotionFileError`.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import struct
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from robots.errors import MotionFileError

MAX_BYTES = 256 * 2**20
"""Largest total size of the arrays in one archive, in bytes."""

HEADER_MEMBER = "header.json"
MAX_HEADER_BYTES = 16 * 2**20

MAX_DIRECTORY_BYTES = 2**20
"""Largest directory of a zip: some ten thousand members. Python keeps ten times its size."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""What numpy writes. Others can claim gigabytes for a dictionary before the first byte."""


@contextmanager
def whole_file(path: str | Path) -> Iterator[IO[bytes]]:
    """Yield a binary file that becomes ``path`` only if the block ends without an error.

    Parent folders are created. The temporary file lies in the same folder, so the rename is atomic.

    Raises:
        MotionFileError: The folder cannot be written to.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = tempfile.NamedTemporaryFile(  # noqa: SIM115 - renamed, not closed away
            dir=path.parent, prefix=f".{path.name}.", delete=False
        )
    except OSError as error:
        raise MotionFileError(
            f"cannot be written: {error.strerror or error}",
            where=str(path),
            hint="choose another place with -o",
        ) from error
    try:
        with handle:
            yield handle
        os.chmod(handle.name, 0o666 & ~_umask())
        os.replace(handle.name, path)
    except BaseException as error:
        Path(handle.name).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise MotionFileError(
                f"cannot be written: {error.strerror or error}",
                where=str(path),
                hint="choose another place with -o",
            ) from error
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def write_json(path: str | Path, value: object) -> None:
    """Write ``value`` as indented JSON, whole or not at all."""
    with whole_file(path) as file:
        file.write((json.dumps(value, indent=2, allow_nan=False) + "\n").encode())


def plain(value: Any) -> Any:
    """Return ``value`` as JSON can hold it.

    Dataclasses and mappings become objects, tuples become lists, paths become text, numpy's numbers
    become plain ones, and numbers that are not finite become null.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def sha256(path: str | Path) -> str:
    """Return the SHA-256 of a file's bytes, in hex.

    Raises:
        MotionFileError: The file cannot be read.
    """
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError as error:
        raise MotionFileError(
            f"cannot be read: {error.strerror or error}", where=str(path)
        ) from error


def write_archive(
    path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write arrays and a JSON header as one ``.npz``; the same content gives the same bytes."""
    with whole_file(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        text = json.dumps(header, indent=1, allow_nan=False, sort_keys=True)
        _write_member(archive, HEADER_MEMBER, text.encode())
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(array), allow_pickle=False)
            _write_member(archive, f"{name}.npy", buffer.getvalue())


def _write_member(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    info.compress_type = zipfile.ZIP_DEFLATED
    archive.writestr(info, data)


def read_archive(
    path: str | Path, *, max_bytes: int = MAX_BYTES, header_only: bool = False
) -> tuple[dict[str, Any] | None, dict[str, NDArray[Any]]]:
    """Read an ``.npz`` without trusting it.

    Args:
        path: The file.
        max_bytes: Cap on the summed size of all arrays.
        header_only: Leave the arrays where they are.

    Returns:
        The JSON header (``None`` for a foreign ``.npz`` without one) and the arrays by name.

    Raises:
        MotionFileError: Whatever is wrong with the file.
    """
    where = str(path)
    try:
        with open(path, "rb") as file:
            magic = file.read(2)
            if magic == b"":
                raise MotionFileError("the file is empty", where=where)
            if magic != b"PK":
                raise MotionFileError(
                    "this is not an npz archive", where=where, hint=_foreign_hint(magic)
                )
            _require_small_directory(file)
            file.seek(0)
            with zipfile.ZipFile(file) as archive:
                members = [info for info in archive.infolist() if not info.is_dir()]
                total = sum(info.file_size for info in members)
                if total > max_bytes:
                    raise MotionFileError(
                        f"claims {total / 2**20:.0f} MiB of content",
                        where=where,
                        allowed=f"at most {max_bytes / 2**20:.0f} MiB",
                    )
                header = None
                arrays: dict[str, NDArray[Any]] = {}
                for info in members:
                    if info.filename == HEADER_MEMBER:
                        header = _parse_header(_bounded(archive, info, MAX_HEADER_BYTES), where)
                    elif info.filename.endswith(".npy") and not header_only:
                        data = _bounded(archive, info, max_bytes)
                        name = info.filename.removesuffix(".npy")
                        arrays[name] = parse_npy(data, where=f"{where}[{name}]")
                return header, arrays
    except (OSError, EOFError, zlib.error, ValueError, RuntimeError, NotImplementedError) as error:
        raise MotionFileError(f"cannot be read: {_reason(error)}", where=where) from error
    except zipfile.BadZipFile as error:
        raise MotionFileError(
            f"the archive is damaged or cut off ({error})",
            where=where,
            hint="copy or make the file again",
        ) from error


def _require_small_directory(file: IO[bytes]) -> None:
    """Find the end of a zip's directory as zipfile does, and check the size stated there."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 22 - 2**16))
    tail = file.read()
    at = len(tail) - 22
    if tail[at : at + 4] != b"PK\5\6" or tail[-2:] != b"\0\0":
        at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) - at < 22:
        raise zipfile.BadZipFile("it has no directory")
    (directory,) = struct.unpack_from("<I", tail, at + 12)
    is_zip64 = at >= 20 and tail[at - 20 : at - 16] == b"PK\6\7"
    if directory > MAX_DIRECTORY_BYTES or is_zip64:
        raise zipfile.BadZipFile("its directory claims more members than a motion can need")


def _reason(error: BaseException) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or repr(error)


def _foreign_hint(magic: bytes) -> str:
    if magic[:1] == b"\x80":
        return "it looks like a pickle, which is never opened because it can run code"
    return ""


def _bounded(archive: zipfile.ZipFile, info: zipfile.ZipInfo, limit: int) -> bytes:
    if info.compress_type not in _METHODS:
        raise zipfile.BadZipFile(f"member {info.filename} is compressed in a way numpy never does")
    with archive.open(info) as member:
        data = member.read(min(info.file_size, limit) + 1)
    if len(data) > info.file_size or len(data) > limit:
        raise zipfile.BadZipFile(f"member {info.filename} is larger than it claims")
    return data


def _parse_header(data: bytes, where: str) -> dict[str, Any]:
    try:
        header = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise MotionFileError("header.json is not valid JSON", where=where) from error
    if not isinstance(header, dict):
        raise MotionFileError("header.json is not an object", where=where)
    return header


def parse_npy(data: bytes, *, where: str) -> NDArray[Any]:
    """Parse the bytes of one ``.npy``; never unpickles, never allocates more than ``data`` holds.

    Raises:
        MotionFileError: The bytes are not a plain numeric or string array.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        elif version == (2, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
        else:
            raise MotionFileError(f"npy version {version} is not supported", where=where)
    except MotionFileError:
        raise
    except Exception as error:  # numpy parses the header with eval-like code: anything can come
        hint = _foreign_hint(data[:1])
        raise MotionFileError("this is not a npy array", where=where, hint=hint) from error
    if dtype.hasobject or dtype.kind not in "biufUS":
        raise MotionFileError(
            f"arrays of type {dtype} are not read",
            where=where,
            allowed="numbers and strings; objects would need pickle, which can run code",
        )
    expected = math.prod(shape) * dtype.itemsize
    if any(n < 0 for n in shape) or expected != len(data) - stream.tell():
        raise MotionFileError(
            f"the header claims shape {shape} ({expected} bytes) but the file holds"
            f" {len(data) - stream.tell()}",
            where=where,
        )
    try:
        if (
            dtype.kind == "U"
        ):  # numpy passes impossible characters on, and Python stumbles over them
            codes = np.frombuffer(data, f"{dtype.byteorder}u4", offset=stream.tell())
            if codes.max(initial=0) > sys.maxunicode:
                raise MotionFileError("a text is not Unicode", where=where)
        array = np.frombuffer(data, dtype, offset=stream.tell())
        return array.reshape(shape, order="F" if fortran else "C").copy()
    except (ValueError, TypeError, OverflowError) as error:  # empty texts, absurd dimensions
        raise MotionFileError(f"an array cannot have shape {shape}", where=where) from error
