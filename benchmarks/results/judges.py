"""Who judges: the contrastive evaluator and the classifier, trained once on the train split."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.results.chunks import Features, key_of
from benchmarks.results.classifier import (
    Classifier,
    classified,
    load_classifier,
    save_classifier,
    train_classifier,
)
from benchmarks.results.clips import Asked
from benchmarks.results.rows import EvaluatorSettings
from generator.choreographer import repertoire
from generator.data import BatchConfig, BatchStream, FeatureStatistics, measure
from generator.drawing import embed
from generator.evaluator import EvaluatorConfig, InterClip, load_evaluator, save_evaluator
from generator.features import ROTATIONS
from generator.model_folder import HEADER, read_header
from generator.scores import Floats
from generator.text.encoder import TokenEncoder, default_encoder
from generator.training.config import DataConfig, load_config
from generator.training.contrastive import ContrastiveConfig, train_evaluator
from generator.training.fit import Fit
from generator.training.prepare import make_source, shared_caches
from generator.training.processes import Processes

SIZE = EvaluatorConfig(
    width=128, layers=3, heads=4, feedforward=256, embedding=128, dropout=0.1, text="states"
)
"""An evaluator that learns in minutes on one core."""
RATE = 1e-3
"""Highest learning rate of both."""
ENOUGH = 500
"""Clips that are measured to scale the features."""
LEAST, LEAST_TURN = 0.02, 0.15
"""Smallest deviation that features, and those of rotations, are scaled by. What hardly changes in
the data, such as the twist of a shin, would be blown up otherwise, and judges would mind two
degrees there more than an arm: with 0.02 for rotations too, the classifier was right about 82 % of
the motions of a network and about 66 % of the same motions with rigid bones, whose keypoints are
4 mm from the drawn ones."""
TOLD_APART = 0.9
"""Share of real performances from which on an interaction counts as having a leader."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class Judges:
    """Both judges. The first look at a sentence is remembered."""

    evaluator: InterClip
    """Embeds motions and sentences."""
    classifier: Classifier
    """Tells interactions and leaders."""
    hash: str
    """Which ones they are."""

    @cached_property
    def _known(self) -> dict[str, Floats]:
        return {}

    @torch.no_grad()
    def read(self, texts: Sequence[str]) -> Floats:
        """Return embeddings ``[N, E]`` of sentences."""
        for text in dict.fromkeys(texts):
            if text not in self._known:
                prepared = self.evaluator.prepare([text])
                self._known[text] = self.evaluator.embed_text(prepared)[0].numpy()
        return np.stack([self._known[text] for text in texts])

    def watch(self, features: Sequence[Features]) -> Floats:
        """Return embeddings ``[N, E]`` of motions."""
        return embed(self.evaluator, features, 50)

    def classify(self, features: Sequence[Features]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return what is done ``[N]``, as numbers in the repertoire, and whether b leads."""
        return classified(self.classifier, features)

    def led(self, asked: Sequence[Asked], features: Sequence[Features]) -> frozenset[str]:
        """Return the interactions whose leaders are told apart on these real performances."""
        _, second = self.classify(features)
        told = {name: [] for name in repertoire()}
        for one, said in zip(asked, second, strict=True):
            told[one.interaction].append(bool(said) == one.second_leads)
        return frozenset(n for n, hits in told.items() if hits and np.mean(hits) >= TOLD_APART)


def judges(
    root: Path,
    settings: EvaluatorSettings,
    say: Say,
    check: Callable[[], None],
    kept: Path | None = None,
) -> Judges:
    """Return the judges, trained now unless they are there; what was begun is gone on with.

    Args:
        root: Folder; each setting has one of its own in it.
        settings: How they are trained.
        say: Told how it goes.
        check: Called now and then; what it raises stops the training, which loses nothing.
        kept: Folder of judges that are taken instead, if those of these settings are in it.

    Raises:
        DuetError: Clips cannot be read, or a folder is damaged.
    """
    run = load_config(settings.config)
    data = replace(run.data, source=run.data.source[: settings.sources])
    plan = json.dumps(
        [asdict(settings), asdict(data), asdict(SIZE), RATE, LEAST, LEAST_TURN], sort_keys=True
    )
    name = key_of(plan, *_fingerprint(data))
    folder = kept / name if kept is not None and (kept / name).is_dir() else root / name
    school = _School(data, settings, folder, say, check)
    evaluator, classifier = folder / "evaluator", folder / "classifier"
    if not (evaluator / HEADER).is_file():
        save_evaluator(school.evaluator(), evaluator)
    if not (classifier / HEADER).is_file():
        save_classifier(school.classifier(), classifier)
    hashes = [read_header(f).get("weights", {}).get("sha256") for f in (evaluator, classifier)]
    return Judges(load_evaluator(evaluator), load_classifier(classifier), key_of(*hashes))


def _fingerprint(data: DataConfig) -> list[str]:
    return [make_source(source).fingerprint for source in data.source]


class _School:
    """What both learn from, read when it is needed."""

    def __init__(
        self,
        data: DataConfig,
        settings: EvaluatorSettings,
        folder: Path,
        say: Say,
        check: Callable[[], None],
    ) -> None:
        self._data, self._settings, self._folder = data, settings, folder
        self._say, self._check = say, check

    @cached_property
    def _stream(self) -> BatchStream:
        caches = shared_caches(self._data, Processes(), announce=self._say)
        config = BatchConfig(
            size=self._settings.batch, frames=self._data.frames, frame="first", pad="longest",
            bucket=self._data.bucket, seed=1,
        )  # fmt: skip
        return BatchStream(caches, config)

    @cached_property
    def _statistics(self) -> FeatureStatistics:
        path = self._folder / "statistics.json"
        if not path.is_file():
            first = replace(self._data, source=self._data.source[:1])
            ((clips, _),) = shared_caches(first, Processes())
            measure(clips, frames=self._data.frames).save(path)
        found = FeatureStatistics.load(path)
        least = np.full(len(found.std), LEAST)
        least[ROTATIONS] = LEAST_TURN
        return replace(found, std=np.maximum(found.std, least))

    def evaluator(self) -> InterClip:
        steps = self._settings.steps
        encoder = TokenEncoder(default_encoder())

        def report(step: int, loss: float, share: float) -> None:
            self._say(f"evaluator step {step}/{steps}  loss {loss:.3f}  nearest {share:.0%}")
            self._check()

        config = ContrastiveConfig(architecture=SIZE, steps=steps, learning_rate=RATE)
        state = self._folder / "evaluator-state"
        cache = self._data.cache or None
        return train_evaluator(
            self._stream, self._statistics, encoder, config, state=state, cache=cache, report=report
        )

    def classifier(self) -> Classifier:
        steps = self._settings.classifier_steps

        def report(step: int, loss: float) -> None:
            self._say(f"classifier step {step}/{steps}  loss {loss:.3f}")
            self._check()

        state = self._folder / "classifier-state"
        config = Fit(steps=steps, learning_rate=RATE)
        return train_classifier(self._stream, self._statistics, config, state=state, report=report)
