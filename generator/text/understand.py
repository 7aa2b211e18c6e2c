"""From a sentence to an interaction of the repertoire, or to the knowledge that there is none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from generator.choreographer.style import Style
from generator.text.classifier import LinearClassifier
from generator.text.encoder import SentenceEncoder, default_encoder
from generator.text.examples import OUTSIDE, encode_examples, examples, shipped_vectors
from generator.text.manner import manner_of
from robots.errors import PromptError

LONGEST = 1000
"""Longest sentence that is read, characters."""


@dataclass(frozen=True, slots=True)
class Understanding:
    """What a sentence was taken to mean."""

    text: str
    """The sentence."""
    interaction: str
    """The most probable interaction of the repertoire."""
    confidence: float
    """Its probability, 0..1, against all other interactions and against none of them."""
    outside: float
    """Probability that the sentence asks for something else."""
    ranking: tuple[tuple[str, float], ...]
    """All interactions with their probabilities, most probable first."""
    style: Style
    """Manner and roles: tempo, vigour, size, distance, hand, who leads."""

    @property
    def known(self) -> bool:
        """Whether the repertoire holds what the sentence asks for."""
        return self.confidence > self.outside


class Interpreter:
    """Understands sentences by their likeness in meaning to the example sentences."""

    def __init__(self, encoder: SentenceEncoder | None = None) -> None:
        """Learn the examples.

        Args:
            encoder: Sentence encoder; the one that ships by default.

        Raises:
            CheckpointError: The encoder that ships is missing or damaged.
        """
        vectors = shipped_vectors() if encoder is None else None
        self._encoder = default_encoder() if encoder is None else encoder
        if vectors is None:
            vectors = encode_examples(self._encoder)
        self._classifier = LinearClassifier(vectors, examples().labels)

    def understand(self, text: str) -> Understanding:
        """Return what a sentence means.

        Raises:
            PromptError: The sentence is empty or absurdly long.
        """
        sentence = " ".join(text.split())
        if not sentence or len(sentence) > LONGEST:
            raise PromptError(
                "the sentence is empty" if not sentence else f"{len(sentence)} characters",
                allowed=f"1 to {LONGEST} characters",
                hint="say what two people do, for example 'two people shake hands'",
            )
        row = self._classifier.probabilities(self._encoder.encode([sentence]))[0]
        odds = dict(zip(self._classifier.names, map(float, row), strict=True))
        outside = odds.pop(OUTSIDE)
        ranking = tuple(sorted(odds.items(), key=lambda item: -item[1]))
        name, confidence = ranking[0]
        return Understanding(text, name, confidence, outside, ranking, manner_of(sentence))


@cache
def default_interpreter() -> Interpreter:
    """Return the interpreter with the encoder that ships, made once."""
    return Interpreter()


def understand(text: str, *, encoder: SentenceEncoder | None = None) -> Understanding:
    """Return what a sentence means.

    Args:
        text: The sentence.
        encoder: Sentence encoder; the one that ships by default.

    Raises:
        PromptError: The sentence is empty or absurdly long.
        CheckpointError: The encoder that ships is missing or damaged.
    """
    interpreter = default_interpreter() if encoder is None else Interpreter(encoder)
    return interpreter.understand(text)


def choose(
    text: str, *, nearest: bool = False, encoder: SentenceEncoder | None = None
) -> Understanding:
    """Return what a sentence means, if the repertoire holds it.

    Args:
        text: The sentence.
        nearest: Take the nearest interaction even if the sentence asks for something else.
        encoder: Sentence encoder; the one that ships by default.

    Raises:
        PromptError: The repertoire does not hold what the sentence asks for.
        CheckpointError: The encoder that ships is missing or damaged.
    """
    meaning = understand(text, encoder=encoder)
    if not (meaning.known or nearest):
        raise PromptError(
            f"'{_shortened(text)}' is not in the repertoire; the nearest is"
            f" '{meaning.interaction}'",
            allowed=", ".join(sorted(name for name, _ in meaning.ranking)),
            hint="say it differently, or take the nearest with --nearest",
        )
    return meaning


def _shortened(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "..."
