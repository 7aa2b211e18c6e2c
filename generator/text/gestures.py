"""Sentences about an exchange of gestures, from ``data/gestures.toml``.

Like :mod:`generator.text.grammar`, but each person has a verb, and words of the manner, alone:
"The first person bows deeply and the other waves back slowly."
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

import numpy as np

from generator.choreographer.exchange import GESTURES, STAND
from generator.choreographer.style import Style
from generator.text.grammar import (
    NOTABLE,
    ORDINARY,
    Clause,
    Voice,
    choices,
    describe,
    manner_words,
    people,
)
from robots.errors import PromptError, nearest

SAID = ("speed", "energy", "amplitude")
"""Numbers of the style that a gesture's adverbs tell; of the second, the lag as well."""
LAG = "lag"
_ANSWERED, _BEFORE, _RELATIVE = 0.3, 0.2, 0.5
"""Shares of verbs that answer (*back*), of single adverbs that go before the verb, and of joints by
*who* where there may be one."""


@dataclass(frozen=True, slots=True)
class Verb:
    """One wording of a gesture, in the third person."""

    words: str
    """With ``{other}`` where it names the partner."""

    @property
    def plain(self) -> bool:
        """Whether it names nobody."""
        return "{other}" not in self.words


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """How one gesture is said."""

    verbs: tuple[Verb, ...]
    """All wordings."""
    handed: bool
    """Whether it is worth saying that the left hand does it."""
    amplitude: dict[str, tuple[str, ...]]
    """Further words for a ``high`` and a ``low`` amplitude."""


@dataclass(frozen=True, slots=True)
class Exchanged:
    """A sentence about an exchange, and how it was made."""

    text: str
    """The sentence."""
    said: tuple[tuple[str, ...], tuple[str, ...]]
    """Fields of the style that it tells of who begins and of the other."""


@cache
def _data() -> dict:
    file = resources.files("generator.text").joinpath("data/gestures.toml")
    return tomllib.loads(file.read_text("utf-8"))


@cache
def vocabulary(gesture: str) -> Vocabulary:
    """Return how a gesture is said.

    Raises:
        PromptError: There is no such gesture.
    """
    if gesture not in GESTURES:
        raise PromptError(
            f"no gesture '{gesture}'", allowed=", ".join(GESTURES), hint=nearest(gesture, GESTURES)
        )
    data = _data()["verbs"][gesture]
    words = [w for key in ("plain", "to") for pattern in data[key] for w in choices(pattern)]
    further = {key: tuple(data.get(key, ())) for key in ("high", "low")}
    return Vocabulary(
        tuple(Verb(w) for w in dict.fromkeys(words)), bool(data.get("hand", False)), further
    )


def spoken(gesture: str) -> list[str]:
    """Return wordings of a gesture towards "the other", those that answer, and further ones.

    Raises:
        PromptError: There is no such gesture.
    """
    words = [verb.words.replace("{other}", "the other") for verb in vocabulary(gesture).verbs]
    words += [f"{w} back" for w in words if " " not in w and gesture != STAND]
    return [*words, *_data()["verbs"][gesture].get("also", ())]


def duet_with(gesture: str, style: Style) -> str:
    """Return a sentence about an interaction of the repertoire in which somebody makes a gesture.

    Args:
        gesture: One of :data:`~generator.choreographer.GESTURES`.
        style: Manner of the gesture; ``swap`` says that it is person b who makes it.

    Raises:
        PromptError: There is no such gesture.
    """
    interaction, voice, words = duet_wording(gesture)
    manner = Style() if gesture == STAND else replace(style, lag=0.0)
    told = replace(manner, swap=style.swap and voice != "together")
    clause, rng = Clause(words, voice), np.random.default_rng(0)
    return describe(interaction, told, rng, clauses=(clause,), explicit=True).text


def duet_wording(gesture: str) -> tuple[str, Voice, str]:
    """Return the interaction that :func:`duet_with` speaks of, the voice and the words.

    Raises:
        PromptError: There is no such gesture.
    """
    vocabulary(gesture)
    interaction, voice, words = _data()["verbs"][gesture]["duet"]
    return interaction, voice, words


