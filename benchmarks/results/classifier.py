"""Reads from a motion alone what is done and who leads; it never sees a sentence.

The evaluator's figures depend on how well it reads sentences. This does not: a small transformer
learns the interactions of the repertoire, and which of the two has the leading role, from the
motions of the train split. Where both do the same there is no leader to tell, so only interactions
count whose leaders it tells apart on real motions (:mod:`benchmarks.results.judges`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from generator.choreographer import repertoire
from generator.data import Batch, BatchStream, FeatureStatistics
from generator.evaluator import EvaluatorConfig, MotionEncoder
from generator.model_folder import from_json, require_format
from generator.text.manner import second_leads
from generator.training.draws import seed_weights
from generator.training.fit import Fit, fit
from generator.weights import adopt, load_weights, save_weights
from robots.errors import CheckpointError

FORMAT, VERSION = "pasdedeux-classifier", 1
ROLES = 2
"""Whether a or b leads."""
SIZE = EvaluatorConfig(width=128, layers=3, heads=4, feedforward=256, embedding=128, dropout=0.1)


class Classifier(nn.Module):
    """Logits of interactions and of leaders."""

    mean: Tensor
    std: Tensor

    def __init__(self, config: EvaluatorConfig, classes: int) -> None:
        """Make an untrained classifier."""
        super().__init__()
        self.config, self.classes = config, classes
        self.motion = MotionEncoder(config)
        self.out = nn.Linear(config.embedding, classes + ROLES)
        self.register_buffer("mean", torch.zeros(config.features))
        self.register_buffer("std", torch.ones(config.features))

    def forward(self, motion: Tensor, lengths: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits ``[B, classes]`` and ``[B, 2]`` for raw features ``[B, T, 2F]``."""
        people = motion.unflatten(-1, (2, -1))
        states = self.motion(((people - self.mean) / self.std).flatten(-2), lengths)
        logits = self.out(functional.gelu(states))
        return logits[:, :-ROLES], logits[:, -ROLES:]


def interaction_of(clip: str) -> int:
    """Return the number in the repertoire of what a choreographed clip of this name shows."""
    return int(clip.rpartition("/")[2]) % len(repertoire())


def train_classifier(
    stream: BatchStream,
    statistics: FeatureStatistics,
    config: Fit,
    *,
    size: EvaluatorConfig | None = None,
    state: Path | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Classifier:
    """Return a classifier that was trained on choreographed clips.

    Args:
        stream: Batches of clips of :class:`~generator.data.Choreographed`, whose names and
            sentences say what is done and who leads.
        statistics: Of their features.
        config: How.
        size: Of the network; :data:`SIZE` by default.
        state: Folder of what to go on from.
        report: Told step and loss.
    """
    seed_weights(config.seed)
    size = size or SIZE
    model = Classifier(size, len(repertoire()))
    for buffer, values in ((model.mean, statistics.mean), (model.std, statistics.std)):
        buffer.copy_(torch.tensor(values, dtype=torch.float32))

    def loss(step: int) -> Tensor:
        batch = stream.batch(step)
        done, leads = _labels(batch)
        what, who = model(torch.from_numpy(batch.x_raw), torch.from_numpy(batch.lengths))
        return functional.cross_entropy(what, done) + functional.cross_entropy(who, leads)

    identity = f"classifier {config} {size} {stream.config} {stream.epoch}"
    fit(model, loss, config, state=state, identity=identity, report=report)
    return model.eval()


def _labels(batch: Batch) -> tuple[Tensor, Tensor]:
    done = torch.tensor([interaction_of(name) for name in batch.names])
    return done, torch.tensor([int(second_leads(text)) for text in batch.texts])


def save_classifier(model: Classifier, folder: Path) -> None:
    """Write a classifier, whole or not at all.

    Raises:
        CheckpointError: The folder cannot be written to.
    """
    header = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": asdict(model.config),
        "interactions": list(repertoire()),
    }
    save_weights(folder, header, model.state_dict())


def load_classifier(folder: Path) -> Classifier:
    """Return a classifier that :func:`save_classifier` wrote.

    Raises:
        CheckpointError: It is missing or damaged, or of another repertoire.
    """
    header, tensors = load_weights(folder)
    where = str(folder)
    require_format(header, FORMAT, VERSION, where)
    if header.get("interactions") != list(repertoire()):
        raise CheckpointError("it knows another repertoire", where=where, hint="delete it")
    model = Classifier(
        from_json(EvaluatorConfig, header.get("architecture"), where), len(repertoire())
    )
    adopt(model, tensors, where=where)
    return model.eval()


@torch.no_grad()
def classified(
    model: Classifier, features: Sequence[NDArray[np.float32]], batch: int = 50
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return what is done ``[N]`` (numbers in the repertoire) and whether b leads ``[N]``.

    Args:
        model: The classifier.
        features: N motions ``[T, 2F]`` in metres.
        batch: Motions at a time.
    """
    lengths = np.array([len(x) for x in features])
    what, who = np.empty(len(features), np.int64), np.empty(len(features), np.bool_)
    order = np.argsort(lengths, kind="stable")
    for start in range(0, len(order), batch):
        rows = order[start : start + batch]
        padded = np.zeros((len(rows), lengths[rows].max(), features[0].shape[1]), np.float32)
        for slot, row in zip(padded, rows, strict=True):
            slot[: lengths[row]] = features[row]
        done, leads = model(torch.from_numpy(padded), torch.from_numpy(lengths[rows]))
        what[rows] = done.argmax(dim=1).numpy()
        who[rows] = leads.argmax(dim=1).numpy() == 1
    return what, who
