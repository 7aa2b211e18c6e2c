"""Files for other programs: BVH, CSV, NPZ, MP4, PNG, HTML.

Heavy imports happen inside the writers, so that the list of formats costs nothing.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from bridge.sources import MotionRequest, read, schema_of
from bridge.trajectory import SCHEMA as TRAJECTORY_SCHEMA
from bridge.trajectory import JointTrajectory
from generator.motion import DuetMotion
from robots.errors import SpecError, nearest
from robots.files import whole_file

FORMATS = {
    "bvh": "two skeletons for animation programs",
    "csv": "keypoints or joint angles as a table",
    "npz": "this project's own motion file",
    "mp4": "video",
    "png": "picture of the middle",
    "html": "page that plays in any browser, one file",
}


def export(
    paths: Sequence[Path], formats: Sequence[str], out: Path, request: MotionRequest
) -> list[Path]:
    """Write files in each format into the folder ``out`` and return their paths.

    Raises:
        SpecError: A format is unknown, or a file cannot be told in it.
        MotionFileError: A file cannot be read or written.
    """
    for name in formats:
        if name not in FORMATS:
            raise SpecError(
                f"no format '{name}'", allowed=", ".join(FORMATS), hint=nearest(name, FORMATS)
            )
    written: list[Path] = []
    stem = paths[0].stem if len(paths) == 1 else paths[0].parent.name or "duet"
    for name in formats:
        if name in ("mp4", "png", "html"):
            written.append(_picture(paths, name, out / f"{stem}.{name}", request))
        else:
            for path in paths:
                written.extend(_table(path, name, out, request))
    return written


def _picture(paths: Sequence[Path], name: str, out: Path, request: MotionRequest) -> Path:
    from bridge.film import FPS, film, frame_count
    from bridge.show import clips_of
    from sim.video import write_picture, write_video

    clips = clips_of(paths, request)
    if name == "html":
        from sim.viewer import html

        if len(clips) != 1:
            raise SpecError(f"{len(clips)} things on one page", allowed="one")
        with whole_file(out) as file:
            file.write(html(clips[0].at_rate(FPS)).encode())
    elif name == "mp4":
        write_video(out, film(clips), FPS)
    else:
        middle = frame_count(clips) // 2
        write_picture(out, next(f for i, f in enumerate(film(clips)) if i == middle))
    return out


def _table(path: Path, name: str, out: Path, request: MotionRequest) -> list[Path]:
    if schema_of(path) == TRAJECTORY_SCHEMA:
        if name != "csv":
            raise SpecError(f"a trajectory has no {name} form", where=str(path), allowed="csv")
        target = out / f"{path.stem}.csv"
        _trajectory_csv(JointTrajectory.load(path), target)
        return [target]
    motion = read(path, request)
    if name == "csv":
        target = out / f"{path.stem}.csv"
        _motion_csv(motion, target)
        return [target]
    from generator.io import write_bvh, write_motion

    if name == "npz":
        target = out / f"{path.stem}.motion.npz"
        write_motion(motion, target)
        return [target]
    return list(write_bvh(motion, out / path.stem))


def _trajectory_csv(trajectory: JointTrajectory, path: Path) -> None:
    """One row per moment: time in s, then joint angles in rad."""
    rows = [["time_s", *(f"{name}_rad" for name in trajectory.joint_names)]]
    for time, position in zip(trajectory.times, trajectory.position, strict=True):
        rows.append([f"{time:.6f}", *(f"{value:.6f}" for value in position)])
    _write_csv(path, rows)


def _motion_csv(motion: DuetMotion, path: Path) -> None:
    """One row per frame: time in s, then x, y, z in m of every keypoint of a and of b; z is up."""
    names = [
        f"{who}_{point}_{axis}_m"
        for who, person in zip("ab", motion.people, strict=True)
        for point in person.skeleton.names
        for axis in "xyz"
    ]
    rows = [["time_s", *names]]
    for time, points in zip(motion.a.times, motion.keypoints, strict=True):
        rows.append([f"{time:.6f}", *(f"{value:.6f}" for value in points.reshape(-1))])
    _write_csv(path, rows)


def _write_csv(path: Path, rows: list[list[str]]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    with whole_file(path) as file:
        file.write(text.getvalue().encode())
