"""An evaluation from its names: which model, which clips, which evaluator, found or made.

What is not named follows from the ``config.toml`` that training left beside the model: the clips
are of the same sources, but held out (InterHuman's test split, other duets of the choreographer),
and an evaluator is trained on what the model was trained on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from generator.data import BatchConfig, BatchStream, Clip, ClipCache, ClipSet, cached, measure
from generator.evaluation import EvaluationConfig, Watch, evaluate
from generator.evaluator import InterClip, load_evaluator, save_evaluator
from generator.intergen import load_model
from generator.model_folder import HEADER, read_header
from generator.release_evaluator import load_release_evaluator
from generator.text.encoder import default_encoder
from generator.training.config import RunConfig, SourceConfig, load_config
from generator.training.contrastive import ContrastiveConfig, train_evaluator
from generator.training.prepare import make_source, make_stream, shared_caches
from generator.training.processes import Processes
from generator.training.train import CONFIG
from robots.errors import SpecError, nearest
from robots.files import sha256

EVALUATOR, FOLDER = "evaluator", "evaluation"
HELD_OUT = 300
"""Clips that the choreographer invents for an evaluation if it is not said how many."""
_HELD_OUT_SEED = 1_000_003
"""Added to the seed of training: other duets."""
_KINDS = ("interhuman", "duets", "choreographed")


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessment:
    """What to evaluate and with what."""

    model: Path
    """Folder of a model, or a published ``.ckpt``."""
    out: Path | None = None
    """Folder of the report; ``evaluation`` in the model's by default."""
    data: str = ""
    """``KIND:ROOT``; what fits the model's configuration by default."""
    evaluator: Path | None = None
    """Folder or published ``.ckpt``; ``evaluator`` in the model's folder by default."""
    evaluator_steps: int = 1000
    """Steps of training, if there is no evaluator yet."""
    clips: int | None = None
    """Most clips to take."""
    cache: Path | None = None
    """Folder of prepared clips; that of the model's configuration by default."""
    config: EvaluationConfig = field(default_factory=EvaluationConfig)
    """How much."""


class First:
    """The first clips of a set."""

    def __init__(self, clips: ClipSet, count: int) -> None:
        """Take ``count`` of them at most."""
        self._clips, self._count = clips, min(count, len(clips))

    def __len__(self) -> int:
        """Return the number of clips."""
        return self._count

    def clip(self, index: int) -> Clip:
        """Return a clip."""
        return self._clips.clip(index)


def assess(request: Assessment, *, watch: Watch | None = None) -> dict[str, Any]:
    """Evaluate, leave report and outputs in a folder, and return the report.

    Raises:
        SpecError: Something that is not named cannot be found out.
        CheckpointError: The model or the evaluator is missing or damaged.
        MotionFileError: Clips cannot be read.
    """
    watch = watch or Watch()
    home = request.model if request.model.is_dir() else request.model.parent
    run = load_config(home / CONFIG) if (home / CONFIG).is_file() else None
    model = load_model(request.model)
    cache = _cache_root(request, run)
    source = held_out(request.data, run)
    config = request.config
    if run is not None:
        compat, frames = run.data.release_compat, run.data.frames
        config = replace(config, frames=frames, release_compat=compat)
    clips = cached(make_source(source), cache, fps=model.provenance.fps)
    chosen = clips if request.clips is None else First(clips, request.clips)
    evaluator, folder = _evaluator(request, home, run, cache, watch.announce)
    identity = {
        "model": _identity(request.model),
        "evaluator": _identity(folder),
        "clips": clips.name,
        "clips_key": clips.folder.name,
        "count": len(chosen),
    }
    out = request.out or home / FOLDER
    return evaluate(model, evaluator, chosen, out, config, identity=identity, watch=watch)


