"""Which touches a sentence speaks of.

Whoever reads *they shake hands* knows which two points of the people meet, whatever drew the
motion. The choreographer has that knowledge: the touches of what it would perform are what is
meant. When they happen is left to the motion.
"""

from __future__ import annotations

import math
import re

from generator.choreographer import touching
from generator.finishing.touches import Meeting
from generator.text import understand
from generator.text.understand import LONGEST

_SIDE = re.compile(r"\b(left|right)\b", re.IGNORECASE)


def meetings_of(text: str, start: float = 0.0, end: float = math.inf) -> tuple[Meeting, ...]:
    """Return the points that a sentence wants to meet.

    None if it is outside the repertoire, or says of each person what they do alone. Unless it names
    a side, the mirror image will do.

    Args:
        text: The sentence.
        start: When what it says begins, s.
        end: When it ends, s.
    """
    meaning = understand(text[:LONGEST])
    if not meaning.known or meaning.exchange is not None:
        return ()
    either = _SIDE.search(text) is None
    pairs = touching(meaning.interaction, meaning.style)
    return tuple(Meeting(a, b, start, end, either) for a, b in pairs)
