"""The denoiser as an ONNX network, and classifier-free guidance around it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from generator.diffusion import SamplerConfig
from robots.errors import CheckpointError

Floats = NDArray[np.float32]

INPUTS = ("x", "t", "cond")
OUTPUT = "clean"
INSTALL = "pip install onnxruntime"


class Network:
    """Predicts the clean motion of two people from a noisy one, on onnxruntime."""

    def __init__(self, path: str | Path, *, threads: int = 1) -> None:
        """Load the network.

        Args:
            path: The ONNX file.
            threads: Most threads of one product of matrices.

        Raises:
            CheckpointError: The file is missing, damaged or another network, or onnxruntime is not
                installed.
        """
        try:
            import onnxruntime
        except ImportError as error:
            raise CheckpointError(
                f"the network needs the package '{error.name}'", hint=INSTALL
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
        options.log_severity_level = 3
        # Threads that wait by turning round and round take the time of whoever else wants to run.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session: Any = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime raises its own kinds, none of them public
            raise CheckpointError(f"cannot be read: {error}", where=str(path)) from error
        names = tuple(node.name for node in self._session.get_inputs())
        if set(names) != set(INPUTS) or self._session.get_outputs()[0].name != OUTPUT:
            raise CheckpointError(
                f"the network takes {', '.join(names)}", where=str(path), allowed=", ".join(INPUTS)
            )

    def __call__(self, x: Floats, t: NDArray[np.int64], cond: Floats) -> Floats:
        """Return the predicted clean motion ``[B, T, 2F]``, normalised.

        Args:
            x: ``[B, T, 2F]`` noisy motion, normalised: person a's F features, then b's.
            t: ``[B]`` diffusion step, 0 (clean) to 999.
            cond: ``[B, C]`` text vectors; zeros for the unconditional branch.
        """
        feed = dict(zip(INPUTS, (x, t, cond), strict=True))
        return self._session.run([OUTPUT], feed)[0]


class Accent(NamedTuple):
    """What a change of the sentence adds to a motion."""

    cond: Floats
    """``[B, C]``, the vectors of the changed sentences."""
    weight: float | Floats
    """How much of the difference that it makes is added; 1: as if it stood in the sentence. As
    ``[2F]``: of each feature."""


def halves(features: int) -> tuple[Floats, Floats]:
    """Return two masks ``[features]``: 1 for what is of person a, and of person b, else 0."""
    second = (np.arange(features) >= features // 2).astype(np.float32)
    return 1 - second, second


class GuidedNetwork:
    """A network that knows its texts: predicts ``[B, T, 2F]`` from ``x_t`` and the step t.

    The same as :class:`generator.guidance.Guided`: guidance acts on x0, all branches go through
    the network as one batch, and outside the interval, and at weight 1, only the one with the text
    does. Accents are further branches: what is returned is

        none + g (text - none) + g sum_i w_i (accent_i - text),

    the composition of conditions of Liu et al. 2022 (Compositional Visual Generation with
    Composable Diffusion Models). If the other person is asked for something else, *text* is a
    prediction of which one half was made with the one text, and one with the other.
    """

    def __init__(
        self,
        network: Network,
        cond: Floats,
        config: SamplerConfig,
        accents: Sequence[Accent] = (),
        other: Floats | None = None,
    ) -> None:
        """Prepare.

        Args:
            network: The network.
            cond: ``[B, C]``, one text vector per motion.
            config: Guidance and its interval.
            accents: What is emphasised.
            other: ``[B, C]``, what person b is asked for, if it is something else.
        """
        self._network, self._config = network, config
        self._cond, self._other, self._accents = cond, other, tuple(accents)

    def __call__(self, x: Floats, step: int) -> Floats:
        """Return the predicted clean motion ``[B, T, 2F]``."""
        low, high = self._config.guidance_interval
        branches = self._asked(x.shape[-1])
        if low <= step <= high:
            guidance, taken = self._config.guidance, sum(a.weight for a in self._accents)
            branches = [(cond, guidance * (1 - taken) * weight) for cond, weight in branches]
            branches += [(a.cond, guidance * a.weight) for a in self._accents]
            branches += [(np.zeros_like(self._cond), 1 - guidance)]
        branches = [branch for branch in branches if np.any(branch[1])]
        count = len(branches)
        stacked = np.concatenate([cond for cond, _ in branches])
        predicted = self._network(
            np.concatenate([x] * count), np.full(count * len(x), step), stacked
        )
        parts = np.split(predicted, count)
        guided = sum(weight * part for (_, weight), part in zip(branches, parts, strict=True))
        return np.asarray(guided, np.float32)

    def _asked(self, features: int) -> list[tuple[Floats, float | Floats]]:
        """Return the texts, each with how much of its prediction is taken."""
        if self._other is None:
            return [(self._cond, 1.0)]
        first, second = halves(features)
        return [(self._cond, first), (self._other, second)]
