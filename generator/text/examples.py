"""Example sentences of the repertoire, with their vectors of meaning.

After a change of ``data/repertoire.toml``: ``python -m generator.text.prepare``.
"""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from generator.choreographer.exchange import GESTURES
from generator.choreographer.style import Style
from generator.text.encoder import FloatVectors, SentenceEncoder
from generator.text.gestures import no_gestures, spoken
from generator.text.grammar import describe, entry_of
from robots.errors import MotionFileError
from robots.files import read_archive, write_archive

OUTSIDE = "outside"
"""Label of sentences that ask for nothing in the repertoire."""
CLAUSES = 8
"""Wordings of the grammar that stand among the examples of each interaction."""
VECTORS_FILE = "data/repertoire.npz"
"""Vectors of the example sentences under the encoder that ships; saves a second or two per run."""


@dataclass(frozen=True, slots=True)
class Examples:
    """Labelled sentences."""

    sentences: tuple[str, ...]
    """The sentences."""
    labels: tuple[str, ...]
    """Interaction of each, or :data:`OUTSIDE`."""

    @property
    def digest(self) -> str:
        """SHA-256 of the content, in hex."""
        text = "\n".join(f"{n}\t{s}" for n, s in zip(self.labels, self.sentences, strict=True))
        return hashlib.sha256(text.encode()).hexdigest()


@cache
def examples() -> Examples:
    """Return the examples of ``data/repertoire.toml``, and a few of the grammar's clauses."""
    text = resources.files("generator.text").joinpath("data/repertoire.toml").read_text("utf-8")
    data = tomllib.loads(text)
    pairs = [(name, s) for name, group in data["interactions"].items() for s in group]
    pairs += [(OUTSIDE, s) for s in data["outside"]["sentences"]]
    known = {s for _, s in pairs}
    pairs += [(n, s) for n in data["interactions"] for s in _clauses(n) if s not in known]
    return Examples(tuple(s for _, s in pairs), tuple(n for n, _ in pairs))


def _clauses(interaction: str) -> list[str]:
    """Return some wordings of an interaction, in small letters and without a full stop."""
    entry = entry_of(interaction)
    rng = np.random.default_rng(list(interaction.encode()))
    chosen = rng.permutation(len(entry.clauses))[:CLAUSES]
    told = [describe(interaction, Style(), rng, clauses=(entry.clauses[i],)) for i in chosen]
    texts = [sentence.text.rstrip(".") for sentence in told]
    return [t if t[:2] in ("A ", "B ") else t[0].lower() + t[1:] for t in texts]


@cache
def gesture_examples() -> Examples:
    """Return one-person sentences: gestures, and everything else that the repertoire holds.

    They tell what one half of a sentence means ("... and the other waves back").
    """
    told = [(g, f"one person {w}") for g in GESTURES for w in spoken(g)]
    told += [(OUTSIDE, f"one person {words}") for words in no_gestures()]
    known = examples()
    told += [
        (OUTSIDE, sentence)
        for sentence, label in zip(known.sentences, known.labels, strict=True)
        if label not in GESTURES
    ]
    return Examples(tuple(s for _, s in told), tuple(n for n, _ in told))


def encode_examples(encoder: SentenceEncoder, of: Examples | None = None) -> FloatVectors:
    """Return the vectors ``[N, D]`` of examples in the precision in which they ship.

    Args:
        encoder: The encoder.
        of: Which examples; :func:`examples` by default.
    """
    sentences = (of or examples()).sentences
    return encoder.encode(sentences).astype(np.float16).astype(np.float32)


def shipped_vectors(of: Examples | None = None) -> FloatVectors | None:
    """Return the vectors that ship, or ``None`` if they are not of today's sentences."""
    digest = (of or examples()).digest
    with resources.as_file(resources.files("generator.text").joinpath(VECTORS_FILE)) as path:
        try:
            header, arrays = read_archive(path)
        except MotionFileError:
            return None
    for name in arrays:
        if header is not None and header.get(name) == digest:
            return arrays[name].astype(np.float32)
    return None


def write_vectors(encoder: SentenceEncoder, path: str | Path) -> None:
    """Write the vectors of all examples to a file; for use after the sentences changed."""
    kinds = {"repertoire": examples(), "gestures": gesture_examples()}
    vectors = {name: encode_examples(encoder, of).astype(np.float16) for name, of in kinds.items()}
    write_archive(path, {name: of.digest for name, of in kinds.items()}, vectors)
