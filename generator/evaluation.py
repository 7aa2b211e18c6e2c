"""The evaluation protocol (Sec. 5): embeddings of real and generated motions, and figures of them.

Real motions are scored first, as if they had been generated: only against that row do a model's
figures mean anything, and an evaluator that cannot tell real motions apart shows there.

A repetition draws sentence, crop and order of the two people of every clip anew, generates a
motion for each sentence at the clip's length, and measures. Its outputs are kept in one archive
(``repetition-00.npz``: names, sentences, seeds, embeddings, keypoints), from which any figure can
be recomputed, and from which an evaluation that was stopped goes on. Figures are given twice: on
the paper's scale and on that of the public release, which differ in the pool of R-precision and in
factors (:data:`generator.metrics.PAPER`, :data:`generator.metrics.RELEASE`).
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.data import BatchConfig, BatchStream, ClipSet
from generator.diffusion import SamplerConfig
from generator.drawing import Drawn, draw_real, embed, generate, keypoints
from generator.evaluator import InterClip
from generator.metrics import PAPER, RELEASE
from generator.model import InterGen
from generator.scores import SCALES, Floats, figures, spread_figures, summarise
from robots.errors import CheckpointError, MotionFileError, SpecError
from robots.files import read_archive, write_archive, write_json

log = logging.getLogger(__name__)

SCHEMA = "pasdedeux.evaluation/1"
REAL, MODEL = "ground truth", "model"
REPORT = "evaluation.json"


@dataclass(frozen=True, slots=True)
class EvaluationConfig:
    """How much is generated and how.

    Raises:
        SpecError: A number is out of range.
    """

    repetitions: int = PAPER.repetitions
    """Runs that mean and interval are taken over."""
    multimodality_repetitions: int = 5
    """Runs of MModality among them; it costs most."""
    multimodality_texts: int = 100
    """Sentences of MModality."""
    multimodality_motions: int = RELEASE.motions_per_text
    """Motions per sentence of MModality."""
    frames: int = 300
    """Longest clip, in feature frames."""
    length_step: int = 1
    """Lengths to generate are rounded to multiples of this, so that more fit into one batch."""
    batch: int = 16
    """Motions generated, or embedded, at a time."""
    seed: int = 0
    """Decides everything that is drawn."""
    release_compat: bool = False
    """Prepare clips as the public release does."""
    sampler: SamplerConfig = field(default_factory=SamplerConfig)
    """How motions are drawn."""

    def __post_init__(self) -> None:
        """Validate."""
        for name, low in (
            ("repetitions", 1),
            ("multimodality_repetitions", 0),
            ("multimodality_texts", 0),
            ("multimodality_motions", 2),
            ("frames", 2),
            ("length_step", 1),
            ("batch", 1),
            ("seed", 0),
        ):
            if getattr(self, name) < low:
                raise SpecError(f"{getattr(self, name)}", where=name, allowed=f"{low} or more")


@dataclass(frozen=True, slots=True, eq=False)
class Generated:
    """What a model made of the sentences of a repetition."""

    motion: Floats
    """``[N, E]`` embeddings."""
    lengths: NDArray[np.int64]
    """``[N]`` frames of each."""
    keypoints: Floats
    """``[sum of lengths, 2, 22, 3]`` m, y-up, in the pair's canonical frame."""


@dataclass(frozen=True, slots=True)
class Watch:
    """Who looks on."""

    announce: Callable[[str], None] = lambda _: None
    """Told what is being done."""
    progress: Callable[[float], None] = lambda _: None
    """Told the share done, 0 to 1."""


def evaluate(
    model: InterGen,
    evaluator: InterClip,
    clips: ClipSet,
    out: str | Path,
    config: EvaluationConfig | None = None,
    *,
    identity: dict[str, Any] | None = None,
    watch: Watch | None = None,
) -> dict[str, Any]:
    """Measure a model, leave ``evaluation.json`` and the archives in a folder, return the report.

    Args:
        model: With statistics and a text encoder.
        evaluator: Contrastive evaluator of non-canonical features.
        clips: Real motions that the model was not trained on.
        out: Folder.
        config: How much.
        identity: What model, evaluator and clips are (names, hashes); kept in the report. Archives
            of another identity or configuration are made again.
        watch: Who looks on.

    Raises:
        CheckpointError: The model has no statistics or text encoder.
        SpecError: There are too few clips for any figure.
    """
    config, watch, out = config or EvaluationConfig(), watch or Watch(), Path(out)
    if not model.has_statistics:
        raise CheckpointError("the model has no statistics", where=model.provenance.source)
    stream = _stream(clips, config)
    if stream.epoch < 2:
        raise SpecError(f"{stream.epoch} clips", where="clips", allowed="2 or more")
    watch.announce(f"embedding {stream.epoch} real motions, {config.repetitions + 1} draws")
    reference, *draws = (draw_real(evaluator, stream, r) for r in range(config.repetitions + 1))
    real = [
        figures(drawn.text, drawn.motion, reference.motion, [config.seed, r])
        for r, drawn in enumerate(draws)
    ]
    rows = {REAL: summarise(real)}
    _say(watch, rows[REAL])
    key = _key(config, identity or {})
    measured = []
    for r, drawn in enumerate(draws):
        made, spread = _repetition(model, evaluator, drawn, config, r, out, key, watch)
        seed = [config.seed, r]
        found = figures(drawn.text, made.motion, reference.motion, seed)
        measured.append({s: {**found[s], **spread_figures(spread, s, seed)} for s in found})
        watch.announce(f"repetition {r + 1} of {config.repetitions} done")
    rows[MODEL] = summarise(measured)
    report = {
        "schema": SCHEMA,
        "clips": stream.epoch,
        "rows": rows,
        "scales": {name: asdict(scale) for name, scale in SCALES.items()},
        "settings": asdict(config),
        "identity": identity or {},
    }
    write_json(out / REPORT, report)
    return report


