"""What a model that has seen the choreographer's repertoire alone does with a sentence.

Such a model draws something for any sentence, but what it draws of things that it has never seen
means nothing. So it answers for the sentences for which the choreographer answers, and for no
others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from generator.text import choose
from generator.text.grammar import describe


@dataclass(frozen=True, slots=True)
class Reading:
    """What sentences were taken to mean."""

    facts: tuple[dict[str, Any], ...] = ()
    """Interaction and confidence of each; nothing for a model that may know more."""
    instead: Mapping[str, str] = field(default_factory=dict)
    """Sentences that are drawn in place of those that the model does not know."""


NOTHING_READ = Reading()


def read(texts: tuple[str, ...], *, nearest: bool) -> Reading:
    """Return what sentences mean within the repertoire.

    Args:
        texts: The sentences.
        nearest: Draw the nearest interaction, in words of the repertoire and in the manner of the
            sentence, where a sentence asks for something else.

    Raises:
        PromptError: A sentence asks for something else, and ``nearest`` is off.
    """
    facts, instead = [], {}
    for text in texts:
        meaning = choose(text, nearest=nearest)
        facts.append(
            {
                "interaction": meaning.deed,
                "confidence": round(float(meaning.certainty), 4),
            }
        )
        if not meaning.known:
            rng = np.random.default_rng(0)
            instead[text] = describe(meaning.interaction, meaning.style, rng).text
    return Reading(tuple(facts), instead)
