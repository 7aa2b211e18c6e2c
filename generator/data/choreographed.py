"""Clips that the choreographer invents, with sentences that describe them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from generator.data.clip import Clip, clip_of
from generator.motion import DuetMotion
from robots.errors import SpecError

MANNERS = ("slowly", "quickly", "gently", "vigorously", "calmly", "energetically", "briskly")
"""Adverbs that :func:`generator.text.manner.manner_of` understands and any deed can carry."""

_WITH_MANNER = 0.4
"""Share of sentences that get an adverb."""
_SPREAD = 0.08
"""Largest relative deviation of the style from what the sentence says."""


class Choreographed:
    """``count`` duets: every interaction in turn, each performance and sentence its own.

    A clip is a function of the seed and its number. Its sentence is one of the examples of the
    interaction, at times with an adverb; who leads, tempo and vigour are what the sentence says.
    """

    def __init__(
        self, count: int, *, seed: int = 0, interactions: tuple[str, ...] | None = None
    ) -> None:
        """Remember what to invent; each clip is computed when it is asked for, in about 0.2 s.

        Args:
            count: Number of clips.
            seed: Decides all of them.
            interactions: Names from the repertoire; all of it by default.

        Raises:
            SpecError: The count is not positive.
            PromptError: There is no such interaction.
        """
        from generator.choreographer import lookup, repertoire

        if count < 1:
            raise SpecError(f"{count} clips", where="count", allowed="1 or more")
        self._count, self._seed = count, seed
        self._names = interactions or repertoire()
        for name in self._names:
            lookup(name)

    @property
    def name(self) -> str:
        """The choreographer and how many."""
        return f"{self._count} choreographed duets, seed {self._seed}"

    @property
    def fingerprint(self) -> str:
        """Version of the choreographer, repertoire, sentences, seed and number."""
        from generator.choreographer import SOURCE
        from generator.text.examples import examples

        parts = (SOURCE, str(self._count), str(self._seed), ",".join(self._names))
        return "choreographed\n" + "\n".join((*parts, examples().digest, *MANNERS))

    def __len__(self) -> int:
        """Return the number of clips."""
        return self._count

    def clip(self, index: int) -> Clip:
        """Return a clip, computed anew."""
        return clip_of(self.motion(index), f"choreographed {self._seed}/{index}")

    def motion(self, index: int) -> DuetMotion:
        """Return the motion of a clip, with its sentence.

        Raises:
            IndexError: There are not that many.
        """
        from generator.choreographer import choreograph, style_ranges
        from generator.text.manner import manner_of

        if not 0 <= index < self._count:
            raise IndexError(index)
        rng = np.random.default_rng([self._seed, index])
        name = self._names[index % len(self._names)]
        text = self._sentence(name, rng)
        style = manner_of(text)
        values = {}
        for key, (low, high) in style_ranges().items():
            value = getattr(style, key) * rng.uniform(1 - _SPREAD, 1 + _SPREAD)
            values[key] = float(np.clip(value, low, high))
        motion = choreograph(name, seed=int(rng.integers(2**31)), style=replace(style, **values))
        return replace(motion, text=text)

    def _sentence(self, name: str, rng: np.random.Generator) -> str:
        from generator.choreographer import lookup
        from generator.text.examples import examples

        data = examples()
        known = [s for s, n in zip(data.sentences, data.labels, strict=True) if n == name]
        text = str(rng.choice(known or [lookup(name).summary.rstrip(".").lower()]))
        if rng.random() < _WITH_MANNER:
            text = f"{text}, {rng.choice(MANNERS)}"
        return text
