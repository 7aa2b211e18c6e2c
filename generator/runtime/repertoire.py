"""What a model that has seen the choreographer's repertoire alone does with a sentence.

Such a model draws something for any sentence, but what it draws of things that it has never seen
means nothing. So it answers for the sentences for which the choreographer answers, and for no
others.

**Each their own.** Of "the first person bows and the other waves" such a model makes two people who
wave: it has never seen two gestures in one duet. But it knows two people who bow and two who wave,
and it moves each person apart from the other one, whom it sees. So each is asked for another duet,
the one in which they do what the sentence says of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from generator.text import choose
from generator.text.gestures import duet_with
from generator.text.grammar import describe
from generator.text.halves import Exchange


@dataclass(frozen=True, slots=True)
class Reading:
    """What sentences were taken to mean."""

    facts: tuple[dict[str, Any], ...] = ()
    """Interaction and confidence of each; nothing for a model that may know more."""
    instead: Mapping[str, str] = field(default_factory=dict)
    """Sentences that are drawn in place of those that the model does not know."""
    apart: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Where each has a gesture of their own: what is drawn for person a, and for person b."""


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
    facts, instead, apart = [], {}, {}
    for text in texts:
        meaning = choose(text, nearest=nearest)
        facts.append(
            {
                "interaction": meaning.deed,
                "confidence": round(float(meaning.certainty), 4),
            }
        )
        if meaning.exchange is not None:
            apart[text] = _each(meaning.exchange)
        elif not meaning.known:
            rng = np.random.default_rng(0)
            instead[text] = describe(meaning.interaction, meaning.style, rng).text
    return Reading(tuple(facts), instead, apart)


def _each(exchange: Exchange) -> tuple[str, str]:
    """Return a sentence for person a and one for person b, each about what that person does."""
    both = list(zip(exchange.gestures, exchange.styles, strict=True))
    if exchange.styles[0].swap:
        both.reverse()
    of_a, of_b = (
        duet_with(gesture, replace(style, swap=bool(place)))
        for place, (gesture, style) in enumerate(both)
    )
    return of_a, of_b
