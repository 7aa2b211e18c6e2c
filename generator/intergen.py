"""From a sentence, and what may be given with it, to a duet: InterGen behind one function.

Torch is imported when something is generated, not before: the command line reads requests with
:class:`IntergenRequest` alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from generator.canonical import from_canonical
from generator.features import POSITIONS, decode
from generator.given import Given, Person, given_ends, given_person, given_tracks
from generator.motion import DuetMotion
from generator.paths import read_part, read_track
from generator.smoothing import smooth
from robots.errors import CheckpointError, PromptError, SpecError

if TYPE_CHECKING:
    from generator.diffusion import SamplerConfig
    from generator.model import InterGen

SECONDS = 7.0
"""Length of a motion if nothing else decides it."""
FEW_STEPS = 25
"""Below so many steps, the second-order solver with trailing spacing is the default."""

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class IntergenRequest:
    """What to generate besides the sentence.

    Raises:
        SpecError: A number is out of range, or settings exclude each other.
    """

    weights: str = ""
    """Folder of a model, or a published ``.ckpt``."""
    frames: int | None = None
    """Length in frames."""
    seconds: float | None = None
    """Length in seconds, instead of ``frames``."""
    steps: int = 50
    """Sampling steps."""
    solver: Literal["auto", "ddim", "dpm2m"] = "auto"
    """``auto``: DDIM as in the paper, with few steps DPM-Solver++(2M)."""
    guidance: float = 3.5
    """Weight of the sentence."""
    precision: Literal["float32", "fast", "bfloat16"] = "fast"
    """Arithmetic of the network."""
    threads: int | None = None
    """Threads; all cores but one by default."""
    smoothing: float = 1.0
    """Deviation in frames of the Gaussian over generated keypoints."""
    given: str = ""
    """Motion file of which one person is kept."""
    given_person: Person = "a"
    """Which."""
    path_a: str = ""
    """CSV or motion file that says where person a goes."""
    path_b: str = ""
    """The same for person b."""
    start: str = ""
    """Motion file, or ``FILE@FROM:TO``, with which it begins."""
    end: str = ""
    """Motion file, or ``FILE@FROM:TO``, with which it ends."""
    rounds: tuple[str, ...] = ()
    """Sentences of further rounds between start and end."""
    strength: float = 0.7
    """How much a further round changes, 0 to 1."""

    def __post_init__(self) -> None:
        """Validate."""
        kinds = {
            "--given": self.given,
            "--path-a and --path-b": self.path_a or self.path_b,
            "--start and --end": self.start or self.end,
        }
        used = [name for name, value in kinds.items() if value]
        if len(used) > 1:
            raise SpecError(f"{' with '.join(used)}", allowed="one of them at a time")
        if self.rounds and not (self.start or self.end):
            raise SpecError("further rounds need a start or an end", where="--round")
        if self.threads is not None and self.threads < 1:
            raise SpecError(f"{self.threads}", where="--threads", allowed="1 or more")
        if self.frames is not None and self.seconds is not None:
            raise SpecError("frames and seconds", allowed="one of them")
        if self.frames is not None and not 2 <= self.frames <= 4000:
            raise SpecError(f"{self.frames}", where="--frames", allowed="2 to 4000")
        if self.seconds is not None and not 0.1 <= self.seconds <= 130:
            raise SpecError(f"{self.seconds}", where="--seconds", allowed="0.1 to 130")

    @property
    def wants_given(self) -> bool:
        """Whether something of the motion is given."""
        return bool(self.given or self.path_a or self.path_b or self.start or self.end)


def generate(
    text: str,
    request: IntergenRequest,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[DuetMotion, dict[str, Any]]:
    """Return a duet and the facts of how it was made.

    Args:
        text: The sentence; may be empty only where something is given.
        request: Everything else.
        seed: The same seed gives the same duet on the same machine.
        progress: Called with the share done, 0 to 1.

    Raises:
        PromptError: The sentence is empty.
        CheckpointError: The weights are missing or damaged, or do not fit what is asked.
        MotionFileError: Something given cannot be read.
        SpecError: A setting is out of range.
    """
    if not request.weights:
        raise SpecError(
            "InterGen needs a model",
            where="--weights",
            hint="train one (pasdedeux train configs/tiny.toml), or name a published .ckpt",
        )
    if not text.strip() and not request.wants_given:
        raise PromptError("the sentence is empty")
    model = load_model(request.weights)
    from generator.threads import thread_limit

    with thread_limit(request.threads):
        return _drawn(model, text, request, seed, progress)


def _drawn(
    model: InterGen, text: str, request: IntergenRequest, seed: int, progress: Progress | None
) -> tuple[DuetMotion, dict[str, Any]]:
    facts: dict[str, Any] = {
        "weights": request.weights,
        "model": model.provenance.source,
        "steps": request.steps,
        "guidance": request.guidance,
    }
    from generator.precision import prepared

    model = prepared(model, request.precision)
    if request.wants_given:
        from generator.applications import Draw, generate_around, kind_of

        given = given_of(request, model.provenance.fps)
        draw = Draw(
            sampler=sampler_of(request), smoothing=request.smoothing, strength=request.strength
        )
        texts = (text, *request.rounds)
        motion = generate_around(model, texts, given, seed=seed, draw=draw, progress=progress)
        facts |= {"application": kind_of(given), "rounds": len(texts)}
        return motion, facts
    return _plain(model, text, request, seed, progress), facts


def load_model(weights: str | Path) -> InterGen:
    """Return a model from a folder of this project, or from a published ``.ckpt``.

    Raises:
        CheckpointError: It is missing or damaged, or torch is not installed.
    """
    try:
        from generator import checkpoint
    except ImportError as error:
        raise CheckpointError(
            f"InterGen needs the package '{error.name}'", hint="pip install 'pasdedeux[train]'"
        ) from error
    if Path(weights).suffix == ".ckpt":
        return checkpoint.load_release(weights, text=True)
    return checkpoint.load(weights)


def sampler_of(request: IntergenRequest) -> SamplerConfig:
    """Return the sampler that a request asks for."""
    from generator.diffusion import SamplerConfig

    solver = request.solver
    if solver == "auto":
        solver = "dpm2m" if request.steps < FEW_STEPS else "ddim"
    spacing = "trailing" if solver == "dpm2m" else "leading"
    return SamplerConfig(solver, request.steps, spacing, guidance=request.guidance)


def frames_of(request: IntergenRequest, fps: float, seconds: float = SECONDS) -> int:
    """Return the length that a request asks for, else that of ``seconds``."""
    if request.frames is not None:
        return request.frames
    return max(2, round((request.seconds or seconds) * fps))


def given_of(request: IntergenRequest, fps: float) -> Given:
    """Return what a request gives, from its files.

    Raises:
        MotionFileError: A file cannot be read.
        MotionError: What is given does not fit into the length that is asked for.
    """
    asked = request.frames is not None or request.seconds is not None
    if request.given:
        given = given_person(read_part(request.given), request.given_person, fps)
        if not asked:
            return given
        frames = frames_of(request, fps)
        if frames > given.frames:
            raise SpecError(
                f"{frames} frames", where="--given", allowed=f"up to the {given.frames} given"
            )
        return replace(given, values=given.values[:frames], known=given.known[:frames])
    if request.path_a or request.path_b:
        tracks = (
            read_track(request.path_a, "a") if request.path_a else None,
            read_track(request.path_b, "b") if request.path_b else None,
        )
        longest = max(track.duration for track in tracks if track is not None)
        frames = frames_of(request, fps) if asked else round(longest * fps) + 1
        return given_tracks(tracks, frames, fps)
    start, end = (read_part(name) if name else None for name in (request.start, request.end))
    return given_ends(start, end, frames_of(request, fps), fps)


def _plain(
    model: InterGen, text: str, request: IntergenRequest, seed: int, progress: Progress | None
) -> DuetMotion:
    sampler, frames = sampler_of(request), frames_of(request, model.provenance.fps)
    settings: dict[str, Any] = {
        "steps": sampler.steps,
        "guidance": sampler.guidance,
        "solver": sampler.solver,
        "spacing": sampler.spacing,
        "progress": progress,
    }
    if model.config.representation == "non_canonical":
        return model.generate(text, frames, seed, smoothing=request.smoothing, **settings)
    if not model.has_statistics:
        raise CheckpointError("the model has no statistics", where=request.weights)
    drawn = model.sample(model.encode_text([text]), frames, seed=seed, **settings)
    raw = model.denormalise(drawn[0]).unflatten(-1, (2, -1)).cpu().numpy().astype(np.float64)
    features = from_canonical(raw)
    if request.smoothing:
        features[..., POSITIONS] = smooth(features[..., POSITIONS], request.smoothing)
    return decode(
        features,
        model.provenance.fps,
        text=text,
        seed=seed,
        source=model.provenance.source,
        licence=model.licence,
    )