def _stream(clips: ClipSet, config: EvaluationConfig) -> BatchStream:
    batches = BatchConfig(
        size=config.batch,
        frames=config.frames,
        mirror=False,
        pad="longest",
        release_compat=config.release_compat,
        seed=config.seed,
    )
    return BatchStream(clips, batches)


def _repetition(
    model: InterGen,
    evaluator: InterClip,
    drawn: Drawn,
    config: EvaluationConfig,
    repetition: int,
    out: Path,
    key: str,
    watch: Watch,
) -> tuple[Generated, Floats | None]:
    """Return what a repetition generated, from its archive if that is there."""
    path = out / f"repetition-{repetition:02d}.npz"
    header = {"schema": SCHEMA, "key": key, "names": drawn.names, "texts": drawn.texts}
    if path.is_file():
        kept = _kept(path, key)
        if kept is not None:
            return kept
    lengths = _rounded(drawn.lengths, config)
    seeds = [[config.seed, repetition, i] for i in range(len(lengths))]
    features = generate(
        model,
        drawn.texts,
        lengths,
        seeds,
        config.sampler,
        batch=config.batch,
        progress=watch.progress,
    )
    points = np.concatenate([keypoints(x) for x in features]).astype(np.float32)
    made = Generated(embed(evaluator, features, config.batch), lengths, points)
    spread = None
    if repetition < config.multimodality_repetitions and config.multimodality_texts:
        spread = _spread(model, evaluator, drawn, lengths, config, repetition, watch)
    arrays: dict[str, NDArray[Any]] = {
        "generated": made.motion,
        "lengths": made.lengths,
        "keypoints": made.keypoints,
        "text": drawn.text,
        "real": drawn.motion,
        "seeds": np.array(seeds),
    }
    if spread is not None:
        arrays["spread"] = spread
    write_archive(path, header, arrays)
    return made, spread


def _kept(path: Path, key: str) -> tuple[Generated, Floats | None] | None:
    try:
        header, arrays = read_archive(path)
        if header is None or header.get("key") != key:
            return None
        made = Generated(arrays["generated"], arrays["lengths"], arrays["keypoints"])
        return made, arrays.get("spread")
    except (MotionFileError, KeyError) as error:
        log.warning("%s is made again: %s", path, error)
        return None


def _rounded(lengths: NDArray[np.int64], config: EvaluationConfig) -> NDArray[np.int64]:
    step = config.length_step
    return np.maximum(np.rint(lengths / step).astype(np.int64), 1) * step


def _spread(
    model: InterGen,
    evaluator: InterClip,
    drawn: Drawn,
    lengths: NDArray[np.int64],
    config: EvaluationConfig,
    repetition: int,
    watch: Watch,
) -> Floats:
    """Return embeddings ``[texts, motions, E]`` of many motions for some of the sentences."""
    rng = np.random.default_rng([config.seed, 11, repetition])
    count = min(config.multimodality_texts, len(drawn.texts))
    chosen = np.sort(rng.choice(len(drawn.texts), count, replace=False))
    many = np.repeat(chosen, config.multimodality_motions)
    seeds = [[config.seed, repetition, 1, i] for i in range(len(many))]
    features = generate(
        model,
        [drawn.texts[i] for i in many],
        lengths[many],
        seeds,
        config.sampler,
        batch=config.batch,
        progress=watch.progress,
    )
    embedded = embed(evaluator, features, config.batch)
    return embedded.reshape(count, config.multimodality_motions, -1)


def _say(watch: Watch, scales: dict[str, dict[str, Any]]) -> None:
    found = scales["paper"]["r_precision_top1"]
    if found is None:
        return
    watch.announce(f"{REAL}: R-precision top 1 is {found['mean']:.3f} in pools of {PAPER.pool}")
    if found["mean"] < 2 / PAPER.pool:
        watch.announce(
            "the evaluator hardly tells real motions apart: figures made with it mean little"
        )


def _key(config: EvaluationConfig, identity: dict[str, Any]) -> str:
    settings = asdict(config)
    del settings["repetitions"]  # more of them later go on from those that are there
    text = json.dumps([settings, identity], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:20]
