"""What a run needs before its first step: clips, statistics, text encoder, model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from generator import checkpoint
from generator.applications import FREEZE
from generator.data import (
    BatchConfig,
    BatchStream,
    Choreographed,
    ClipCache,
    ClipSource,
    Curated,
    Curation,
    DuetFolder,
    Exchanged,
    FeatureStatistics,
    InterHuman,
    cached,
    measure,
)
from generator.data.choreographed import Split
from generator.model import InterGen
from generator.provenance import Provenance
from generator.text.encoder import SentenceEncoder, TokenEncoder
from generator.training.config import DataConfig, RunConfig, SourceConfig
from generator.training.draws import seed_weights
from generator.training.lessons import freeze_reading, teach
from generator.training.processes import Processes
from generator.training.texts import TextTable, make_encoder, text_width
from robots.errors import SpecError

STATISTICS, LESSONS = "statistics.json", "lessons"
EARLIER = "earlier_steps"
"""Fact of a model: steps of the runs that it started from."""

Announce = Callable[[str], None]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """Everything that a run learns from and with."""

    stream: BatchStream
    """Batches."""
    model: InterGen
    """The model at the start, on its device."""
    texts: TextTable
    """Condition vectors."""


def prepare(
    run: RunConfig,
    out: Path,
    processes: Processes,
    *,
    announce: Announce = lambda _: None,
    progress: Progress | None = None,
) -> Prepared:
    """Return what a run needs, made now unless it is on disk already.

    Args:
        run: Settings.
        out: Folder of the run.
        processes: The first one prepares what is shared on disk, the others wait for it.
        announce: Told what is being done.
        progress: Called with clips done and their total.

    Raises:
        DuetError: A clip, the initial model or the text encoder cannot be read, or they do not fit
            together.
    """
    initial = load_initial(run)
    encoder = make_encoder(run.text, initial)
    caches = shared_caches(run.data, processes, announce=announce, progress=progress)
    stream = make_stream(run, caches)
    mean_std = None
    if initial is not None and initial.has_statistics:
        mean_std = (initial.mean, initial.std)
    else:
        if processes.leads and not (out / STATISTICS).is_file():
            announce("measuring the features")
            _measured(run, [cache for cache, _ in caches], progress).save(out / STATISTICS)
        processes.wait()
        found = FeatureStatistics.load(out / STATISTICS)
        mean_std = (found.mean.copy(), found.std.copy())
    config = replace(run.model, **_reading(encoder))
    seed_weights(run.training.seed)
    model = InterGen(
        config,
        mean=mean_std[0],
        std=mean_std[1],
        text=encoder,
        provenance=_provenance(run, [cache for cache, _ in caches], initial),
    )
    if initial is not None:
        _require_same(initial, model)
        known = initial.denoiser.state_dict()
        model.denoiser.load_state_dict({**model.denoiser.state_dict(), **known})
    texts = TextTable(encoder, run.data.cache or None)
    if run.text.lessons and _count(initial, LESSONS) >= run.text.lessons:
        freeze_reading(model.denoiser)
    elif run.text.lessons:
        _teach(run, model, texts, out, processes, announce=announce, progress=progress)
    return Prepared(stream, model.to(processes.device), texts)


def make_source(config: SourceConfig) -> ClipSource:
    """Return a source of clips.

    Raises:
        MotionFileError: A folder does not hold what it should, or no clip was kept.
    """
    if config.kind == "interhuman":
        return InterHuman(config.root, config.split)
    if config.kind == "duets":
        return DuetFolder(config.root)
    split = cast(Split, config.split)
    if config.repaired:
        curation = Curation(Path(config.repaired), split, config.seed, config.count)
        return Curated(curation, poses=config.poses, unjudged=config.unjudged)
    invent = Exchanged if config.kind == "exchanged" else Choreographed
    return invent(config.count, seed=config.seed, split=split)


def shared_caches(
    data: DataConfig,
    processes: Processes,
    *,
    announce: Announce = lambda _: None,
    progress: Progress | None = None,
) -> list[tuple[ClipCache, float]]:
    """Return the cached sources with their weights; only the leading process makes caches."""
    if processes.leads:
        _caches(data, announce, progress)
    processes.wait()
    return _caches(data, lambda _: None, None)


def _caches(
    data: DataConfig, announce: Announce, progress: Progress | None
) -> list[tuple[ClipCache, float]]:
    caches = []
    for config in data.source:
        source = make_source(config)
        announce(f"preparing {source.name}")
        caches.append((cached(source, data.cache, fps=data.fps, progress=progress), config.weight))
    return caches


def make_stream(run: RunConfig, caches: list[tuple[ClipCache, float]]) -> BatchStream:
    """Return the batches of a run."""
    data = run.data
    config = BatchConfig(
        size=run.training.batch,
        frames=data.frames,
        shortest=data.shortest,
        mirror=data.mirror,
        swap=data.swap,
        frame=data.frame,
        pad=data.pad,
        bucket=data.bucket,
        representation=run.model.representation,
        release_compat=data.release_compat,
        seed=run.training.seed,
    )
    return BatchStream(caches, config)


def load_initial(run: RunConfig) -> InterGen | None:
    """Return the model that a run starts from, if it names one.

    Raises:
        CheckpointError: It cannot be read.
    """
    place = run.training.initial
    if not place:
        return None
    wants_text = run.text.encoder == "initial"
    if Path(place).suffix == ".ckpt":
        return checkpoint.load_release(place, text=wants_text, heads=run.model.heads)
    return checkpoint.load(place, text=wants_text)


def _reading(encoder: SentenceEncoder) -> dict[str, Any]:
    """Return what of an architecture follows from the text encoder."""
    width = text_width(encoder)
    if not isinstance(encoder, TokenEncoder):
        return {"text_width": width}
    return {"text_width": width, "text_tokens": encoder.tokens, "text_names": encoder.names}


def _count(initial: InterGen | None, fact: str) -> int:
    """Return how many steps of some kind a model has had."""
    steps = 0 if initial is None else initial.provenance.training.get(fact)
    return steps if isinstance(steps, int) else 0


def _teach(
    run: RunConfig,
    model: InterGen,
    texts: TextTable,
    out: Path,
    processes: Processes,
    *,
    announce: Announce,
    progress: Progress | None,
) -> None:
    """Teach the layers that read, once: who does not lead takes over what the leader has learnt."""
    steps = run.text.lessons

    def report(step: int, loss: float) -> None:
        if progress is not None:
            progress(step, steps)

    def lessons() -> None:
        teach(
            model.denoiser,
            texts,
            steps,
            exchanges=any(source.kind == "exchanged" for source in run.data.source),
            seed=run.training.seed,
            low_precision=run.training.precision == "bfloat16",
            state=out / LESSONS,
            report=report,
        )

    if processes.leads:
        announce("lessons in reading")
        lessons()
    processes.wait()
    if not processes.leads:
        lessons()


def _require_same(initial: InterGen, model: InterGen) -> None:
    apart = initial.config.told_apart or model.config.told_apart  # may be learnt from now on
    theirs = replace(initial.config, dropout=model.config.dropout, told_apart=apart)
    if theirs == model.config:
        return
    for name in model.config.__dataclass_fields__:
        ours, other = getattr(model.config, name), getattr(theirs, name)
        if ours != other:
            raise SpecError(
                f"the initial model has {name} {other}, the configuration {ours}",
                where="training.initial",
            )


def _measured(
    run: RunConfig, caches: list[ClipCache], progress: Progress | None
) -> FeatureStatistics:
    return measure(
        caches,
        frames=run.data.frames,
        representation=run.model.representation,
        release_compat=run.data.release_compat,
        progress=progress,
    )


def _provenance(run: RunConfig, caches: list[ClipCache], initial: InterGen | None) -> Provenance:
    licences = {} if initial is None or not initial.licence else {initial.licence: None}
    for cache in caches:
        licences |= {cache.clip(i).licence: None for i in range(len(cache))}
    facts = {
        "data": [cache.name for cache in caches],
        "text": run.text.encoder,
        "frames": run.data.frames,
        LESSONS: max(run.text.lessons, _count(initial, LESSONS)),
        EARLIER: _count(initial, EARLIER) + _count(initial, "steps"),
        FREEZE: run.training.freeze,
    }
    return Provenance(
        source=run.name,
        licence="; ".join(name for name in licences if name),
        fps=run.data.fps,
        training=facts,
    )
