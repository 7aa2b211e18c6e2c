"""The choreographer: kinematic two-person motions, composed from phases for two roles.

Torch-free. ``choreograph("handshake", seed=1)`` returns a :class:`~generator.motion.DuetMotion`.
"""

from generator.choreographer import dances, encounters, greetings
from generator.choreographer.compose import LICENCE, SOURCE, choreograph
from generator.choreographer.from_text import generate
from generator.choreographer.interaction import Interaction, lookup, repertoire
from generator.choreographer.style import Style, style_ranges

FAMILIES = (greetings, encounters, dances)
"""Modules whose import fills the repertoire."""

__all__ = [
    "FAMILIES",
    "LICENCE",
    "SOURCE",
    "Interaction",
    "Style",
    "choreograph",
    "generate",
    "lookup",
    "repertoire",
    "style_ranges",
]
