"""Which interaction a sentence vector means.

**The problem.** The nearest example sentence is a poor judge: all sentences of this repertoire are
about two people doing something, so most of a vector says what they have in common. A linear map
fitted to the examples finds the directions that tell them apart. It is the regularised
least-squares map from vectors to one-hot labels (ridge regression, closed form), each label
weighted equally but *outside* six times, since that label has to cover all the rest of the world.
Its outputs divided by a temperature, through a softmax, are the probabilities; the temperature is
the one with the greatest likelihood under cross-validation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from generator.text.examples import OUTSIDE

RIDGE = 0.3
"""Regularisation of the map."""
OUTSIDE_WEIGHT = 6.0
"""Weight of the outside label relative to one interaction."""
TEMPERATURE = 0.06
"""Divisor of the map's outputs before the softmax."""


class LinearClassifier:
    """A ridge classifier over unit vectors.

    Attributes:
        names: Labels in the order of the columns of the map.
    """

    def __init__(
        self, vectors: NDArray, labels: Sequence[str], *, outside: float = OUTSIDE_WEIGHT
    ) -> None:
        """Fit the map.

        Args:
            vectors: ``[N, D]``, unit vectors.
            labels: Of each.
            outside: Weight of the outside label relative to another one.
        """
        self.names = tuple(dict.fromkeys(labels))
        column = np.array([self.names.index(label) for label in labels])
        weight = 1.0 / np.bincount(column)[column]
        weight[np.array(labels) == OUTSIDE] *= outside
        weight *= len(weight) / weight.sum()
        x = vectors.astype(float)
        y = np.eye(len(self.names))[column]
        self._centre = np.average(x, axis=0, weights=weight)
        self._bias = np.average(y, axis=0, weights=weight)
        x, y = x - self._centre, y - self._bias
        weighted = (x * weight[:, None]).T
        normal = weighted @ x + RIDGE * np.eye(x.shape[1])
        self._map = np.linalg.solve(normal, weighted @ y)

    def probabilities(self, vectors: NDArray) -> NDArray[np.float64]:
        """Return ``[N, len(names)]`` probabilities that sum to 1."""
        scores = (vectors.astype(float) - self._centre) @ self._map + self._bias
        scores = (scores - scores.max(axis=1, keepdims=True)) / TEMPERATURE
        odds = np.exp(scores)
        return odds / odds.sum(axis=1, keepdims=True)
