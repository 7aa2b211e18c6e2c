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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from generator.data import exchanged
from generator.data.choreographed import clauses_of, drawn_style
from generator.denoiser import Denoiser
from generator.training.fit import Fit, fit
from generator.training.texts import TextTable

if TYPE_CHECKING:
    from generator.choreographer import Style

BATCH = 64
"""Sentences of a step."""
POOL = 20_000
"""Sentences in all."""
EXCHANGES = 2
"""One sentence in so many is about an exchange of gestures, for a model that is to draw them. Who
does what in those takes longest to learn: with one in four, pairs were learnt by heart."""
RATE, DECAY = 5e-4, 1e-2
"""Highest learning rate, and weight decay."""


@dataclass(frozen=True, slots=True, eq=False)
class Lesson:
    """Sentences with what they say, of person a and of person b."""

    texts: tuple[str, ...]
    """N sentences."""
    deed: NDArray[np.int64]
    """``[N, 2]``, what each does, as a number in :func:`deeds`."""
    second_leads: NDArray[np.bool_]
    """``[N]``, whether person b leads, or begins."""
    manner: NDArray[np.int64]
    """``[N, 2, M]``, for each number of a style: 0 nothing is said of it, 1 it is low, 2 high."""
    left: NDArray[np.bool_]
    """``[N, 2]``, whether the left hand is said to do it."""


def deeds() -> tuple[str, ...]:
    """Return all that somebody can do: the interactions of the repertoire, and standing."""
    from generator.choreographer import STAND, repertoire

    return (*repertoire(), STAND)


def lesson(count: int, seed: int, *, exchanges: bool) -> Lesson:
    """Return sentences in the wordings and manners that training knows.

    Args:
        count: So many.
        seed: What they are drawn from.
        exchanges: Whether one in :data:`EXCHANGES` is about an exchange of gestures.
    """
    from generator.choreographer import repertoire
    from generator.text.grammar import ORDINARY

    rng, names = np.random.default_rng(seed), repertoire()
    texts, second = [], np.zeros(count, np.bool_)
    deed, left = np.zeros((count, 2), np.int64), np.zeros((count, 2), np.bool_)
    manner = np.zeros((count, 2, len(ORDINARY)), np.int64)
    others = 0
    for row in range(count):
        if exchanges and row % EXCHANGES == 0:
            told = _of_exchange(rng)
        else:
            told = _of_interaction(names[others % len(names)], rng)
            others += 1
        texts.append(told.text)
        second[row] = told.styles[0].swap
        for part, style in enumerate(told.styles):
            person = part ^ int(style.swap)
            deed[row, person] = deeds().index(told.deeds[part])
            left[row, person] = told.handed[part] and style.handedness == "left"
            for column, (field, ordinary) in enumerate(ORDINARY.items()):
                if field in told.said[part]:
                    manner[row, person, column] = 1 if getattr(style, field) < ordinary else 2
    return Lesson(tuple(texts), deed, second, manner, left)


class _Told(NamedTuple):
    """A sentence with what it says of who leads or begins, and of the other."""

    text: str
    deeds: tuple[str, str]
    styles: tuple[Style, Style]
    said: tuple[Sequence[str], Sequence[str]]
    handed: tuple[bool, bool]


def _of_interaction(name: str, rng: np.random.Generator) -> _Told:
    from generator.text.grammar import describe, entry_of

    style = drawn_style(name, "train", rng)
    sentence = describe(name, style, rng, clauses=clauses_of(name, unseen=False))
    handed = entry_of(name).handed
    return _Told(
        sentence.text,
        (name, name),
        (style, style),
        (sentence.said, sentence.said),
        (handed, handed),
    )


def _of_exchange(rng: np.random.Generator) -> _Told:
    from generator.text.gestures import vocabulary

    known = exchanged.pairs("train")
    gestures, styles = known[rng.integers(len(known))], exchanged.drawn_styles(rng)
    sentence = exchanged.told(gestures, styles, "train", rng)
    one, other = (vocabulary(gesture).handed for gesture in gestures)
    return _Told(sentence.text, gestures, styles, sentence.said, (one, other))


