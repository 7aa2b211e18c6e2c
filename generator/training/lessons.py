"""Lessons in reading: what a sentence of the grammar says, before any motion is drawn from it.

**The problem.** Layers that learn to read tokens from the errors of a denoiser alone learn the
wordings that they see by heart. Most of such an error is noise, and nothing in it says that two
wordings mean the same: the network drew 95 % of the known wordings right and 67 % of others, and
who leads it never learnt. But every sentence of the grammar comes with what it says, and to tell
that from it takes minutes: 98 % of unknown wordings, and 99 % of leaders in them. So the layers
learn that first and are then frozen, as the language model before them is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from generator.data.choreographed import clauses_of, drawn_style
from generator.denoiser import Denoiser
from generator.training.fit import Fit, fit
from generator.training.texts import TextTable

BATCH = 48
"""Sentences of a step."""
POOL = 12_000
"""Sentences in all."""
RATE, DECAY = 5e-4, 1e-2
"""Highest learning rate, and weight decay."""


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Sentences with what they say."""

    texts: tuple[str, ...]
    """N sentences."""
    interaction: NDArray[np.int64]
    """``[N]``, what is done, as a number in the repertoire."""
    second_leads: NDArray[np.bool_]
    """``[N]``, whether person b leads."""
    manner: NDArray[np.int64]
    """``[N, M]``, for each number of the style: 0 nothing is said of it, 1 it is low, 2 high."""
    left: NDArray[np.bool_]
    """``[N]``, whether the left hand is said to do it."""


def lesson(count: int, seed: int) -> Lesson:
    """Return sentences in the wordings and manners that training knows."""
    from generator.choreographer import repertoire
    from generator.text.grammar import ORDINARY, describe, entry_of

    rng, names = np.random.default_rng(seed), repertoire()
    texts, second, left = [], [], []
    manner = np.zeros((count, len(ORDINARY)), np.int64)
    interaction = np.arange(count) % len(names)
    for row, number in enumerate(interaction):
        name = names[number]
        style = drawn_style(name, "train", rng)
        sentence = describe(name, style, rng, clauses=clauses_of(name, unseen=False))
        texts.append(sentence.text)
        second.append(style.swap)
        left.append(entry_of(name).handed and style.handedness == "left")
        for column, (field, ordinary) in enumerate(ORDINARY.items()):
            if field in sentence.said:
                manner[row, column] = 1 if getattr(style, field) < ordinary else 2
    return Lesson(tuple(texts), interaction, np.array(second), manner, np.array(left))


class Pupil(nn.Module):
    """The layers of a denoiser that read, and what tells how well they do."""

    def __init__(self, denoiser: Denoiser, interactions: int, manners: int) -> None:
        """Take the layers of a denoiser, which learn in place.

        Args:
            denoiser: Whose layers.
            interactions: Things that can be done.
            manners: Numbers of a style.
        """
        super().__init__()
        self._read = denoiser.read
        self.layers = nn.ModuleList(net.embed_text for net in denoiser.networks)
        if denoiser.config.told_apart:
            self.listener = denoiser.listener
        self.sizes = [interactions, 1, 3 * manners, 1]
        self.tell = nn.Linear(denoiser.config.width, sum(self.sizes))

    def forward(self, cond: Tensor) -> Sequence[Tensor]:
        """Return for each of P listeners and B sentences ``[B, C]`` how likely what is said is.

        Returns:
            Interactions ``[P, B, I]``, whether the listener leads ``[P, B, 1]``, manners
            ``[P, B, 3 M]`` and whether it is the left hand ``[P, B, 1]``, all before the softmax.
        """
        # As it reaches the blocks, but for the time.
        return self.tell(functional.silu(self._read(cond))).split(self.sizes, dim=-1)


def loss(told: Sequence[Tensor], true: Lesson, rows: NDArray[np.int64]) -> Tensor:
    """Return how wrong a pupil's answers about some sentences are."""
    what, leads, manner, left = told
    people = len(what)

    def each(values: NDArray) -> Tensor:
        return torch.from_numpy(values[rows]).expand(people, *values[rows].shape)

    # The second listener leads where person b does.
    own = each(true.second_leads) == torch.tensor([False, True])[:people, None]
    manner = manner.unflatten(-1, (-1, 3))
    return (
        functional.cross_entropy(what.flatten(0, 1), each(true.interaction).flatten())
        + functional.binary_cross_entropy_with_logits(leads[..., 0], own.to(leads.dtype))
        + functional.cross_entropy(manner.flatten(0, 2), each(true.manner).flatten())
        + functional.binary_cross_entropy_with_logits(left[..., 0], each(true.left).to(left.dtype))
    )


def teach(
    denoiser: Denoiser,
    texts: TextTable,
    steps: int,
    *,
    seed: int = 0,
    low_precision: bool = False,
    state: Path | None = None,
    report: Callable[[int, float], None] | None = None,
) -> None:
    """Teach a denoiser's reading layers, in place, and freeze them.

    Args:
        denoiser: One that reads tokens, freshly initialised or trained, whatever the state.
        texts: Vectors of sentences.
        steps: Length of the lessons.
        seed: Of sentences and of what is drawn of them.
        low_precision: Whether products are in bfloat16.
        state: Folder of what to go on from, if there is something.
        report: Told the step and the loss.

    Raises:
        TrainingDiverged: The gradient is no longer finite.
        CheckpointError: The state is damaged or of other lessons.
    """
    device = denoiser.positions.device
    true = lesson(POOL, seed)
    pupil = Pupil(denoiser, int(true.interaction.max()) + 1, true.manner.shape[1]).to(device)

    def loss_of(step: int) -> Tensor:
        rows = np.random.default_rng([seed, step]).integers(POOL, size=BATCH)
        cond = torch.from_numpy(texts.vectors([true.texts[row] for row in rows])).to(device)
        with torch.autocast(device.type, torch.bfloat16, enabled=low_precision):
            told = pupil(cond)
        return loss([part.float().cpu() for part in told], true, rows)

    identity = f"lessons {steps} {seed} {low_precision} {POOL} {BATCH} {denoiser.config}"
    how = Fit(steps, RATE, DECAY, seed=seed)
    fit(pupil, loss_of, how, state=state, identity=identity, report=report)
    freeze_reading(denoiser)


def freeze_reading(denoiser: Denoiser) -> None:
    """Let the layers that read learn no more."""
    for net in denoiser.networks:
        net.embed_text.requires_grad_(False)
    if denoiser.config.told_apart:
        denoiser.listener.requires_grad_(False)
