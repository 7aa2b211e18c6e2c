"""Understanding sentences: by embedding what is done, by grammar how and by whom. Torch-free."""

from generator.text.encoder import MiniLmEncoder, SentenceEncoder, default_encoder
from generator.text.understand import Interpreter, Understanding, choose, understand

__all__ = [
    "Interpreter",
    "MiniLmEncoder",
    "SentenceEncoder",
    "Understanding",
    "choose",
    "default_encoder",
    "understand",
]
