"""Energy and amplitude of a drawn motion, as far as a model has words for them.

**The problem.** A model knows sentences, not numbers; what it knows of energy are the adverbs of
the sentences that it learnt, and these stood there for whole ranges of the number. So a number
becomes the difference that an adverb makes: one branch of the network reads the sentence, another
the sentence with the adverb, and the difference is added in proportion to the number. At the middle
of the range for which the adverb stood the motion is that of the sentence with the adverb.
"""

from __future__ import annotations

import numpy as np

from generator.runtime.network import Accent
from generator.runtime.request import DiffusionRequest
from generator.text.encoder import SentenceEncoder

ACCENTED = ("energy", "amplitude")


def accents_of(
    text: str, request: DiffusionRequest, encoder: SentenceEncoder
) -> tuple[Accent, ...]:
    """Return the accents that a request asks for.

    Args:
        text: The sentence that they are added to.
        request: Whose energy and amplitude count.
        encoder: That of the model.
    """
    asked = {name: getattr(request, name) for name in ACCENTED if getattr(request, name) != 1}
    found = []
    for name, value in asked.items():
        word, middle = _word(name, value)
        cond = np.asarray(encoder.encode([sentence(f"{text.rstrip(' .!')} {word}")]), np.float32)
        found.append(Accent(cond, (value - 1) / (middle - 1)))
    return tuple(found)


def _word(name: str, value: float) -> tuple[str, float]:
    """Return the word for a low or high number, and the middle of the range it stands for."""
    from generator.choreographer.style import style_ranges
    from generator.text.grammar import NOTABLE, manner_words

    low, high = style_ranges()[name]
    if value < 1:
        return manner_words(name, "low")[0], (low + 1 - NOTABLE[name]) / 2
    return manner_words(name, "high")[0], (high + 1 + NOTABLE[name]) / 2


def sentence(text: str) -> str:
    """Return a text that ends as a sentence does: those that a model learnt end with a stop."""
    text = " ".join(text.split())
    return text if text.endswith((".", "!", "?")) else f"{text}."