def held_out(data: str, run: RunConfig | None) -> SourceConfig:
    """Return the source of clips that ``KIND:ROOT`` names, or that fits a training run.

    Raises:
        SpecError: There is no such kind, or nothing to derive it from.
    """
    if data:
        kind, _, root = data.partition(":")
        if kind not in _KINDS:
            raise SpecError(
                f"'{kind}'", where="--data", allowed=", ".join(_KINDS), hint=nearest(kind, _KINDS)
            )
        if kind == "choreographed":
            if root and not root.isdigit():
                raise SpecError(f"'{root}'", where="--data", allowed="choreographed:COUNT")
            count = int(root or HELD_OUT)
            return SourceConfig(kind="choreographed", count=count, seed=_HELD_OUT_SEED)
        if kind == "duets":
            return SourceConfig(kind="duets", root=root)
        return SourceConfig(kind="interhuman", root=root, split="test")
    if run is None:
        raise SpecError(
            f"there is no {CONFIG} beside the model that would say which clips fit",
            hint="name them with --data",
        )
    first = run.data.source[0]
    if first.kind == "duets":
        raise SpecError(
            "the model was trained on all of a folder, so nothing of it is held out",
            hint="name other motions with --data duets:FOLDER",
        )
    if first.kind == "interhuman":
        return replace(first, split="test")
    plain = {"repaired": "", "poses": "repaired", "unjudged": "drop"}  # nobody judged these clips
    return replace(first, count=HELD_OUT, seed=first.seed + _HELD_OUT_SEED, **plain)


def _cache_root(request: Assessment, run: RunConfig | None) -> Path:
    if request.cache is not None:
        return request.cache
    return Path(run.data.cache if run is not None else "runs/cache")


def _evaluator(
    request: Assessment,
    home: Path,
    run: RunConfig | None,
    cache: Path,
    announce: Callable[[str], None],
) -> tuple[InterClip, Path]:
    folder = request.evaluator or home / EVALUATOR
    if folder.suffix == ".ckpt":
        return load_release_evaluator(folder), folder
    if not (folder / HEADER).is_file():
        if request.evaluator is not None or run is None:
            load_evaluator(folder)  # says what is missing
            raise SpecError("there is no evaluator", where=str(folder))
        save_evaluator(_trained(run, cache, request.evaluator_steps, announce), folder)
    return load_evaluator(folder), folder


def _trained(run: RunConfig, cache: Path, steps: int, announce: Callable[[str], None]) -> InterClip:
    """Return an evaluator that was trained on the clips of a run."""
    announce(f"training an evaluator on the model's training clips, {steps} steps")
    data = replace(run.data, cache=str(cache))
    caches = shared_caches(data, Processes(), announce=announce)
    plain = replace(run, model=replace(run.model, representation="non_canonical"), data=data)
    stream = make_stream(plain, caches)
    statistics = measure(
        [First(clips, _ENOUGH) for clips, _ in caches],
        frames=data.frames,
        release_compat=data.release_compat,
    )

    def report(step: int, loss: float, share: float) -> None:
        announce(f"evaluator step {step}/{steps}  loss {loss:.3f}  nearest {share:.0%}")

    config = ContrastiveConfig(steps=steps, seed=run.training.seed)
    return train_evaluator(
        _larger(stream, caches), statistics, default_encoder(), config, report=report
    )


_ENOUGH = 500
"""Clips that are measured to scale the evaluator's input."""
_PAIRS = 64
"""Smallest batch of an evaluator: among so many sentences it learns to find the right one."""


def _larger(stream: BatchStream, caches: list[tuple[ClipCache, float]]) -> BatchStream:
    config: BatchConfig = replace(stream.config, size=max(_PAIRS, stream.config.size))
    return BatchStream(caches, config)


def _identity(path: Path) -> dict[str, Any]:
    """Return name and hash of a model or an evaluator."""
    if path.is_dir():
        return {"name": str(path), "sha256": read_header(path).get("weights", {}).get("sha256")}
    return {"name": str(path), "sha256": sha256(path)}
