"""Sentences in two halves, each about one person: "the first bows, and the other waves back".

What the halves say is a matter of meaning (:mod:`generator.text.understand`); where one ends, and
whom each is about, is a matter of a few words. A sentence is taken for an exchange only where both
halves are gestures that the choreographer lets anybody make alone, and no interaction of its
repertoire holds the two anyway.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from generator.choreographer.style import Style
from generator.text.manner import manner_of
from generator.text.mentions import mentions

_NAME = (
    r"(?:the (?:other|first|second)|another|person (?:one|two|a|b|1|2)|someone else|(?-i:A|B))\b"
)
_JOINT = re.compile(
    rf"(?:;|[.,]?\s+(?:and|while|whereas|but|as|then|whilst)(?: then)?|,)\s+(?={_NAME})"
    r"|,?\s+who\s+(?:then\s+)?",
    re.IGNORECASE,
)
_SUBJECT = re.compile(
    rf"^(?:(?:the|a|an|one)\s+)?(?:(?:{_NAME}|one|someone|somebody|first|other|man|woman|dancer)"
    r"(?:\s+(?:person|one|man|woman|dancer|player|of them|of the two))?\s+)",
    re.IGNORECASE,
)
_SAME = frozenset({("applaud", "bow"), ("curtsy", "bow"), ("point", "namaste")})
"""What the repertoire has as one interaction; *namaste* is how raised palms read there."""


class Gesture(NamedTuple):
    """What one person was understood to do."""

    name: str
    confidence: float


@dataclass(frozen=True, slots=True)
class Exchange:
    """What each of two people does, in the order of the sentence."""

    gestures: tuple[str, str]
    """Of who is named first, and of the other."""
    styles: tuple[Style, Style]
    """Manner of either; the same hand and roles."""
    confidence: float
    """Probability of the less certain one, 0..1."""


def exchange_of(text: str, gesture: Callable[[str], Gesture | None]) -> Exchange | None:
    """Return what each of two people does, or nothing if the sentence is not an exchange.

    Args:
        text: The sentence.
        gesture: Returns what a sentence about one person says, if it is a gesture.
    """
    halves = halves_of(text)
    if halves is None:
        return None
    parts = [_anybody(half) for half in halves]
    first = gesture(parts[0]) if all(parts) else None
    second = None if first is None else gesture(parts[1])
    if first is None or second is None or (first.name, second.name) in _SAME:
        return None
    named = mentions(text)
    swap = bool(named) and named[0].person == "b"
    hand = manner_of(text).handedness  # whichever half says so
    leading, answering = (replace(manner_of(half), handedness=hand, swap=swap) for half in halves)
    if first.name == second.name and replace(answering, lag=leading.lag) == leading:
        return None
    confidence = min(first.confidence, second.confidence)
    return Exchange((first.name, second.name), (leading, answering), confidence)


def halves_of(text: str) -> tuple[str, str] | None:
    """Return the two halves of a sentence, if it is about one person and then about the other."""
    joint = _JOINT.search(text)
    if joint is None or _JOINT.search(text, joint.end()):
        return None
    named = mentions(text)
    later = [m for m in named if m.start >= joint.end()]
    relative = "who" in joint[0].lower()
    if not relative and later and later[0].person == named[0].person:
        return None
    return text[: joint.start()].strip(), text[joint.end() :].strip(" .!")


def _anybody(half: str) -> str:
    """Return half a sentence with *one person* for its subject, as the examples have it.

    Nothing if there is no more than a subject.
    """
    rest = _SUBJECT.sub("", half + " ", count=1).strip()
    return f"one person {rest}" if rest else ""
