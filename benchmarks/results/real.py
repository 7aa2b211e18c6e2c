"""The spectrum of real clips, which never enter the project, from a folder of motion files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.results.spectra import velocity_power
from generator.finishing.resample import resample
from generator.io import read_motion
from robots.errors import SpecError
from robots.files import write_archive

CLIPS = "clips-spectra"
"""Name of the file in the folder of results, without its ending."""
FPS = 30.0
"""Rate that all clips are brought to."""


def keep_spectra(folder: Path, path: Path) -> int:
    """Write the spectra of all duets in a folder; return how many they are.

    Raises:
        MotionFileError: A clip cannot be read.
        SpecError: There are none.
    """
    files = sorted(file for file in folder.glob("*.npz") if file.is_file())
    if not files:
        raise SpecError("there are no motion files (*.npz)", where=str(folder))
    spectra = []
    for file in files:
        motion = read_motion(file)
        spectra.append(velocity_power(resample(motion.keypoints, motion.fps, FPS), FPS))
    write_archive(path, {"clips": [file.stem for file in files]}, {"spectra": np.array(spectra)})
    return len(files)
