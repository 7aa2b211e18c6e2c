"""Training of the contrastive evaluator (Sec. 5, "Evaluation metrics"): CLIP's loss on clips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from generator.architecture import FEATURES
from generator.data import Batch, BatchStream, FeatureStatistics
from generator.evaluator import CONTACTS, EvaluatorConfig, InterClip
from generator.text.encoder import SentenceEncoder, TokenEncoder
from generator.training.draws import seed_weights
from generator.training.fit import Fit, fit
from generator.training.texts import TextTable, text_width
from robots.errors import SpecError

SMALL = EvaluatorConfig(
    width=256, layers=4, heads=4, feedforward=512, embedding=256, dropout=0.1, text="sentence"
)
"""An evaluator that can be trained on a few thousand clips and one core."""


@dataclass(frozen=True, slots=True)
class ContrastiveConfig:
    """How an evaluator is trained; the batches, and their size, are those of the stream.

    Raises:
        SpecError: A number is out of range.
    """

    architecture: EvaluatorConfig = field(default_factory=lambda: SMALL)
    """Size; its text path must be one of a frozen sentence encoder."""
    steps: int = 1000
    """Length of the run."""
    learning_rate: float = 5e-4
    """Highest learning rate; a tenth of the run warms up, then half a cosine."""
    weight_decay: float = 1e-3
    """Of AdamW."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    seed: int = 0
    """Of initial weights and drop-out."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.steps < 1 or self.learning_rate <= 0:
            raise SpecError(f"{self.steps} steps at {self.learning_rate}", where="evaluator")
        if self.architecture.text == "tokens":
            raise SpecError(
                "an evaluator is trained on what a frozen sentence encoder gives here",
                where="evaluator.text",
                allowed="sentence, states",
            )


def train_evaluator(
    stream: BatchStream,
    statistics: FeatureStatistics,
    encoder: SentenceEncoder,
    config: ContrastiveConfig | None = None,
    *,
    state: Path | None = None,
    cache: str | Path | None = None,
    report: Callable[[int, float, float], None] | None = None,
) -> InterClip:
    """Return an evaluator that was trained on a stream of clips.

    **The problem.** An evaluator takes metres, in which a displacement per frame is a hundred times
    smaller than a position: trained on them, it would hardly see movement. So it learns on
    normalised features, and the normalisation is multiplied into its first layer at the end.

    Args:
        stream: Batches of non-canonical features; larger ones give more wrong answers to tell from.
        statistics: Of these features.
        encoder: Frozen sentence encoder.
        config: How.
        state: Folder of what to go on from, if there is something (:func:`fit`).
        cache: Folder in which vectors of sentences are kept, if any.
        report: Told the step, the loss and the share of motions whose sentence is the nearest one
            of the batch, every 50 steps.

    Raises:
        SpecError: The features are canonical.
        TrainingDiverged: The loss is no longer finite.
        CheckpointError: The state is damaged or of other settings.
    """
    config = config or ContrastiveConfig()
    if stream.config.representation != "non_canonical" or len(statistics.mean) != FEATURES:
        raise SpecError("an evaluator sees non-canonical features", where="evaluator")
    seed_weights(config.seed)
    tokens = encoder.tokens if isinstance(encoder, TokenEncoder) else 1
    model = InterClip(
        replace(config.architecture, text_width=text_width(encoder), text_tokens=tokens),
        sentences=encoder,
    )
    texts = TextTable(encoder, cache)
    mean, std = (torch.tensor(x, dtype=torch.float32) for x in (statistics.mean, statistics.std))

    def pairs(step: int) -> tuple[Batch, Tensor, Tensor]:
        batch = stream.batch(step)
        motion = ((torch.from_numpy(batch.x_raw).unflatten(-1, (2, -1)) - mean) / std).flatten(-2)
        return batch, motion, torch.from_numpy(texts.vectors(batch.texts))

    def loss(step: int) -> Tensor:
        batch, motion, vectors = pairs(step)
        return model.loss(motion, torch.from_numpy(batch.lengths), vectors, same_texts(batch))

    def tell(step: int, loss: float) -> None:
        if report is not None:
            batch, motion, vectors = pairs(step - 1)
            report(step, loss, _nearest_share(model, motion, batch, vectors))

    how = Fit(config.steps, config.learning_rate, config.weight_decay, config.clip, config.seed)
    identity = f"evaluator {config} {stream.config} {stream.epoch} {statistics.mean.sum():.6f}"
    fit(model, loss, how, state=state, identity=identity, report=tell)
    fold(model, mean, std)
    return model.eval()


def same_texts(batch: Batch) -> Tensor:
    """Return ``[B]`` numbers that are equal where the sentences are."""
    return torch.from_numpy(np.unique(np.array(batch.texts), return_inverse=True)[1])


@torch.no_grad()
def _nearest_share(model: InterClip, motion: Tensor, batch: Batch, vectors: Tensor) -> float:
    model.eval()
    motions = model.embed_motion(motion, torch.from_numpy(batch.lengths))
    groups = same_texts(batch)
    nearest = torch.cdist(model.embed_text(vectors), motions).argmin(dim=1)
    return float((groups[nearest] == groups).float().mean())


@torch.no_grad()
def fold(model: InterClip, mean: Tensor, std: Tensor) -> None:
    """Let the first layer take metres: ``W (x - m) / s + b = (W / s) x + (b - W m / s)``."""
    layer = model.motion_encoder.embed_motion
    scale, shift = (x[:-CONTACTS].repeat(2).double() for x in (std, mean))
    weight = layer.weight.double() / scale
    layer.bias.copy_(layer.bias.double() - weight @ shift)
    layer.weight.copy_(weight)
