"""Real clips, which never enter the project: their spectra, and some of them to learn from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.results.spectra import velocity_power
from generator.finishing.resample import resample
from generator.io import read_motion, write_motion
from robots.errors import MotionFileError, SpecError
from robots.files import read_archive, write_archive

SPECTRA, LEARNT = "clips-spectra.npz", "real"
"""File and folder in the folder of results."""
HELD_OUT = 3
"""One clip in so many is held out from training; so is each without a sentence."""
INDEX = "index.json"
"""What is done in clips that do not say so themselves: beside them or in the folder above, a list
of objects with ``files`` and ``description``."""
FPS = 30.0
"""Rate that all clips are brought to."""


def keep_real(folder: Path, root: Path) -> tuple[int, int]:
    """Write the spectra of all duets in a folder, and motions with sentences to learn from.

    Args:
        folder: Of motion files, ordered by name.
        root: Folder of results.

    Returns:
        How many are learnt from, and how many are held out.

    Raises:
        MotionFileError: A clip or the index cannot be read.
        SpecError: There are no clips.
    """
    files = sorted(file for file in folder.glob("*.npz") if file.is_file())
    if not files:
        raise SpecError("there are no motion files (*.npz)", where=str(folder))
    known = _sentences(folder)
    for earlier in (root / LEARNT).glob("*.npz"):
        earlier.unlink()
    spectra, learnt = [], []
    for number, file in enumerate(files, 1):
        motion = read_motion(file)
        text = motion.text or known.get(file.name, "")
        spectra.append(velocity_power(resample(motion.keypoints, motion.fps, FPS), FPS))
        learnt.append(bool(text) and number % HELD_OUT != 0)
        if learnt[-1]:
            (root / LEARNT).mkdir(parents=True, exist_ok=True)
            write_motion(replace(motion, text=text), root / LEARNT / file.name)
    facts = {"clips": [file.stem for file in files], "learnt": learnt}
    write_archive(root / SPECTRA, facts, {"spectra": np.array(spectra)})
    return sum(learnt), len(learnt) - sum(learnt)


def power_of(root: Path) -> dict[str, Any]:
    """Return mean spectra of the clips that are held out and of those that are learnt from.

    Raises:
        MotionFileError: The file is damaged.
    """
    path = root / SPECTRA
    if not path.is_file():
        return {}
    try:
        header, arrays = read_archive(path)
        learnt, spectra = np.array((header or {})["learnt"], bool), arrays["spectra"]
        parts = {"held out": spectra[~learnt], "learnt from": spectra[learnt]}
    except (KeyError, IndexError) as error:
        raise MotionFileError("holds no spectra", where=str(path)) from error
    return {name: np.nanmean(part, axis=0) for name, part in parts.items() if len(part)}


def _sentences(folder: Path) -> dict[str, str]:
    """Return what an index says of files by name, without remarks in brackets."""
    for path in (folder / INDEX, folder.parent / INDEX):
        if path.is_file():
            try:
                return {
                    Path(file).name: entry["description"].split(" (")[0]
                    for entry in json.loads(path.read_text(encoding="utf-8"))
                    for file in entry["files"]
                }
            except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                raise MotionFileError(
                    "is no list of objects with 'files' and 'description'", where=str(path)
                ) from error
    return {}
