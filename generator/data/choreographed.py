"""Clips that the choreographer invents, with sentences that describe them.

**The problem.** What a model is asked for is mostly plain ("two people shake hands"), sometimes
with one word about the manner, seldom with two. Styles drawn evenly from their ranges would nearly
all be remarkable in three ways at once, and the sentence could say two of them. So most numbers of
a style stay near the ordinary here, and what is far from it is said.

**What is held out.** Some wordings of every interaction never occur in training, and one manner of
every interaction, such as a quick hug, does not either: sentences and combinations that a model can
be tested on (:data:`SPLITS`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from generator.data.clip import Clip, Symmetric, clip_of
from generator.motion import DuetMotion
from robots.errors import MotionError, SpecError

if TYPE_CHECKING:
    from generator.choreographer import Style
    from generator.text.grammar import Clause

Split = Literal["train", "test", "sentences", "combinations"]
SPLITS: tuple[Split, ...] = ("train", "test", "sentences", "combinations")
"""``train``; ``test``: other performances of the same kind; ``sentences``: in wordings that
training does not know; ``combinations``: interactions in a manner that it does not know of them."""

TOLD = 2
"""Sentences of a clip, for each of its four symmetries."""
REMARKABLE = (0.4, 0.4, 0.2)
"""Share of clips with no, one and two remarkable numbers in their style."""
SPREAD = 0.08
"""Largest deviation of the other numbers from the ordinary."""
LEFT = 0.3
"""Share of clips that the left hand leads."""
HELD_OUT = 8
"""One in so many wordings is held out, and at least one."""
ATTEMPTS = 20
"""Draws that are thrown away before giving up."""

_HELD_OUT_FIELDS = ("speed", "energy", "amplitude")


@dataclass(frozen=True, slots=True)
class Manner:
    """A number of the style that is far from ordinary."""

    field: str
    """Its name."""
    direction: Literal["low", "high"]
    """Where it lies."""


def manners() -> list[Manner]:
    """Return everything that a style can be remarkable for."""
    from generator.choreographer import style_ranges
    from generator.text.grammar import NOTABLE, ORDINARY

    found = []
    for name, (low, high) in style_ranges().items():
        if low < ORDINARY[name] - NOTABLE[name]:
            found.append(Manner(name, "low"))
        if high > ORDINARY[name] + NOTABLE[name]:
            found.append(Manner(name, "high"))
    return found


def unseen_manner(interaction: str) -> Manner:
    """Return the manner in which training does not know an interaction."""
    options = [manner for manner in manners() if manner.field in _HELD_OUT_FIELDS]
    return options[number_of(interaction) % len(options)]


def clauses_of(interaction: str, *, unseen: bool) -> tuple[Clause, ...]:
    """Return the wordings of an interaction that training knows, or those that it does not."""
    from generator.text.grammar import VOICES, entry_of

    chosen: list[Clause] = []
    for voice in VOICES:
        clauses = [c for c in entry_of(interaction).clauses if c.voice == voice]
        clauses.sort(key=lambda clause: number_of(f"{interaction}: {clause.words}"))
        held = max(1, len(clauses) // HELD_OUT) if len(clauses) > 2 else 0
        chosen += clauses[:held] if unseen else clauses[held:]
    return tuple(chosen)


def drawn_values(remarkable: Sequence[Manner], rng: np.random.Generator) -> dict[str, float]:
    """Return the numbers of a style that is remarkable for some things and ordinary otherwise."""
    from generator.choreographer import style_ranges
    from generator.text.grammar import NOTABLE, ORDINARY

    directions = {manner.field: manner.direction for manner in remarkable}
    values = {}
    for name, (low, high) in style_ranges().items():
        ordinary, notable = ORDINARY[name], NOTABLE[name]
        direction = directions.get(name)
        if direction is None:
            low, high = max(low, ordinary - SPREAD), min(high, ordinary + SPREAD)
        elif direction == "low":
            high = ordinary - notable
        else:
            low = ordinary + notable
        values[name] = float(rng.uniform(low, high))
    return values


def require_set(count: int, split: str) -> None:
    """Check the size and the kind of a set of clips.

    Raises:
        SpecError: The count is not positive, or there is no such split.
    """
    if count < 1:
        raise SpecError(f"{count} clips", where="count", allowed="1 or more")
    if split not in SPLITS:
        raise SpecError(f"'{split}'", where="split", allowed=", ".join(SPLITS))


def drawn_style(interaction: str, split: Split, rng: np.random.Generator) -> Style:
    """Return the manner of a performance for a split."""
    from generator.choreographer import Style

    unseen = unseen_manner(interaction)
    options = [manner for manner in manners() if manner != unseen]
    count = int(rng.choice(len(REMARKABLE), p=REMARKABLE))
    chosen = [options[i] for i in rng.permutation(len(options))[:count]]
    if split == "combinations":
        chosen = [unseen, *(m for m in chosen[:1] if m.field != unseen.field)]
    values = drawn_values(chosen, rng)
    hand = "left" if rng.random() < LEFT else "right"
    return Style(**values, handedness=hand, swap=bool(rng.random() < 0.5))


@dataclass(frozen=True, slots=True)
class Performance:
    """A duet with what decided it."""

    motion: DuetMotion
    """The duet, with the first of its sentences."""
    style: Style
    """Its manner: who leads, with which hand, how."""
    texts: tuple[str, ...]
    """Its sentences."""


class Choreographed:
    """``count`` duets: every interaction in turn, each performance and its sentences its own.

    A clip is a function of the seed, the split and its number.
    """

    def __init__(
        self,
        count: int,
        *,
        seed: int = 0,
        split: Split = "train",
        interactions: tuple[str, ...] | None = None,
    ) -> None:
        """Remember what to invent; each clip is computed when it is asked for, in about 0.2 s.

        Args:
            count: Number of clips.
            seed: Decides all of them.
            split: Which kind of clips.
            interactions: Names from the repertoire; all of it by default.

        Raises:
            SpecError: The count is not positive, or there is no such split.
            PromptError: There is no such interaction.
        """
        from generator.choreographer import lookup, repertoire

        require_set(count, split)
        self._count, self._seed = count, seed
        self._split: Split = split
        self._names = interactions or repertoire()
        for name in self._names:
            lookup(name)

    @property
    def name(self) -> str:
        """The choreographer and how many."""
        kind = "" if self._split == "train" else f" ({self._split})"
        return f"{self._count} choreographed duets{kind}, seed {self._seed}"

    @property
    def fingerprint(self) -> str:
        """Version of the choreographer, repertoire, sentences, seed, split and number."""
        from generator.choreographer import SOURCE
        from generator.text.grammar import grammar

        parts = (SOURCE, str(self._count), str(self._seed), self._split, ",".join(self._names))
        words = [f"{name}: {grammar()[name]}" for name in self._names]
        return "choreographed\n" + "\n".join((*parts, *words))

    def __len__(self) -> int:
        """Return the number of clips."""
        return self._count

    def interaction(self, index: int) -> str:
        """Return what is done in a clip."""
        return self._names[index % len(self._names)]

    def clip(self, index: int) -> Clip:
        """Return a clip, computed anew.

        Raises:
            IndexError: There are not that many.
        """
        motion, style, rng = self._performed(index)
        plain, mirrored, swapped, both = (
            self._sentences(self.interaction(index), turned, rng) for turned in symmetries(style)
        )
        clip = clip_of(motion, f"choreographed {self._split} {self._seed}/{index}")
        return replace(clip, texts=plain, symmetric=Symmetric(mirrored, swapped, both))

    def motion(self, index: int) -> DuetMotion:
        """Return the motion of a clip, with the first of its sentences.

        Raises:
            IndexError: There are not that many.
        """
        return self.performance(index).motion

    def performance(self, index: int) -> Performance:
        """Return the motion of a clip with the style and the sentences it was made with.

        Raises:
            IndexError: There are not that many.
        """
        motion, style, rng = self._performed(index)
        texts = self._sentences(self.interaction(index), style, rng)
        return Performance(replace(motion, text=texts[0]), style, texts)

    def _performed(self, index: int) -> tuple[DuetMotion, Style, np.random.Generator]:
        """Return a motion that passes the choreographer's own checks, its style, and what is next.

        Raises:
            MotionError: :data:`ATTEMPTS` draws in a row were spoilt.
        """
        from generator.choreographer import choreograph, examine, random_bodies

        if not 0 <= index < self._count:
            raise IndexError(index)
        rng = np.random.default_rng([self._seed, SPLITS.index(self._split), index])
        name = self.interaction(index)
        for _ in range(ATTEMPTS):
            style = drawn_style(name, self._split, rng)
            bodies, seed = random_bodies(rng), int(rng.integers(2**31))
            motion = choreograph(name, seed=seed, style=style, skeletons=bodies)
            if not examine(motion).faults:
                return motion, style, rng
        raise MotionError(f"'{name}' was spoilt in {ATTEMPTS} draws", where=f"clip {index}")

    def _sentences(self, name: str, style: Style, rng: np.random.Generator) -> tuple[str, ...]:
        from generator.text.grammar import describe

        clauses = clauses_of(name, unseen=self._split == "sentences")
        return tuple(describe(name, style, rng, clauses=clauses).text for _ in range(TOLD))


def symmetries(style: Style) -> Sequence[Style]:
    """Return the style itself, in the mirror, with the people exchanged, and both."""
    hand = "left" if style.handedness == "right" else "right"
    mirrored = replace(style, handedness=hand)
    return style, mirrored, *(replace(s, swap=not s.swap) for s in (style, mirrored))


def number_of(text: str) -> int:
    """Return a number that a text decides, the same on every machine."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
