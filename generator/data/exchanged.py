"""Clips in which each person has a gesture of their own, with sentences that describe them.

They come beside those of :mod:`generator.data.choreographed`, in which both people are about the
same thing: a model that has seen those alone draws two people waving for "the first person bows and
the other waves". Most pairs of gestures are in training; one in :data:`HELD_OUT` is not, and one in
so many wordings, so that both can be asked for as something new.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from generator.data.choreographed import (
    ATTEMPTS,
    HELD_OUT,
    LEFT,
    SPLITS,
    TOLD,
    Split,
    drawn_values,
    manners,
    number_of,
    require_set,
    symmetries,
)
from generator.data.clip import Clip, Symmetric, clip_of
from generator.motion import DuetMotion
from robots.errors import MotionError

if TYPE_CHECKING:
    from generator.choreographer import Style
    from generator.text.gestures import Exchanged as Sentence
    from generator.text.gestures import Verb

REMARKABLE = (0.5, 0.4, 0.1)
"""Share of people with no, one and two remarkable numbers in their style."""

Gestures = tuple[str, str]
Styles = tuple["Style", "Style"]


def pairs(split: Split) -> tuple[Gestures, ...]:
    """Return the pairs of gestures of a split: held out are those of ``combinations``."""
    from generator.choreographer import GESTURES, STAND

    both = [(a, b) for a in GESTURES for b in GESTURES if (a, b) != (STAND, STAND)]
    unseen = split == "combinations"
    return tuple(p for p in both if (number_of("+".join(p)) % HELD_OUT == 0) == unseen)


def verbs_of(gesture: str, *, unseen: bool) -> tuple[Verb, ...]:
    """Return the wordings of a gesture that training knows, or those that it does not."""
    from generator.text.gestures import vocabulary

    chosen: list[Verb] = []
    for plain in (True, False):
        verbs = [verb for verb in vocabulary(gesture).verbs if verb.plain == plain]
        verbs.sort(key=lambda verb: number_of(f"{gesture}: {verb.words}"))
        held = max(1, len(verbs) // HELD_OUT) if len(verbs) > 2 else 0
        chosen += verbs[:held] if unseen else verbs[held:]
    return tuple(chosen)


def drawn_styles(rng: np.random.Generator) -> Styles:
    """Return a manner for who begins and one for the other; hand and roles are common."""
    from generator.choreographer import Style
    from generator.text.gestures import LAG, SAID

    hand = "left" if rng.random() < LEFT else "right"
    swap = bool(rng.random() < 0.5)
    styles = []
    for place in (0, 1):
        options = [m for m in manners() if m.field in SAID or (place and m.field == LAG)]
        count = int(rng.choice(len(REMARKABLE), p=REMARKABLE))
        chosen = [options[i] for i in rng.permutation(len(options))[:count]]
        values = drawn_values(chosen, rng)
        styles.append(Style(**values, handedness=hand, swap=swap))
    return styles[0], styles[1]


def told(gestures: Gestures, styles: Styles, split: Split, rng: np.random.Generator) -> Sentence:
    """Return a sentence about an exchange, in wordings of a split."""
    from generator.text.gestures import describe_exchange

    unseen = split == "sentences"
    verbs = tuple(verbs_of(gesture, unseen=unseen) for gesture in gestures)
    return describe_exchange(gestures, styles, rng, verbs=(verbs[0], verbs[1]))


@dataclass(frozen=True, slots=True)
class Given:
    """An exchange with what decided it."""

    motion: DuetMotion
    """The duet, with the first of its sentences."""
    gestures: Gestures
    """Of who begins and of the other."""
    styles: Styles
    """Their manners; the first one's says who begins."""
    texts: tuple[str, ...]
    """Its sentences."""


class Exchanged:
    """``count`` exchanges of gestures: every pair of a split in turn.

    A clip is a function of the seed, the split and its number.
    """

    def __init__(self, count: int, *, seed: int = 0, split: Split = "train") -> None:
        """Remember what to invent; each clip is computed when it is asked for, in about 0.1 s.

        Args:
            count: Number of clips.
            seed: Decides all of them.
            split: Which kind of clips.

        Raises:
            SpecError: The count is not positive, or there is no such split.
        """
        require_set(count, split)
        self._count, self._seed = count, seed
        self._split: Split = split
        self._pairs = pairs(split)

    @property
    def name(self) -> str:
        """The choreographer and how many."""
        kind = "" if self._split == "train" else f" ({self._split})"
        return f"{self._count} exchanges of gestures{kind}, seed {self._seed}"

    @property
    def fingerprint(self) -> str:
        """Version of the choreographer, gestures, sentences, seed, split and number."""
        from generator.choreographer import GESTURES, SOURCE
        from generator.text.gestures import vocabulary

        parts = (SOURCE, str(self._count), str(self._seed), self._split)
        words = [f"{name}: {vocabulary(name)}" for name in GESTURES]
        return "exchanged\n" + "\n".join((*parts, *words))

    def __len__(self) -> int:
        """Return the number of clips."""
        return self._count

    def gestures(self, index: int) -> Gestures:
        """Return the gestures of a clip: the pairs in an order that depends on the seed."""
        turn, place = divmod(index, len(self._pairs))
        order = np.random.default_rng([self._seed, turn]).permutation(len(self._pairs))
        return self._pairs[order[place]]

    def clip(self, index: int) -> Clip:
        """Return a clip, computed anew.

        Raises:
            IndexError: There are not that many.
            MotionError: :data:`ATTEMPTS` draws in a row were spoilt.
        """
        motion, styles, rng = self._performed(index)
        turned = zip(*(symmetries(style) for style in styles), strict=True)
        plain, mirrored, swapped, both = (
            self._sentences(self.gestures(index), pair, rng) for pair in turned
        )
        clip = clip_of(motion, f"exchanged {self._split} {self._seed}/{index}")
        return replace(clip, texts=plain, symmetric=Symmetric(mirrored, swapped, both))

    def performance(self, index: int) -> Given:
        """Return the motion of a clip with what decided it.

        Raises:
            IndexError: There are not that many.
            MotionError: :data:`ATTEMPTS` draws in a row were spoilt.
        """
        motion, styles, rng = self._performed(index)
        gestures = self.gestures(index)
        texts = self._sentences(gestures, styles, rng)
        return Given(replace(motion, text=texts[0]), gestures, styles, texts)

    def _performed(self, index: int) -> tuple[DuetMotion, Styles, np.random.Generator]:
        """Return a motion that passes the choreographer's own checks, its styles, what is next."""
        from generator.choreographer import examine, exchange, random_bodies

        if not 0 <= index < self._count:
            raise IndexError(index)
        rng = np.random.default_rng([self._seed, SPLITS.index(self._split), index, len("exchange")])
        gestures = self.gestures(index)
        for _ in range(ATTEMPTS):
            styles = drawn_styles(rng)
            bodies, seed = random_bodies(rng), int(rng.integers(2**31))
            motion = exchange(gestures, seed=seed, styles=styles, skeletons=bodies)
            if not examine(motion).faults:
                return motion, styles, rng
        raise MotionError(f"{gestures} was spoilt in {ATTEMPTS} draws", where=f"clip {index}")

    def _sentences(
        self, gestures: Gestures, styles: Styles, rng: np.random.Generator
    ) -> tuple[str, ...]:
        return tuple(told(gestures, styles, self._split, rng).text for _ in range(TOLD))
