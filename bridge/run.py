"""The whole way: a sentence or a motion file in, a folder with everything about one duet out."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge import stages
from bridge.generating import default_generator
from bridge.sources import FROM_FILE, MotionRequest, load_robots
from bridge.stages import Progress
from bridge.stop import stop_on_signals
from robots.errors import RenderError
from robots.files import plain, write_json

if TYPE_CHECKING:
    from bridge.player.telemetry import Performance
    from generator.intergen import IntergenRequest
    from generator.runtime.request import DiffusionRequest
    from sim.outcome import TrackOutcome
    from sim.report import Report
    from sim.track import TrackSettings

Stage = Callable[[str], AbstractContextManager[Progress]]
"""Shows the progress of a named stage while its block runs."""

MOTION_SUFFIXES = (".npz", ".npy", ".bvh", ".amc", ".pkl")
"""A source that ends so is a file, even if it is not there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """What to run and how; kept in ``summary.json``."""

    source: str
    """A sentence, or the path of a motion file."""
    out: Path
    """Folder for everything."""
    seed: int = 0
    """Of the generator."""
    generator: str = field(default_factory=default_generator)
    """Who turns sentences into motion."""
    intergen: IntergenRequest | None = None
    """Which model, and what is given, if that is InterGen."""
    diffusion: DiffusionRequest | None = None
    """Which model, if that is one without torch."""
    nearest: bool = False
    """Take the nearest interaction of the repertoire for a sentence outside."""
    style: Mapping[str, float] = field(default_factory=dict)
    """Numbers of the style that the choreographer takes instead of the sentence's."""
    raw: bool = False
    """Leave what a network drew as it is."""
    tracking: TrackSettings | None = None
    """How the motion is tracked; the defaults if not given."""
    robots: tuple[str, str] = ("op3", "op3")
    """Who plays a and b."""
    speed: float = 1.0
    """Of the performance."""
    plant: str = "servo"
    """What moves behind the virtual ports."""
    force: bool = False
    """Perform what the report refuses (virtual servos only)."""
    video: bool = True
    """Draw the video and the picture."""
    shown: str = stages.SHOWN[0]
    """What the puppets do in them, one of :data:`~bridge.stages.SHOWN`."""
    request: MotionRequest = field(default_factory=lambda: FROM_FILE)
    """What a motion file leaves unsaid."""

    @property
    def from_file(self) -> bool:
        """Whether the source is a motion file."""
        names = self.source.split(",")
        return Path(self.source).exists() or all(
            name.lower().endswith(MOTION_SUFFIXES) for name in names
        )


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended."""

    summary: dict[str, Any]
    """What ``summary.json`` holds."""
    exit_code: int
    """0 all done, 1 the gate refused, 130 stopped."""


def run(settings: RunSettings, *, stage: Stage, say: Callable[[str], None]) -> RunResult:
    """Run every stage and leave its files in the folder.

    Args:
        settings: What to run.
        stage: Shows progress.
        say: Tells people a line.

    Raises:
        DuetError: A stage failed; files of the stages before it are there.
    """
    from bridge.player.settings import PlayerSettings

    out = settings.out
    robots = load_robots(*settings.robots)
    playing = PlayerSettings(speed=settings.speed)
    seconds: dict[str, float] = {}

    @contextmanager
    def timed(name: str) -> Iterator[Progress]:
        started = time.perf_counter()
        with stage(name) as progress:
            yield progress
        seconds[name] = round(time.perf_counter() - started, 3)

    with timed("generate") as progress:
        motion = _motion(settings, progress)
    with timed("track") as progress:
        tracked = stages.track(
            out / stages.MOTION, out / stages.ROLLOUT, settings=settings.tracking, progress=progress
        )
    with timed("score"):
        report = stages.score(out / stages.ROLLOUT, out / stages.REPORT)
    with timed("retarget") as progress:
        retargeting = stages.retarget(out / stages.MOTION, robots, out, progress=progress)
    performance = None
    if report.passed or settings.force:
        with stop_on_signals() as stop, timed("play") as progress:
            performance = stages.play(
                (out / stages.TRAJECTORIES[0], out / stages.TRAJECTORIES[1]),
                out / stages.TELEMETRY,
                report=out / stages.REPORT,
                robots=settings.robots,
                plant=settings.plant,
                settings=playing,
                force=settings.force,
                stop=stop,
                progress=progress,
            )
    else:
        say("the report refuses this motion, so it is not performed; --force does it all the same")
    pictures = "left out"
    if settings.video:
        try:
            with timed("film"):
                count = _film(settings, _highlight(motion), retargeting, performance)
            pictures = f"{count} frames"
        except RenderError as error:
            pictures = f"none: {error}"
            say(f"no video: {error}")
    summary = {
        "settings": plain(settings),
        "motion": motion,
        "tracking": tracking_facts(report, tracked),
        "report": {"score": report.score, "passed": report.passed, "failures": report.failures},
        "retargeting": retargeting,
        "performance": performance_facts(performance),
        "pictures": pictures,
        "stage_seconds": seconds,
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in ("pasdedeux", "mujoco", "numpy", "dynamixel-sdk")},
        },
    }
    write_json(out / stages.SUMMARY, summary)
    code = 1 if not report.passed else 0
    if performance is not None and not performance.completed:
        code = 130
    return RunResult(summary, code)


def _film(
    settings: RunSettings,
    moment: float,
    retargeting: dict[str, Any],
    performance: Performance | None,
) -> int:
    out, deeds = settings.out, settings.shown == "servos" and performance is not None
    return stages.film(
        out / stages.ROLLOUT,
        (out / stages.TRAJECTORIES[0], out / stages.TRAJECTORIES[1]),
        out,
        moment=moment * retargeting["slowed_by"] / settings.speed if deeds else moment,
        robots=settings.robots,
        telemetry=out / stages.TELEMETRY if deeds else None,
    )


def _motion(settings: RunSettings, progress: Progress) -> dict[str, Any]:
    target = settings.out / stages.MOTION
    if settings.from_file:
        return stages.import_motion(Path(settings.source), target, settings.request)
    return stages.generate(
        settings.source,
        target,
        seed=settings.seed,
        nearest_known=settings.nearest,
        generator=settings.generator,
        intergen=settings.intergen,
        style=settings.style,
        raw=settings.raw,
        diffusion=settings.diffusion,
        progress=progress,
    )


def _highlight(motion: dict[str, Any]) -> float:
    """Return the moment that tells most, s: the middle of the longest touch, else of the clip."""
    touches = motion["contacts"]
    if not touches:
        return motion["seconds"] / 2
    longest = max(touches, key=lambda touch: touch["end"] - touch["start"])
    return (longest["start"] + longest["end"]) / 2


def tracking_facts(report: Report, tracked: TrackOutcome) -> dict[str, Any]:
    """Return the figures of a summary that say how well the motion was tracked."""
    names = (
        *("success", "fell", "fall_time_s", "finished", "ended_because", "recoveries"),
        *("mpjpe_global_mm", "mpjpe_root_mm", "contact_recall", "penetration_max_mm"),
        *("controller", "cpu_seconds_per_second"),
    )
    figures = tracked.to_json()
    return {
        **{name: figures[name] for name in names},
        "assist_mean_percent": report.get("assist_mean"),
    }


def performance_facts(performance: Performance | None) -> dict[str, Any] | None:
    """Return the figures of a summary that say how the servos followed."""
    if performance is None:
        return None
    tracks = performance.tracking
    return {
        **performance.to_json(),
        "rms_deg": {person: track.rms_deg for person, track in tracks.items()},
        "lag_ms": {person: track.lag_ms for person, track in tracks.items()},
    }
