"""Reads any motion file: finds the format and hands over to its module."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.io import interhuman, named, smplx
from generator.io.acclaim import read_acclaim
from generator.io.archive import SCHEMA, parse_motion
from generator.io.arrays import read_npy
from generator.io.bvh import read_bvh_pair
from generator.io.joints import parse_joints, parse_joints_archive
from generator.io.pairs import split_path, with_partner
from generator.io.statement import Statement, UpAxis
from generator.motion import DuetMotion
from robots.errors import DuetError, MotionFileError
from robots.files import read_archive

SUFFIXES = (".npz", ".npy", ".bvh", ".amc")
"""File names that are read."""

_PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")


def read_motion(
    path: str | Path,
    *,
    fps: float | None = None,
    up: UpAxis | None = None,
    scale: float | None = None,
) -> DuetMotion:
    """Return the motion of a file, or of two files with one person each, in metres with z up.

    The format follows from the file's name and content. Both people get rotations, fitted to the
    keypoints where the file is not the project's own. The motion is not grounded or smoothed.

    Args:
        path: A file; ``A,B`` for two files; a folder with two; or one of a pair
            (:mod:`generator.io.pairs`).
        fps: Frames per second, where the format does not state it; overrules a BVH's frame time.
        up: Up axis of the file, where the format does not state it.
        scale: Metres per unit of the file, where the format does not state it.

    Raises:
        MotionFileError: Whatever is wrong with the file, or missing beside it.
    """
    said = Statement(fps, up, scale)
    paths = split_path(path)
    where = ", ".join(str(p) for p in paths)
    try:
        # Absurd numbers overflow on the way to the check that refuses them.
        with np.errstate(all="ignore"):
            return _read(paths, said)
    except MotionFileError:
        raise
    except DuetError as error:
        raise MotionFileError(
            error.what, where=where, allowed=error.allowed, hint=error.hint
        ) from error


def _read(paths: tuple[Path, ...], said: Statement) -> DuetMotion:
    suffix = paths[0].suffix.lower()
    if len(paths) == 2 and paths[1].suffix.lower() != suffix:
        raise MotionFileError(
            "the two files are of different formats", where=f"{paths[0]}, {paths[1]}"
        )
    if suffix in _PICKLES:
        raise MotionFileError(
            "pickles are never opened, because they can run code",
            where=str(paths[0]),
            hint="save the arrays with numpy.savez",
        )
    if suffix == ".bvh":
        return read_bvh_pair(_pair(paths), said)
    if suffix == ".amc":
        return read_acclaim(_pair(paths), said)
    if suffix == ".npy":
        return _read_npy(paths, said)
    if suffix == ".npz":
        return _read_npz(paths, said)
    hint = "the motion is in the .amc" if suffix == ".asf" else "export it as BVH"
    raise MotionFileError(
        f"files named '{suffix}' are not read",
        where=str(paths[0]),
        allowed=", ".join(SUFFIXES),
        hint=hint,
    )


def _pair(paths: tuple[Path, ...]) -> tuple[Path, Path]:
    return (paths[0], paths[1]) if len(paths) == 2 else with_partner(paths[0])


def _read_npy(paths: tuple[Path, ...], said: Statement) -> DuetMotion:
    array = read_npy(paths[0])
    if array.ndim == 2 and array.shape[1] == interhuman.WIDTH:
        return interhuman.read_interhuman(_pair(paths), said)
    _require_single(paths)
    return parse_joints(array, said, paths[0])


def _read_npz(paths: tuple[Path, ...], said: Statement) -> DuetMotion:
    header, arrays = read_archive(paths[0])
    where = str(paths[0])
    if header is None and smplx.POSITIONS in arrays:
        return smplx.read_smplx(_pair(paths), said)
    _require_single(paths)
    if header is not None and "schema" in header:
        if header["schema"] != SCHEMA:
            raise MotionFileError(
                f"this is a '{str(header['schema'])[:60]}'", where=where, allowed=SCHEMA
            )
        return parse_motion(header, arrays, said, where)
    return _read_foreign(arrays, said, paths[0])


def _read_foreign(arrays: dict[str, NDArray[Any]], said: Statement, path: Path) -> DuetMotion:
    if arrays.keys() >= named.REQUIRED:
        return named.parse_named(arrays, said, path)
    return parse_joints_archive(arrays, said, path)


def _require_single(paths: tuple[Path, ...]) -> None:
    if len(paths) == 2:
        raise MotionFileError(
            "this format holds both people in one file", where=str(paths[0]), hint="give one path"
        )
