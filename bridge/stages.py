"""The stages of the way from a sentence to two performing puppets: files in, files out.

``pasdedeux run`` and the single commands call the same functions on the same files, so a stage
alone gives what the whole run gives with the same seed.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.gate import RETARGETING, vouch
from bridge.generating import (
    FPS,
    Progress,
    clean,
    describe,
    make,
    make_group,
    no_progress,
)
from bridge.sources import (
    FROM_FILE,
    ROLLOUT_SCHEMA,
    MotionRequest,
    judged_hash,
    read,
    schema_of,
)
from robots.errors import SpecError
from robots.files import plain, write_json

if TYPE_CHECKING:  # physics, hardware and networks are loaded by the stages that need them
    from bridge.player.settings import PlayerSettings
    from bridge.player.telemetry import Performance
    from generator.finishing import Finishing
    from generator.intergen import IntergenRequest
    from generator.runtime.request import DiffusionRequest
    from robots.spec import RobotSpec
    from sim.outcome import TrackOutcome
    from sim.report import Report
    from sim.rollout import Rollout
    from sim.track import TrackSettings

CONTROLLERS = ("ilqr", "mppi", "assist")
SHOWN = ("plan", "servos")
"""What puppets in a film do: what the trajectories ask for, or what the servos did."""
PLANTS = ("servo", "mujoco", "instant")
"""What virtual servos move: as in :data:`bridge.virtual.plant.PLANTS`, the default first."""
TRANSPORTS = ("sdk", "rustypot")
"""Clients of the servo wire: as in :data:`bridge.ports.TRANSPORTS`, the default first."""
MOTION = "motion.npz"
ROLLOUT = "rollout.npz"
TRACKING = "track.json"
REPORT = "report.json"
TRAJECTORIES = ("trajectory-a.npz", "trajectory-b.npz")
TELEMETRY = "telemetry.jsonl"
VIDEO = "video.mp4"
PICTURE = "picture.png"
SUMMARY = "summary.json"
"""Names of the files that a run leaves in its folder."""


def generate(
    text: str,
    out: Path,
    *,
    seed: int = 0,
    nearest_known: bool = False,
    generator: str | None = None,
    intergen: IntergenRequest | None = None,
    diffusion: DiffusionRequest | None = None,
    style: Mapping[str, float] | None = None,
    raw: bool = False,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write ``motion.npz`` for a sentence; return what was understood.

    Writes to ``out``; the other arguments and the errors are those of
    :func:`bridge.generating.make`.
    """
    from generator.io import write_motion

    motion, facts = make(
        text,
        seed=seed,
        nearest_known=nearest_known,
        style=style,
        generator=generator,
        intergen=intergen,
        diffusion=diffusion,
        raw=raw,
        progress=progress,
    )
    write_motion(motion, out)
    return {"text": motion.text, **facts, **describe(motion)}


