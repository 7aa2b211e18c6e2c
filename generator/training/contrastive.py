"""Training of the contrastive evaluator (Sec. 5, "Evaluation metrics"): CLIP's loss on clips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor, nn

from generator.architecture import FEATURES
from generator.data import Batch, BatchStream, FeatureStatistics
from generator.evaluator import CONTACTS, EvaluatorConfig, InterClip
from generator.schedule import warmup_cosine
from generator.text.encoder import SentenceEncoder
from generator.training.draws import seed_dropout, seed_weights
from generator.training.learner import TrainingDiverged
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
    """Size; its text path must be that of a sentence encoder."""
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
        if self.architecture.text != "sentence":
            raise SpecError(
                "an evaluator is trained on sentence vectors here",
                where="evaluator.text",
                allowed="sentence",
            )


def train_evaluator(
    stream: BatchStream,
    statistics: FeatureStatistics,
    encoder: SentenceEncoder,
    config: ContrastiveConfig | None = None,
    *,
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
        report: Told the step, the loss and the share of motions whose sentence is the nearest one
            of the batch, every 50 steps.

    Raises:
        SpecError: The features are canonical.
        TrainingDiverged: The loss is no longer finite.
    """
    config = config or ContrastiveConfig()
    if stream.config.representation != "non_canonical" or len(statistics.mean) != FEATURES:
        raise SpecError("an evaluator sees non-canonical features", where="evaluator")
    seed_weights(config.seed)
    architecture = replace(config.architecture, text_width=text_width(encoder))
    model = InterClip(architecture, sentences=encoder)
    texts = TextTable(encoder)
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )
    mean, std = (torch.tensor(x, dtype=torch.float32) for x in (statistics.mean, statistics.std))
    model.train()
    for step in range(config.steps):
        batch = stream.batch(step)
        rate = warmup_cosine(step, config.steps / 10, config.steps) * config.learning_rate
        for group in optimiser.param_groups:
            group["lr"] = rate
        seed_dropout(config.seed, step, 0)
        vectors = torch.from_numpy(texts.vectors(batch.texts))
        motion = ((torch.from_numpy(batch.x_raw).unflatten(-1, (2, -1)) - mean) / std).flatten(-2)
        loss = model.loss(motion, torch.from_numpy(batch.lengths), vectors, same_texts(batch))
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(list(model.parameters()), config.clip)
        if not bool(torch.isfinite(norm)):
            raise TrainingDiverged(f"the evaluator's gradient is not finite at step {step}")
        optimiser.step()
        if report is not None and ((step + 1) % 50 == 0 or step + 1 == config.steps):
            report(step + 1, float(loss.detach()), _nearest_share(model, motion, batch, vectors))
            model.train()
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
