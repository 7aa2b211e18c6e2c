"""Condition vectors of sentences, computed once each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from generator.text.encoder import SentenceEncoder, default_encoder
from robots.errors import SpecError

if TYPE_CHECKING:
    from generator.model import InterGen
    from generator.training.config import TextConfig

MOST = 100_000
"""Sentences that are remembered; of 768 numbers each, some 300 MB."""


class TextTable:
    """Remembers the vector of every sentence.

    A sentence is encoded by itself: in a batch, its last bits would depend on its neighbours, and a
    resumed run would not be the same run.
    """

    def __init__(self, encoder: SentenceEncoder) -> None:
        """Start empty."""
        self._encoder = encoder
        self._known: dict[str, NDArray[np.float32]] = {}

    def vectors(self, sentences: Sequence[str]) -> NDArray[np.float32]:
        """Return ``[N, C]``."""
        rows = []
        for sentence in sentences:
            row = self._known.get(sentence)
            if row is None:
                row = np.asarray(self._encoder.encode([sentence])[0], np.float32)
                if len(self._known) >= MOST:
                    self._known.clear()
                self._known[sentence] = row
            rows.append(row)
        return np.stack(rows)


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
    return default_encoder()


def text_width(encoder: SentenceEncoder) -> int:
    """Return the width of an encoder's vectors."""
    return int(encoder.encode(["a"]).shape[1])
