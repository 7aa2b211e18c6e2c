"""Pairs of InterHuman ``motions_processed/person1/<id>.npy`` and ``person2/<id>.npy``.

Each is ``(T, 492)``, 30 frames per second, metres, z up: columns 0 to 65 are 22 SMPL-H body
keypoints; hands and joint rotations follow. The rotations are relative to SMPL's rest pose, which
is not this project's, so rotations are fitted to the keypoints as for every other format.
"""

from __future__ import annotations

from pathlib import Path

from generator.io.arrays import floats, read_npy
from generator.io.assembly import RawDuet, assemble, require_frames, same_length
from generator.io.statement import Statement
from generator.io.text import word_lines
from generator.motion import DuetMotion
from robots.errors import MotionFileError
from robots.skeleton import FloatArray

WIDTH = 492
"""Columns by which the format is known."""

FPS = 30.0
LICENCE = "CC BY-NC-SA 4.0 (InterHuman; redistribution prohibited)"


def read_interhuman(paths: tuple[Path, Path], said: Statement) -> DuetMotion:
    """Return the motion of two files, with the first sentence of ``annots/<id>.txt``, if any.

    Raises:
        MotionFileError: A file does not fit, or the caller contradicts the format.
    """
    where = f"{paths[0]}, {paths[1]}"
    a, b = same_length(_keypoints(paths[0]), _keypoints(paths[1]), where)
    return assemble(
        RawDuet(
            a,
            b,
            said.settle_fps(where, FPS),
            said.settle_up(where, "z"),
            said.settle_scale(where, 1.0),
            where,
            f"InterHuman {paths[0].stem}",
            sentence(paths[0]),
            LICENCE,
        )
    )


def _keypoints(path: Path) -> FloatArray:
    array = read_npy(path)
    if array.ndim != 2 or array.shape[1] != WIDTH:
        raise MotionFileError(
            f"has shape {array.shape}", where=str(path), allowed=f"(frames, {WIDTH})"
        )
    require_frames(len(array), str(path))
    return floats(array[:, :66], str(path)).reshape(-1, 22, 3)


def sentence(path: Path) -> str:
    """Return the first sentence that the dataset gives the clip, or ``""``."""
    above = path.absolute().parents
    if len(above) < 3:
        return ""
    annotation = above[2] / "annots" / f"{path.stem}.txt"
    if not annotation.is_file():
        return ""
    return next((" ".join(words)[:1000] for _, words in word_lines(annotation)), "")
