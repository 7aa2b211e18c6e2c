"""Text to two-person motion without torch: a network in ONNX, samplers in numpy.

A model that ``pasdedeux train --portable`` left is a folder; :func:`draw` takes a sentence through
it. :mod:`generator.training.portable` makes such folders, and needs torch for it.
"""

from generator.runtime.generation import DiffusionRequest, draw, generate
from generator.runtime.network import GuidedNetwork, Network
from generator.runtime.portable import SHIPPED, Portable, Sampling

__all__ = [
    "SHIPPED",
    "DiffusionRequest",
    "GuidedNetwork",
    "Network",
    "Portable",
    "Sampling",
    "draw",
    "generate",
]
