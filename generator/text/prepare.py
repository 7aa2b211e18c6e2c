"""Encode the example sentences anew: ``python -m generator.text.prepare``."""

from pathlib import Path

from generator.text.encoder import default_encoder
from generator.text.examples import VECTORS_FILE, write_vectors

if __name__ == "__main__":
    write_vectors(default_encoder(), Path(__file__).parent / VECTORS_FILE)