def no_gestures() -> list[str]:
    """Return what one person may do that is no gesture."""
    return list(_data()["outside"]["halves"])


def describe_exchange(
    gestures: tuple[str, str],
    styles: tuple[Style, Style],
    rng: np.random.Generator,
    *,
    verbs: tuple[Sequence[Verb], Sequence[Verb]] | None = None,
) -> Exchanged:
    """Return a sentence about an exchange; it names first who begins.

    Args:
        gestures: What the one does who begins, and what the other does.
        styles: Manner of either; the first one's hand and roles count.
        rng: Source of chance: the same state gives the same sentence.
        verbs: Wordings to choose from; all of the gestures by default.

    Raises:
        PromptError: There is no such gesture.
    """
    known = [vocabulary(gesture) for gesture in gestures]
    names, partners = _names(styles[0], rng)
    parts, said = [], []
    for place, (style, words) in enumerate(zip(styles, known, strict=True)):
        able = [v for v in (verbs[place] if verbs else words.verbs) if partners[place] or v.plain]
        verb = _pick(able or [v for v in words.verbs if v.plain], rng)
        text = verb.words.replace("{other}", partners[place])
        if place and verb.plain and gestures[1] != STAND and rng.random() < _ANSWERED:
            answers = _data()["joints"]["answer" if " " in text else "answer_of_one_word"]
            text += " " + _pick(answers, rng)
        if words.handed and style.handedness == "left":
            text += " " + _pick(_data()["joints"]["hand"], rng)
        told = {} if gestures[place] == STAND else _told(style, words, place, rng)
        parts.append(_with(text, list(told.values()), rng))
        said.append(tuple(told))
    joints = _data()["joints"]
    if partners[0] and parts[0].endswith(names[1]) and rng.random() < _RELATIVE:
        text = f"{names[0]} {parts[0]}{joints['relative']}{parts[1]}"
    else:
        text = f"{names[0]} {parts[0]}{_pick(joints['between'], rng)}{names[1]} {parts[1]}"
    return Exchanged(text[0].upper() + text[1:] + ".", (said[0], said[1]))


def _names(style: Style, rng: np.random.Generator) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return what who begins and the other are called, and what each calls the partner.

    Where a verb cannot name the partner without doubt, the last is empty.
    """
    explicit = style.swap or rng.random() < 0.5
    first, second = _pick(people()["explicit" if explicit else "implicit"], rng)
    if not explicit:
        return (first, second), (second if second.startswith("the other") else "", "")
    if style.swap:
        first, second = second, first
    if len(first) > 1 and rng.random() < 0.25:
        return (first, "the other"), ("", first)
    return (first, second), (second, first)


def _told(style: Style, words: Vocabulary, place: int, rng: np.random.Generator) -> dict[str, str]:
    """Return a word for each number of a style that is far from ordinary."""
    told = {}
    for name in (*SAID, LAG) if place else SAID:
        away = getattr(style, name) - ORDINARY[name]
        if abs(away) < NOTABLE[name]:
            continue
        direction = "low" if away < 0 else "high"
        options = manner_words(name, direction)
        if name == "amplitude":
            # As often as all the others together: they are what people say of this gesture.
            further = list(words.amplitude[direction])
            options = further if further and rng.random() < 0.5 else options
        if options:
            told[name] = _pick(options, rng)
    return told


def _with(text: str, words: list[str], rng: np.random.Generator) -> str:
    """Return a verb with words of its manner: one adverb may go before it."""
    if not words:
        return text
    if len(words) == 1 and words[0].endswith("ly") and rng.random() < _BEFORE:
        return f"{words[0]} {text}"
    adverbs = [word for word in words if " " not in word]
    phrases = [word for word in words if " " in word]
    return " ".join([text, *([" and ".join(adverbs)] if adverbs else []), *phrases])


def _pick(options: Sequence, rng: np.random.Generator):
    return options[int(rng.integers(len(options)))]
