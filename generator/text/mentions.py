"""Where a sentence names the two people, and which of them."""

from __future__ import annotations

import re
from typing import Literal, NamedTuple

_WHO = r"(?:person|one|man|woman|dancer|player|fighter)"
_PERSON = r"(?:person|dancer|player|human|actor|partner)"
_NAMED = re.compile(
    rf"\b(?P<a>(?:the )?first {_WHO}|the first(?! time)|{_PERSON} (?:a|one|1))\b"
    rf"|\b(?P<b>(?:the )?second {_WHO}|the second(?! time)|{_PERSON} (?:b|two|2))\b"
    rf"|\b(?P<other>the other(?: {_WHO})?)\b",
    re.IGNORECASE,
)
_LETTER = re.compile(r"\b(?:(?P<a>A)|(?P<b>B))\b")


class Mention(NamedTuple):
    """Words that name one of the two."""

    person: Literal["a", "b"]
    """Whom."""
    start: int
    """First character."""
    end: int
    """Character after the last."""


def mentions(text: str) -> list[Mention]:
    """Return where a sentence names person a and person b, in order.

    *The other* is whoever was not named last; where nobody has been named, nobody.
    """
    found: list[Mention] = []
    for match in _NAMED.finditer(text):
        person = "a" if match["a"] else "b"
        if match["other"]:
            if not found:
                continue
            person = "b" if found[-1].person == "a" else "a"
        found.append(Mention(person, match.start(), match.end()))
    letters = list(_LETTER.finditer(text))
    # Single letters are names only together: "A pushes B", but not "A man pushes a woman".
    if not found and len({match[0] for match in letters}) == 2:
        return [Mention("a" if m["a"] else "b", m.start(), m.end()) for m in letters]
    return found
