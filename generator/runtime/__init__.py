"""Text to two-person motion without torch: a network in ONNX, samplers in numpy.

A model that ``pasdedeux pack`` left is a folder; :func:`draw` takes a sentence through
it. :mod:`generator.training.portable` makes such folders, and needs torch for it.
"""

from generator.runtime.drawing import Steering, draw
from generator.runtime.generation import generate
from generator.runtime.group import generate_group
from generator.runtime.network import GuidedNetwork, Network
from generator.runtime.portable import Portable, Sampling
from generator.runtime.request import DiffusionRequest

__all__ = [
    "DiffusionRequest",
    "GuidedNetwork",
    "Network",
    "Portable",
    "Sampling",
    "Steering",
    "draw",
    "generate",
    "generate_group",
]
