"""Condition vectors of sentences, computed once each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from generator.text.encoder import SentenceEncoder, packaged_encoder
from robots.errors import SpecError

if TYPE_CHECKING:
    from generator.model import InterGen
    from generator.training.config import TextConfig

MOST = 2 * 10**9
"""Bytes of sentences that are remembered."""


class TextTable:
    """Remembers the vector of every sentence.

    A sentence is encoded by itself: in a batch, its last bits would depend on its neighbours, and a
    resumed run would not be the same run.
    """

    def __init__(self, encoder: SentenceEncoder) -> None:
        """Start empty."""
        self._encoder = encoder
        self._known: dict[str, NDArray[np.float16 | np.float32]] = {}
        self._bytes = self._width = 0

    def vectors(self, sentences: Sequence[str]) -> NDArray[np.float32]:
        """Return ``[N, C]``."""
        found = [self._row(sentence) for sentence in sentences]
        rows = np.zeros((len(found), self._width), np.float32)
        for row, kept in zip(rows, found, strict=True):
            row[: len(kept)] = kept
        return rows

    def _row(self, sentence: str) -> NDArray[np.float16 | np.float32]:
        """Return a vector without the zeros at its end, in 16 bits where these hold it."""
        row = self._known.get(sentence)
        if row is None:
            whole = np.asarray(self._encoder.encode([sentence])[0], np.float32)
            self._width = len(whole)
            row = np.trim_zeros(whole, "b")
            half = row.astype(np.float16)
            row = half if np.array_equal(half, row) else row.copy()
            if self._bytes > MOST:
                self._known.clear()
                self._bytes = 0
            self._known[sentence] = row
            self._bytes += row.nbytes
        return row


def make_encoder(config: TextConfig, initial: InterGen | None = None) -> SentenceEncoder:
    """Return the text encoder that a run asks for.

    Args:
        config: Which.
        initial: The model that training starts from.

    Raises:
        CheckpointError: Its weights are missing or damaged.
        SpecError: It is the initial model's, which has none.
    """
    if config.encoder == "clip":
        from generator.text.clip import ClipEncoder

        return ClipEncoder.from_folder(config.folder)
    if config.encoder == "causal":
        from generator.text.causal import CausalEncoder

        return CausalEncoder(config.folder)
    if config.encoder == "initial":
        if initial is None or initial.text is None:
            raise SpecError("the initial model has no text encoder", where="text.encoder")
        return initial.text
    packaged = packaged_encoder(config.encoder)
    if packaged is None:
        raise SpecError(f"'{config.encoder}'", where="text.encoder")
    return packaged


def text_width(encoder: SentenceEncoder) -> int:
    """Return the width of an encoder's vectors."""
    return int(encoder.encode(["a"]).shape[1])
