"""Tracks many motions on all cores; each clip gets a folder, and what is done is not done again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from bridge import stages
from bridge.sources import FROM_FILE, MotionRequest, read
from generator.io.pairs import split_path, with_partner
from generator.io.reader import SUFFIXES
from robots.errors import DuetError, MotionFileError, SpecError
from robots.files import whole_file

if TYPE_CHECKING:
    from sim.track import TrackSettings

TABLE = "track.jsonl"
"""Name of the file with one line per clip."""


@dataclass(frozen=True, slots=True)
class Clip:
    """A motion to track."""

    motion: Path
    """Its file."""
    folder: Path
    """For what comes of it."""


@dataclass(frozen=True, slots=True)
class ClipResult:
    """What came of a clip."""

    clip: Clip
    """Which."""
    status: Literal["tracked", "kept", "failed"]
    """Whether it was tracked now, before, or not at all."""
    outcome: dict[str, Any] | None = None
    """What ``track.json`` holds."""
    error: str = ""
    """Why it was not tracked."""
    exit_code: int = 0
    """Exit status that the clip alone would have."""

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON."""
        return {
            "motion": str(self.clip.motion),
            "folder": str(self.clip.folder),
            "status": self.status,
            **({"error": self.error} if self.error else {}),
            **(self.outcome or {}),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSettings:
    """How to track every clip."""

    tracking: TrackSettings
    """How the people are simulated; on one thread, since all cores have a clip."""
    request: MotionRequest = FROM_FILE
    """What motion files leave unsaid."""
    least_assist: bool = False
    """Find the least help for each."""
    export: Path | None = None
    """Name, within a clip's folder, for the motion that was simulated."""


def clips_of(paths: Sequence[Path], out: Path) -> list[Clip]:
    """Return the clips that files and folders hold, each with a folder named after its file.

    Of two files with one person each, the first stands for both. A folder of two such files is one
    clip, as everywhere.

    Raises:
        MotionFileError: A folder holds no motion.
        SpecError: Two clips have the same name.
    """
    motions = [motion for path in paths for motion in _motions(path)]
    clips: dict[str, Clip] = {}
    for motion in motions:
        name = Path(str(motion).split(",")[0]).stem
        if name in clips:
            raise SpecError(
                f"two clips are called '{name}'",
                where=f"{clips[name].motion}, {motion}",
                hint="track them into different folders",
            )
        clips[name] = Clip(motion, out / name)
    return list(clips.values())


def is_single(paths: Sequence[Path]) -> bool:
    """Return whether paths name one motion, not many."""
    if len(paths) != 1:
        return False
    return not paths[0].is_dir() or _is_duet(paths[0])


def track_clips(
    clips: Sequence[Clip],
    out: Path,
    settings: BatchSettings,
    *,
    jobs: int | None = None,
    progress: stages.Progress = stages.no_progress,
) -> list[ClipResult]:
    """Track every clip and return what came of each, in the given order.

    Every clip's files are whole once they are there. A clip is kept as it is if its ``track.json``
    speaks of the same motion, settings and versions. One that fails stops no other.

    Args:
        clips: What to track.
        out: Folder for the table ``track.jsonl``.
        settings: How.
        jobs: Processes at once; one per core if not given.
        progress: Told the share of the clips that are done.
    """
    from sim.batch import Lost, cores, in_processes

    results: dict[Clip, ClipResult] = {}
    alone = replace(settings.tracking, ilqr=replace(settings.tracking.ilqr, threads=1))
    work = partial(track_clip, settings=replace(settings, tracking=alone))
    try:
        for clip, result in in_processes(work, clips, min(jobs or cores(), len(clips))):
            if isinstance(result, Lost):
                result = ClipResult(clip, "failed", error=result.why, exit_code=1)
            results[clip] = result
            progress(len(results) / len(clips))
    finally:
        done = [results[clip] for clip in clips if clip in results]
        with whole_file(out / TABLE) as file:
            file.writelines(f"{json.dumps(result.to_json())}\n".encode() for result in done)
    return done


def track_clip(clip: Clip, *, settings: BatchSettings) -> ClipResult:
    """Track one clip into its folder, unless that was done before."""
    from sim.rollout import Rollout

    rollout = clip.folder / stages.ROLLOUT
    export = None if settings.export is None else clip.folder / settings.export
    try:
        before = _before(clip, settings)
        if before is not None:
            if export is not None:
                stages.export_simulated(Rollout.load(rollout), export)
            return ClipResult(clip, "kept", before, exit_code=0 if before["success"] else 1)
        made = stages.track(
            clip.motion,
            rollout,
            request=settings.request,
            settings=settings.tracking,
            least_assist=settings.least_assist,
            export=export,
        )
    except DuetError as error:
        return ClipResult(clip, "failed", error=str(error), exit_code=error.exit_code)
    return ClipResult(clip, "tracked", made.to_json(), exit_code=0 if made.success else 1)


def _before(clip: Clip, settings: BatchSettings) -> dict[str, Any] | None:
    """Return what ``track.json`` holds if it is of the same work, else ``None``."""
    from sim.outcome import is_of, recorded

    record = recorded(clip.folder / stages.TRACKING)
    if record is None or not (clip.folder / stages.ROLLOUT).is_file():
        return None
    if settings.least_assist and record.get("least_assist") is None:
        return None
    same = is_of(record, read(clip.motion, settings.request), settings.tracking)
    return record if same else None


def _motions(path: Path) -> list[Path]:
    if not path.is_dir() or _is_duet(path):
        return [path]
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file())
    if not files:
        raise MotionFileError("the folder holds no motion", where=str(path))
    return [file for file in files if not _is_second(file)]


def _is_duet(folder: Path) -> bool:
    """Return whether a folder holds two files with one person each and nothing else."""
    try:
        return len(split_path(folder)) == 2
    except MotionFileError:
        return False


def _is_second(file: Path) -> bool:
    """Return whether a file holds person b of a pair in the same folder."""
    if file.suffix.lower() == ".npz":
        return False
    try:
        a, b = with_partner(file)
    except MotionFileError:
        return False
    return file == b and a.parent == b.parent
