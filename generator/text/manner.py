"""How a sentence wants something done and who does it: adverbs, hands, first and second person.

What is done is a matter of meaning (:mod:`generator.text.classifier`); these are matters of single
words and their order, so a small word list and a small grammar answer them.
"""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib import resources

from generator.choreographer.style import Style, style_ranges
from generator.text.mentions import mentions

_BY = re.compile(
    r"\b(?:is|are|was|gets?|being|been)\b[^.;]*"
    r"\bby (?:the )?(?:first|second|a\b|b\b|other|person|dancer)",
    re.IGNORECASE,
)
_RECEIVES = re.compile(
    r"\b(?:receiv\w+|tak(?:es|ing)|accept\w*|gets?|collects?)\b[^.;]*"
    r"\bfrom (?:the )?(?:first|second|a\b|b\b|other|person|dancer)"
    r"|\b(?:approach\w*|comes?|walks? over)\b[^.;]*\b(?:because|as|when|after)\b"
    r"|\b(?:mirrored|copied|imitated|mimicked|followed) by\b"
    r"|\b(?:copies|copy|mirrors?|imitates?|mimics?|follows?)\b",
    re.IGNORECASE,
)


@cache
def _manners() -> dict[str, dict[str, float]]:
    """Return what each word changes, from ``data/manner.toml``."""
    text = resources.files("generator.text").joinpath("data/manner.toml").read_text("utf-8")
    return {
        word: {key: float(value) for key, value in entry.items() if key != "words"}
        for entry in tomllib.loads(text)["manner"]
        for word in entry["words"]
    }


def manner_of(text: str) -> Style:
    """Return the style that a sentence asks for; the ordinary one if it says nothing."""
    values = {"speed": 1.0, "energy": 1.0, "amplitude": 1.0, "distance": 1.0, "lag": 0.0}
    for word in re.findall(r"[a-z]+", text.lower()):
        for name, change in _manners().get(word, {}).items():
            values[name] = values[name] + change if name == "lag" else values[name] * change
    for name, (low, high) in style_ranges().items():
        values[name] = min(max(values[name], low), high)
    left = re.search(r"\bleft[- ]?(?:hand(?:s|ed|edly)?|arms?|fists?|palms?)\b", text.lower())
    return Style(**values, handedness="left" if left else "right", swap=second_leads(text))


def second_leads(text: str) -> bool:
    """Return whether person b does what the leading role does.

    Only a sentence that names the two tells: *the second person pushes the first*, *B pushes A*,
    *the first is pushed by the second*, *the first takes the box from the second*. In the
    last two, and where one copies the other, the one named first is not the one who leads.
    """
    named = mentions(text)
    if not named:
        return False
    turned = bool(_BY.search(text)) != bool(_RECEIVES.search(text))
    return (named[0].person == "b") != turned
