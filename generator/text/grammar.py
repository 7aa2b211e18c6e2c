"""Sentences about a performance, from a grammar that is data (``data/grammar``).

**The problem.** A sentence has to say what the motion does: the interaction, who leads, with which
hand, how. So it is made from the style, not beside it. A *clause* is one wording of an interaction
with places for two names; the *names* say who leads, or leave it open; *manner* words are chosen
from the numbers of the style that are far from ordinary, in the direction in which
:mod:`generator.text.manner` reads them. What is said can therefore be read back.

Example: push, led by person b, speed 0.7. Clause ``{first} shoves {second} away``, names *the
second person, the first person*, manner *slowly*: "The second person shoves the first person away
slowly."
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from itertools import product
from typing import Literal

import numpy as np

from generator.choreographer.interaction import lookup
from generator.choreographer.spacing import Apart
from generator.choreographer.style import Style
from robots.errors import PromptError, SpecError, nearest

Voice = Literal["together", "active", "passive"]
VOICES: tuple[Voice, ...] = ("together", "active", "passive")
ORDINARY = {"speed": 1.0, "energy": 1.0, "amplitude": 1.0, "distance": 1.0, "lag": 0.0}
NOTABLE = {"speed": 0.15, "energy": 0.2, "amplitude": 0.2, "distance": 0.15, "lag": 0.25}
"""How far from ordinary a number of the style has to be to be worth a word."""
MOST_WORDS = 2
"""Manner words in one sentence."""
_CHOICE = re.compile(r"\[([^\[\]]*)\]")


@dataclass(frozen=True, slots=True)
class Clause:
    """One wording of an interaction."""

    words: str
    """With ``{first}`` and ``{second}`` for the names, unless the voice is together."""
    voice: Voice
    """Whether the two act together, the leading one acts, or the other is acted upon."""


@dataclass(frozen=True, slots=True)
class Entry:
    """How one interaction is said."""

    clauses: tuple[Clause, ...]
    """All wordings."""
    handed: bool = False
    """Whether it is worth saying that the left hand does it."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence and how it was made."""

    text: str
    """The sentence."""
    clause: Clause
    """The wording it is of."""
    said: tuple[str, ...] = field(default=())
    """Fields of the style that it expresses by a word."""


def choices(pattern: str) -> list[str]:
    """Return all wordings of a pattern in which ``[a|b|]`` stands for one of the alternatives."""
    parts = _CHOICE.split(pattern)
    options = [part.split("|") if i % 2 else [part] for i, part in enumerate(parts)]
    return [" ".join("".join(combination).split()) for combination in product(*options)]


@cache
def people() -> dict:
    """Return what people are called and how a style is said, from ``people.toml``."""
    return _read("people.toml")


@cache
def grammar() -> dict[str, Entry]:
    """Return how each interaction is said.

    Raises:
        SpecError: An entry of the data has an unknown key.
    """
    folder = resources.files("generator.text").joinpath("data/grammar")
    files = sorted(f.name for f in folder.iterdir() if f.name.endswith(".toml"))
    entries = {}
    for file in files:
        if file != "people.toml":
            for name, data in _read(file).items():
                entries[name] = _entry(name, data)
    return entries


def _entry(name: str, data: dict) -> Entry:
    known = (*VOICES, "hand")
    for key in data:
        if key not in known:
            raise SpecError(f"unknown key '{key}'", where=name, hint=nearest(key, known))
    clauses = [
        Clause(words, voice)
        for voice in VOICES
        for pattern in data.get(voice, ())
        for words in choices(pattern)
    ]
    return Entry(tuple(dict.fromkeys(clauses)), bool(data.get("hand", False)))


def _read(name: str) -> dict:
    file = resources.files("generator.text").joinpath(f"data/grammar/{name}")
    return tomllib.loads(file.read_text("utf-8"))


def entry_of(interaction: str) -> Entry:
    """Return how an interaction is said.

    Raises:
        PromptError: The grammar does not know it.
    """
    try:
        return grammar()[interaction]
    except KeyError:
        raise PromptError(
            f"no sentences for '{interaction}'",
            allowed=", ".join(sorted(grammar())),
            hint=nearest(interaction, grammar()),
        ) from None


def describe(
    interaction: str,
    style: Style,
    rng: np.random.Generator,
    *,
    clauses: tuple[Clause, ...] | None = None,
    explicit: bool = False,
) -> Sentence:
    """Return a sentence about a performance.

    Who leads is said where it is person b; a reader takes person a for the leading one otherwise.

    Args:
        interaction: A name from the repertoire.
        style: Manner of the performance.
        rng: Source of chance: the same state gives the same sentence.
        clauses: Wordings to choose from; all of the interaction by default.
        explicit: Say who leads where it is person a, too.

    Raises:
        PromptError: The grammar does not know the interaction, or is left no clause to say it with.
    """
    entry = entry_of(interaction)
    able = [c for c in clauses or entry.clauses if not (style.swap and c.voice == "together")]
    if not able:
        raise PromptError(f"no clause says who leads '{interaction}'", allowed="active, passive")
    voice = _pick(list(dict.fromkeys(c.voice for c in able)), rng)
    clause = _pick([c for c in able if c.voice == voice], rng)
    text = _named(clause, style, rng, explicit=explicit)
    if entry.handed and style.handedness == "left":
        text += " " + _pick(people()["hand"]["together" if voice == "together" else "single"], rng)
    words = _manner(style, rng, apart=isinstance(lookup(interaction).spacing, Apart))
    manner = _joined(list(words.values()))
    before = manner.endswith("ly") and "," not in text and not text.startswith(("A ", "B "))
    if before and rng.random() < 0.25:
        text = f"{manner}, {text}"
    elif manner:
        text = f"{text} {manner}"
    return Sentence(text[0].upper() + text[1:] + ".", clause, tuple(words))


def _joined(words: list[str]) -> str:
    """Return manner words as one phrase: adverbs first, joined by *and*."""
    adverbs = [word for word in words if word.endswith("ly")]
    phrases = [word for word in words if not word.endswith("ly")]
    return " ".join([" and ".join(adverbs), *phrases]).strip()


def _named(clause: Clause, style: Style, rng: np.random.Generator, *, explicit: bool) -> str:
    """Return a clause with names in it."""
    called = people()
    if clause.voice == "together":
        return f"{_pick(called['together'], rng)} {clause.words}"
    explicit = explicit or style.swap or rng.random() < 0.5
    first, second = _pick(called["explicit" if explicit else "implicit"], rng)
    if style.swap:
        first, second = second, first
    return clause.words.replace("{first}", first).replace("{second}", second)


def _manner(style: Style, rng: np.random.Generator, *, apart: bool) -> dict[str, str]:
    """Return a word for up to :data:`MOST_WORDS` of the numbers that are far from ordinary.

    Of the distance nothing is said unless people stand apart: a hug from afar is none.
    """
    words = {}
    for name, ordinary in ORDINARY.items():
        if name == "distance" and not apart:
            continue
        away = getattr(style, name) - ordinary
        if abs(away) >= NOTABLE[name]:
            known = people()["manner"][name].get("low" if away < 0 else "high")
            if known:
                words[name] = _pick(known, rng)
    kept = rng.permutation(list(words))[:MOST_WORDS] if words else []
    return {name: words[name] for name in words if name in kept}


def _pick(options: list, rng: np.random.Generator):
    return options[int(rng.integers(len(options)))]


def manner_words(name: str, direction: Literal["low", "high"]) -> list[str]:
    """Return the words that say that a number of the style is low or high."""
    return list(people()["manner"][name].get(direction, ()))
