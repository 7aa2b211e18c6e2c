"""Condition vectors of sentences, computed once each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from generator.text.encoder import (
    MiniLmEncoder,
    SentenceEncoder,
    TokenEncoder,
    packaged_encoder,
)
from generator.training.sentences import Row, SentenceStore
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

    def __init__(self, encoder: SentenceEncoder, cache: str | Path | None = None) -> None:
        """Start empty, or with what earlier runs left.

        Args:
            encoder: Of the sentences.
            cache: Folder in which vectors of the encoders that ship are kept; none by default.
        """
        self._encoder = encoder
        self._store = None
        if cache is not None and isinstance(encoder, MiniLmEncoder | TokenEncoder):
            self._store = SentenceStore(Path(cache) / f"sentences-{encoder.fingerprint}.sqlite")
        self._known: dict[str, Row] = {}
        self._bytes = self._width = 0

    def vectors(self, sentences: Sequence[str]) -> NDArray[np.float32]:
        """Return ``[N, C]``."""
        fresh: dict[str, Row] = {}
        found = [self._row(sentence, fresh) for sentence in sentences]
        if self._store is not None:
            self._store.put(fresh, self._width)
        rows = np.zeros((len(found), self._width), np.float32)
        for row, kept in zip(rows, found, strict=True):
            row[: len(kept)] = kept
        return rows

    def _row(self, sentence: str, fresh: dict[str, Row]) -> Row:
        """Return a vector without the zeros at its end, in 16 bits where these hold it."""
        row = self._known.get(sentence)
        if row is None and self._store is not None and (stored := self._store.get(sentence)):
            row, self._width = stored
            self._remember(sentence, row)
        if row is None:
            whole = np.asarray(self._encoder.encode([sentence])[0], np.float32)
            self._width = len(whole)
            row = np.trim_zeros(whole, "b")
            half = row.astype(np.float16)
            row = half if np.array_equal(half, row) else row.copy()
            self._remember(sentence, row)
            fresh[sentence] = row
        return row

    def _remember(self, sentence: str, row: Row) -> None:
        if self._bytes > MOST:
            self._known.clear()
            self._bytes = 0
        self._known[sentence] = row
        self._bytes += row.nbytes


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