class Pupil(nn.Module):
    """The layers of a denoiser that read, and what tells how well they do."""

    def __init__(self, denoiser: Denoiser, deeds: int, manners: int) -> None:
        """Take the layers of a denoiser, which learn in place.

        Args:
            denoiser: Whose layers.
            deeds: Things that can be done.
            manners: Numbers of a style.
        """
        super().__init__()
        self._read = denoiser.read
        self.layers = nn.ModuleList(net.embed_text for net in denoiser.networks)
        if denoiser.config.told_apart:
            self.listener = denoiser.listener
        self.sizes = [2 * deeds, 1, 2 * 3 * manners, 2]
        self.tell = nn.Linear(denoiser.config.width, sum(self.sizes))

    def forward(self, cond: Tensor) -> Sequence[Tensor]:
        """Return for each of P listeners and B sentences ``[B, C]`` how likely what is said is.

        Returns:
            Deeds ``[P, B, 2, I]`` of the listener and of the partner, whether the listener leads
            ``[P, B]``, manners ``[P, B, 2, M, 3]`` and left hands ``[P, B, 2]``, all before the
            softmax.
        """
        # As it reaches the blocks, but for the time.
        told = self.tell(functional.silu(self._read(cond)))
        what, leads, manner, left = told.split(self.sizes, dim=-1)
        return (
            what.unflatten(-1, (2, -1)),
            leads[..., 0],
            manner.unflatten(-1, (2, -1, 3)),
            left,
        )


def loss(told: Sequence[Tensor], true: Lesson, rows: NDArray[np.int64]) -> Tensor:
    """Return how wrong a pupil's answers about some sentences are."""
    what, leads, manner, left = told
    people = len(what)

    def heard(values: NDArray) -> Tensor:
        """Return values ``[N, 2, ...]`` as ``[P, B, 2, ...]``: of the listener, of the partner."""
        chosen = torch.from_numpy(values[rows])
        return torch.stack([chosen, chosen.flip(1)][:people])

    # The second listener leads where person b does.
    second = torch.from_numpy(true.second_leads[rows])
    own = torch.stack([~second, second][:people])
    return (
        functional.cross_entropy(what.flatten(0, 2), heard(true.deed).flatten())
        + functional.binary_cross_entropy_with_logits(leads, own.to(leads.dtype))
        + functional.cross_entropy(manner.flatten(0, 3), heard(true.manner).flatten())
        + functional.binary_cross_entropy_with_logits(left, heard(true.left).to(left.dtype))
    )


def teach(
    denoiser: Denoiser,
    texts: TextTable,
    steps: int,
    *,
    exchanges: bool,
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
        exchanges: Whether they are also about people who make a gesture each.
        seed: Of sentences and of what is drawn of them.
        low_precision: Whether products are in bfloat16.
        state: Folder of what to go on from, if there is something.
        report: Told the step and the loss.

    Raises:
        TrainingDiverged: The gradient is no longer finite.
        CheckpointError: The state is damaged or of other lessons.
    """
    device = denoiser.positions.device
    true = lesson(POOL, seed, exchanges=exchanges)
    pupil = Pupil(denoiser, len(deeds()), true.manner.shape[2]).to(device)

    def loss_of(step: int) -> Tensor:
        rows = np.random.default_rng([seed, step]).integers(POOL, size=BATCH)
        cond = torch.from_numpy(texts.vectors([true.texts[row] for row in rows])).to(device)
        with torch.autocast(device.type, torch.bfloat16, enabled=low_precision):
            told = pupil(cond)
        return loss([part.float().cpu() for part in told], true, rows)

    identity = (
        f"lessons/3 {steps} {exchanges} {seed} {low_precision} {POOL} {BATCH} {denoiser.config}"
    )
    how = Fit(steps, RATE, DECAY, seed=seed)
    fit(pupil, loss_of, how, state=state, identity=identity, report=report)
    freeze_reading(denoiser)


def freeze_reading(denoiser: Denoiser) -> None:
    """Let the layers that read learn no more."""
    for net in denoiser.networks:
        net.embed_text.requires_grad_(False)
    if denoiser.config.told_apart:
        denoiser.listener.requires_grad_(False)
