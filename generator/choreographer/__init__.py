"""The choreographer: kinematic two-person motions, composed from phases for two roles.

Torch-free. ``choreograph("handshake", seed=1)`` returns a :class:`~generator.motion.DuetMotion`.
"""

from generator.choreographer import (
    comforts,
    dances,
    encounters,
    greetings,
    helping,
    martial,
    occasions,
    parties,
    play,
    signs,
    talks,
)
from generator.choreographer.checks import Examination, examine
from generator.choreographer.compose import LICENCE, SOURCE, choreograph, touching
from generator.choreographer.exchange import GESTURES, STAND, exchange
from generator.choreographer.from_text import generate
from generator.choreographer.interaction import Interaction, lookup, repertoire
from generator.choreographer.sampling import Tally, random_bodies, random_style, sample
from generator.choreographer.style import Style, style_ranges

FAMILIES = (
    greetings,
    signs,
    talks,
    comforts,
    helping,
    play,
    encounters,
    martial,
    dances,
    parties,
    occasions,
)
"""Modules whose import fills the repertoire."""

__all__ = [
    "FAMILIES",
    "GESTURES",
    "LICENCE",
    "SOURCE",
    "STAND",
    "Examination",
    "Interaction",
    "Style",
    "Tally",
    "choreograph",
    "examine",
    "exchange",
    "generate",
    "lookup",
    "random_bodies",
    "random_style",
    "repertoire",
    "sample",
    "style_ranges",
    "touching",
]