def generate_group(
    text: str,
    out: Path,
    request: DiffusionRequest,
    *,
    seed: int = 0,
    raw: bool = False,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write one motion file a pair, ``x-ab.npz``, ``x-bc.npz`` ... for ``x.npz``; return facts.

    Args:
        text: What each pair does.
        out: Name that theirs are made of.
        request: Which model, how many people, and how they are drawn.
        seed: Same seed, same machine: same motions.
        raw: Leave them as they were drawn.
        progress: Told the share done.
    """
    from generator.io import write_motion

    duets, facts = make_group(text, request, seed=seed, raw=raw, progress=progress)
    files = []
    for pair, motion in duets.items():
        path = out.with_name(f"{out.stem}-{pair}{out.suffix}")
        write_motion(motion, path)
        files.append(str(path))
    first = next(iter(duets.values()))
    return {"text": text, "generator": "diffusion", **facts, **describe(first), "files": files}


def finish(
    motion: Path,
    out: Path,
    *,
    fps: float = FPS,
    settings: Finishing | None = None,
    touches: Sequence[tuple[str, str]] = (),
    request: MotionRequest = FROM_FILE,
) -> dict[str, Any]:
    """Write a motion as two bodies could have moved it; return what it is and what was changed.

    Args:
        motion: Any motion file.
        out: File to write.
        fps: Frames per second of the result.
        settings: Bounds of finishing; the defaults if not given.
        touches: Points of a and b that are meant to touch somewhere.
        request: What the motion file leaves unsaid.
    """
    from generator.io import write_motion

    done, changes = clean(read(motion, request), fps=fps, settings=settings, touches=touches)
    write_motion(done, out)
    return {"text": done.text, **describe(done), "source": done.source, "finishing": changes}


def import_motion(path: Path, out: Path, request: MotionRequest) -> dict[str, Any]:
    """Read any motion file and write it as ``motion.npz``; return what it is."""
    from generator.io import write_motion

    motion = read(path, request)
    write_motion(motion, out)
    return {"text": motion.text, "generator": "file", **describe(motion)}


def track(
    motion: Path,
    out: Path,
    *,
    request: MotionRequest = FROM_FILE,
    settings: TrackSettings | None = None,
    least_assist: bool = False,
    export: Path | None = None,
    progress: Progress = no_progress,
) -> TrackOutcome:
    """Write ``rollout.npz`` for a motion file and ``track.json`` beside it; return the latter.

    Args:
        motion: Any motion file, or a rollout to track once more.
        out: Rollout file to write.
        request: What the motion file leaves unsaid.
        settings: How to track; the defaults if not given.
        least_assist: Find the least help with which the motion can be tracked, too.
        export: Motion file to write what was simulated to: ``.npz``, or ``.bvh`` for two files
            ``_a.bvh`` and ``_b.bvh``.
        progress: Told the share done.

    Raises:
        SpecError: The people are not of human size, or ``export`` is of no known format.
    """
    from sim.outcome import Cost, outcome
    from sim.track import TrackSettings
    from sim.track import track as simulate

    require_export(export)
    settings, given = settings or TrackSettings(), read(motion, request)
    start = Cost.now()
    rollout = simulate(given, settings=settings, progress=progress)
    cost, least = Cost.now().since(start), None
    if least_assist:
        from sim.least_assist import least_assist as search

        least = plain(search(given, settings))
    result = outcome(rollout, cost, least_assist=least)
    record = out.with_name(TRACKING)
    record.unlink(missing_ok=True)  # it is written last, so that it vouches for what lies beside it
    rollout.save(out)
    if export is not None:
        export_simulated(rollout, export)
    result.save(record)
    return result


def export_simulated(rollout: Rollout, path: Path) -> None:
    """Write what was simulated as a motion; see ``export`` of :func:`track`."""
    from generator.io import write_bvh, write_motion

    require_export(path)
    if path.suffix == ".bvh":
        write_bvh(rollout.as_motion(), path)
    else:
        write_motion(rollout.as_motion(), path)


def require_export(path: Path | None) -> None:
    """Check that a motion can be written to a file of that name.

    Raises:
        SpecError: It is of another format.
    """
    if path is not None and path.suffix not in (".npz", ".bvh"):
        raise SpecError(f"'{path.name}' is no name for a motion", allowed="*.npz, *.bvh")


def score(path: Path, out: Path, *, request: MotionRequest = FROM_FILE) -> Report:
    """Write ``report.json`` for a rollout, or for a motion without physics; return the report."""
    from sim.rollout import Rollout
    from sim.score import score as judge
    from sim.score import score_motion

    if schema_of(path) == ROLLOUT_SCHEMA:
        report = judge(Rollout.load(path))
    else:
        report = score_motion(read(path, request))
    report.save(out)
    return report


def retarget(
    motion: Path,
    robots: tuple[RobotSpec, RobotSpec],
    out: Path,
    *,
    request: MotionRequest = FROM_FILE,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Write both trajectories and ``retargeting.json`` into a folder; return the latter."""
    from bridge.retarget import retarget as onto_servos

    result = onto_servos(
        read(motion, request), robots, source_sha256=judged_hash(motion), progress=progress
    )
    for trajectory, name in zip(result.trajectories, TRAJECTORIES, strict=True):
        trajectory.save(out / name)
    facts = {
        "robots": [robot.name for robot in robots],
        **result.report.to_json(),
        **vouch(result.trajectories),
    }
    write_json(out / RETARGETING, facts)
    return facts


def play(
    trajectories: tuple[Path, Path],
    telemetry: Path,
    *,
    report: Path | None,
    robots: tuple[str | None, str | None] = (None, None),
    ports: tuple[str, str] = ("virtual", "virtual"),
    plant: str = PLANTS[0],
    transport: str = TRANSPORTS[0],
    settings: PlayerSettings | None = None,
    arm: bool = False,
    force: bool = False,
    only: Sequence[str] | None = None,
    without: Sequence[str] = (),
    write_eeprom: bool = False,
    calibrations: tuple[Path | None, Path | None] = (None, None),
    realtime: bool = False,
    stop: threading.Event | None = None,
    progress: Progress = no_progress,
) -> Performance:
    """Perform two trajectory files in a process of its own; return how it went.

    Args:
        trajectories: Of persons a and b.
        telemetry: File to write.
        report: The report on the same motion; without one only ``force`` lets it pass.
        robots: Folder or name per robot; ``None``: the built-in robot the trajectory names.
        ports: ``virtual``, or a serial port.
        plant: What moves behind virtual ports, one of :data:`PLANTS`.
        transport: Client that speaks to the servos, one of :data:`TRANSPORTS`.
        settings: How to play.
        arm: Real servos may move.
        force: Play what the report refuses, on virtual ports.
        only: Joints that play; all, if not given.
        without: Joints that do not.
        write_eeprom: Make real servos' EEPROM what the robot's file says, after a backup.
        calibrations: Files of the units that play; ``None``: built just as designed.
        realtime: Ask the system for real-time priority.
        stop: Ends the performance when set.
        progress: Told the share done.

    Raises:
        GateRefused: The report refuses it or speaks of another motion, or a trajectory was changed.
        LimitViolation: A trajectory leaves its robot's limits.
        SpecError: There is no such plant, or a port is not virtual and has none; the transport is
            unknown or not installed; a calibration is of another robot.
        BusError: A servo bus failed.
    """
    from bridge.player.process import conduct
    from bridge.player.request import PlayRequest
    from bridge.player.settings import PlayerSettings

    request = PlayRequest(
        trajectories=trajectories,
        telemetry=telemetry,
        report=report,
        robots=robots,
        ports=ports,
        plant=plant,
        transport=transport,
        settings=settings or PlayerSettings(),
        arm=arm,
        force=force,
        only=None if only is None else tuple(only),
        without=tuple(without),
        write_eeprom=write_eeprom,
        calibrations=calibrations,
        realtime=realtime,
    )
    return conduct(
        request,
        stop=stop,
        on_progress=lambda state, share: progress(share) if state == "PLAY" else None,
    )


def film(
    rollout: Path,
    trajectories: tuple[Path, Path],
    out: Path,
    *,
    moment: float,
    robots: tuple[str, str] | None = None,
    telemetry: Path | None = None,
) -> int:
    """Write ``video.mp4`` and ``picture.png`` into a folder; return the number of frames.

    Args:
        rollout: What the physics did: the left panel.
        trajectories: What the puppets do: the right panel, at the speed of the physics.
        out: Folder.
        moment: Time of the picture, s.
        robots: Names or folders of the robots, if they are not built in.
        telemetry: Show what its servos did instead of what the trajectories ask for, in the time
            that it took. The trajectories beside it say where the robots stand.

    Raises:
        RenderError: There is no OpenGL that draws offscreen.
    """
    from bridge.film import FPS, FrameKeeper
    from bridge.film import film as frames
    from bridge.show import clips_of
    from sim.video import write_picture, write_video

    puppets = trajectories if telemetry is None else (telemetry,)
    clips = clips_of((rollout, *puppets), FROM_FILE, robots)
    still = FrameKeeper(frames(clips), round(moment * FPS))
    count = write_video(out / VIDEO, still, FPS)
    write_picture(out / PICTURE, still.kept)
    return count


def default_folder(source: str) -> Path:
    """Return ``out/`` and a name made of the sentence or the file."""
    name = Path(source).stem if Path(source).exists() else source
    slug = "-".join(re.findall(r"[a-z0-9]+", name.lower()))[:60].strip("-")
    return Path("out") / (slug or "duet")
