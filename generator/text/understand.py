"""From a sentence to an interaction of the repertoire, or to the knowledge that there is none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from generator.choreographer.exchange import GESTURES, JOINT
from generator.choreographer.style import Style
from generator.text.classifier import OUTSIDE_WEIGHT, LinearClassifier
from generator.text.encoder import SentenceEncoder, default_encoder
from generator.text.examples import (
    OUTSIDE,
    Examples,
    encode_examples,
    examples,
    gesture_examples,
    shipped_vectors,
)
from generator.text.halves import Exchange, Gesture, exchange_of
from generator.text.manner import manner_of
from robots.errors import PromptError

LONGEST = 1000
"""Longest sentence that is read, characters."""
OUTSIDE_OF_GESTURES = 2.0
"""Weight of what is no gesture relative to one gesture: its examples are many already."""


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
    exchange: Exchange | None = None
    """What each does, if the sentence says it of each alone."""

    @property
    def deed(self) -> str:
        """Name of what is done: the interaction, or the two gestures."""
        return self.interaction if self.exchange is None else JOINT.join(self.exchange.gestures)

    @property
    def certainty(self) -> float:
        """Probability of what is done, 0..1."""
        return self.confidence if self.exchange is None else self.exchange.confidence

    @property
    def known(self) -> bool:
        """Whether the choreographer can do what the sentence asks for."""
        return self.exchange is not None or self.confidence > self.outside


class Interpreter:
    """Understands sentences by their likeness in meaning to the example sentences."""

    def __init__(self, encoder: SentenceEncoder | None = None) -> None:
        """Learn the examples.

        Args:
            encoder: Sentence encoder; the one that ships by default.

        Raises:
            CheckpointError: The encoder that ships is missing or damaged.
        """
        self._encoder = default_encoder() if encoder is None else encoder
        self._ships = encoder is None
        self._classifier = self._learnt(examples(), OUTSIDE_WEIGHT)
        self._gestures: LinearClassifier | None = None

    def _learnt(self, known: Examples, outside: float) -> LinearClassifier:
        vectors = shipped_vectors(known) if self._ships else None
        if vectors is None:
            vectors = encode_examples(self._encoder, known)
        return LinearClassifier(vectors, known.labels, outside=outside)

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
        # A whole that is clear is no exchange: "one holds up a palm and the other claps it".
        whole = confidence > 0.5 and name not in GESTURES
        found = None if whole else exchange_of(sentence, self._gesture)
        return Understanding(text, name, confidence, outside, ranking, manner_of(sentence), found)

    def _gesture(self, sentence: str) -> Gesture | None:
        """Return what a sentence says that one person does, if it is a gesture."""
        if self._gestures is None:
            self._gestures = self._learnt(gesture_examples(), OUTSIDE_OF_GESTURES)
        odds = self._gestures.probabilities(self._encoder.encode([sentence]))[0]
        name = self._gestures.names[int(odds.argmax())]
        return None if name == OUTSIDE else Gesture(name, float(odds.max()))


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
