"""From a sentence to a two-person motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from generator.choreographer.compose import choreograph
from generator.choreographer.exchange import exchange
from generator.motion import DuetMotion

if TYPE_CHECKING:
    from generator.text import SentenceEncoder, Understanding


def generate(
    text: str,
    *,
    seed: int = 0,
    nearest: bool = False,
    style: Mapping[str, float] | None = None,
    encoder: SentenceEncoder | None = None,
) -> tuple[DuetMotion, Understanding]:
    """Return a motion for a sentence, and what the sentence was taken to mean.

    Args:
        text: What two people do, in English.
        seed: Decides what the sentence leaves open; the same seed gives the same motion.
        nearest: Take the nearest interaction if the repertoire does not hold what is asked for.
        style: Numbers of the style that count more than what the sentence says of the manner.
        encoder: Sentence encoder; the one that ships by default.

    Raises:
        SpecError: A number of the style is out of range.
        PromptError: The repertoire does not hold what the sentence asks for.
        CheckpointError: The encoder that ships is missing or damaged.
    """
    from generator.text import choose  # the text package takes Style from this one

    meaning = choose(text, nearest=nearest, encoder=encoder)
    if meaning.exchange is not None:
        one, other = (replace(s, **(style or {})) for s in meaning.exchange.styles)
        motion = exchange(meaning.exchange.gestures, seed=seed, styles=(one, other))
        return replace(motion, text=text), meaning
    if style:
        meaning = replace(meaning, style=replace(meaning.style, **style))
    motion = choreograph(meaning.interaction, seed=seed, style=meaning.style)
    return replace(motion, text=text), meaning
