"""The choreographer's clips that physics let pass, as it repaired them or as they were.

The clips that are rejected are left out either way, so a run on repaired motion and one on the
motion as it was invented can learn from the same clips: same sentences, same number of frames, same
weight of every interaction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from generator.data.choreographed import Choreographed
from generator.data.clip import Clip
from generator.data.duets import fingerprint_of
from generator.data.verdict import Curation
from generator.features import Poses, poses_of
from generator.io import read_motion
from robots.errors import MotionFileError
from robots.skeleton import FloatArray, human_skeleton

KeptPoses = Literal["repaired", "raw"]
Unjudged = Literal["drop", "keep"]

SAME_BONES = 0.002
"""Difference, m, up to which bones are those of the same person; every clip has its own people."""


class Curated:
    """Clips of a choreographed source that a :class:`Curation` kept.

    Clips that are judged later are not seen: what there is is listed once.
    """

    def __init__(
        self,
        curation: Curation,
        *,
        poses: KeptPoses = "repaired",
        unjudged: Unjudged = "drop",
    ) -> None:
        """List what was kept; motions are read when they are asked for.

        Args:
            curation: Verdicts on the source.
            poses: Take kept clips as physics repaired them, or ``raw``, as they were invented.
            unjudged: Leave clips that have no verdict out, or keep them as they were invented.

        Raises:
            MotionFileError: A verdict is damaged or of another repertoire, a kept motion is
                missing, or no clip is left.
            SpecError: There is no such source.
        """
        self._curation, self._clips = curation, curation.clips
        self._repair = poses == "repaired"
        self._numbers: list[tuple[int, bool]] = []
        for number in range(curation.count):
            kept = _kept(curation, self._clips, number)
            if kept or (kept is None and unjudged == "keep"):
                self._numbers.append((number, bool(kept) and self._repair))
        if not self._numbers:
            raise MotionFileError(
                f"none of {self._clips.name} was kept",
                where=str(curation.folder),
                hint="let 'pasdedeux curate' judge them first",
            )
        files = [curation.motion_file(number) for number, repaired in self._numbers if repaired]
        self._files = fingerprint_of(curation.folder, files)

    @property
    def name(self) -> str:
        """The choreographer's source, how many of it, and in which form."""
        form = "repaired" if self._repair else "raw"
        return f"{len(self)} kept of {self._clips.name}, {form}"

    @property
    def fingerprint(self) -> str:
        """That of the source, the numbers of the clips, names, sizes and times of the motions."""
        numbers = ",".join(str(number) for number, _ in self._numbers)
        return f"curated\n{self._clips.fingerprint}\n{numbers}\n{self._files}"

    def __len__(self) -> int:
        """Return the number of clips."""
        return len(self._numbers)

    def clip(self, index: int) -> Clip:
        """Return a clip, with all its sentences.

        Raises:
            IndexError: There are not that many.
            MotionFileError: The repaired motion cannot be read, or is of another clip.
        """
        if not 0 <= index < len(self):
            raise IndexError(index)
        number, repaired = self._numbers[index]
        clip = self._clips.clip(number)
        if not repaired:
            return clip
        path = self._curation.motion_file(number)
        motion = read_motion(path)
        a, b = (poses_of(person) for person in motion.people)
        same = motion.fps == clip.fps and motion.frames == clip.frames
        if not same or not all(map(_same_bones, (a, b), clip.poses)):
            raise MotionFileError(
                f"this is a repair of another motion than {clip.name} is now",
                where=str(path),
                hint="the choreographer has changed: curate again, into another folder",
            )
        return replace(clip, name=f"{clip.name}, repaired", poses=(a, b), licence=motion.licence)


def _kept(curation: Curation, clips: Choreographed, number: int) -> bool | None:
    """Return whether a clip was kept; ``None`` if it has not been judged."""
    verdict = curation.verdict(number)
    if verdict is None:
        return None
    if verdict.interaction != clips.interaction(number):
        raise MotionFileError(
            f"the verdict is on '{verdict.interaction}', the clip is '{clips.interaction(number)}'",
            where=str(curation.verdict_file(number)),
            hint="the repertoire has changed: curate again, into another folder",
        )
    return verdict.kept


def _same_bones(one: Poses, other: Poses) -> bool:
    """Return whether two people have bones of the same length, by their first frames."""
    return bool(np.abs(_bones(one) - _bones(other)).max() < SAME_BONES)


def _bones(poses: Poses) -> FloatArray:
    """Return the lengths ``[21]`` m of a person's bones."""
    points, parents = poses.positions[0], list(human_skeleton().parents)
    return np.linalg.norm(points[1:] - points[parents[1:]], axis=-1)
