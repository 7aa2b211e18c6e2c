"""A model that runs without torch: a folder of JSON and an ONNX network, checked when read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from generator.architecture import DenoiserConfig
from generator.diffusion import SamplerConfig
from generator.model_folder import HEADER, checked_file, from_json, read_header, require_format
from generator.provenance import Provenance
from generator.runtime.network import Network
from robots.errors import CheckpointError, SpecError

FORMAT = "pasdedeux-intergen"
VERSION = 1
"""The same folder, with its ``weights``, is also a model for torch."""
NETWORK = "network"
REPERTOIRE = "repertoire"

Precision = Literal["float32", "float16", "int8"]
PRECISIONS: tuple[Precision, ...] = ("float32", "float16", "int8")
"""``float16`` is how the numbers are stored: they are multiplied in single precision. In ``int8``
they are multiplied as 8-bit numbers too, with one scale per column of the weights."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """How motions of a model are best drawn, and how long they may be.

    Raises:
        SpecError: A number is out of range.
    """

    frames: int
    """Longest motion that the model has learnt, in frames."""
    solver: Literal["ddim", "dpm2m"] = "dpm2m"
    """DDIM, or the second-order DPM-Solver++(2M)."""
    steps: int = 10
    """Network evaluations, without those of guidance."""
    spacing: Literal["leading", "trailing"] = "trailing"
    """Which steps are visited."""
    guidance: float = 2.0
    """Weight of the text."""
    guidance_interval: tuple[int, int] = (0, 999)
    """First and last step that are guided."""

    def __post_init__(self) -> None:
        """Validate."""
        if not isinstance(self.frames, int) or self.frames < 2:
            raise SpecError(f"{self.frames} frames", where="sampling", allowed="2 or more")
        self.sampler()

    def sampler(self, steps: int | None = None, guidance: float | None = None) -> SamplerConfig:
        """Return the sampler, with other steps or another weight of the text if given."""
        low, high = self.guidance_interval  # a list, where it comes from JSON
        return SamplerConfig(
            self.solver,
            self.steps if steps is None else steps,
            self.spacing,
            guidance=self.guidance if guidance is None else guidance,
            guidance_interval=(low, high),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Portable:
    """A model in memory, ready to be drawn from.

    Raises:
        CheckpointError: The statistics do not fit the architecture.
    """

    config: DenoiserConfig
    """Architecture."""
    network: Network
    """The denoiser."""
    mean: NDArray[np.float32]
    """``[F]`` mean of each feature of one person."""
    std: NDArray[np.float32]
    """``[F]`` deviation, all positive."""
    provenance: Provenance
    """Origin, licence and frame rate."""
    sampling: Sampling
    """How motions are best drawn."""
    text_encoder: str = "minilm"
    """Kind of the sentence encoder."""
    repertoire: bool = False
    """Whether it has seen the choreographer's repertoire and nothing else."""

    def __post_init__(self) -> None:
        """Validate."""
        for name in ("mean", "std"):
            array = getattr(self, name)
            if array.shape != (self.config.features,) or not np.isfinite(array).all():
                raise CheckpointError(f"'{name}' is not {self.config.features} finite numbers")
        if not (self.std > 0).all():
            raise CheckpointError("a standard deviation is not positive")

    @classmethod
    def load(cls, folder: str | Path, *, threads: int = 1) -> Portable:
        """Return the model of a folder.

        Raises:
            CheckpointError: A file is missing, damaged, or not the one that the header was written
                for; or the folder is a model for torch only.
        """
        folder = Path(folder)
        where = str(folder)
        header = read_header(folder)
        require_format(header, FORMAT, VERSION, where)
        if NETWORK not in header:
            raise CheckpointError(
                "this model has no network that runs without torch",
                where=where,
                hint="make one with pasdedeux pack, or use --generator intergen",
            )
        path = checked_file(folder, header, NETWORK)
        sampling = from_json(Sampling, header.get("sampling"), where)
        mean, std = _statistics(header, str(folder / HEADER))
        try:
            return cls(
                from_json(DenoiserConfig, header.get("architecture"), where),
                Network(path, threads=threads),
                mean,
                std,
                from_json(Provenance, header.get("provenance"), where),
                sampling,
                str(header.get("text_encoder", "")),
                header.get(REPERTOIRE) is True,
            )
        except CheckpointError as error:
            raise CheckpointError(
                error.what, where=error.where or where, allowed=error.allowed, hint=error.hint
            ) from error

    def normalise(self, features: NDArray) -> NDArray[np.float32]:
        """Return normalised features ``[..., 2F]`` of raw ones ``[..., 2, F]``."""
        people = (np.asarray(features, float) - self.mean) / self.std
        return people.reshape(*people.shape[:-2], -1).astype(np.float32)

    def denormalise(self, normalised: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return raw features ``[..., 2, F]`` of normalised ones ``[..., 2F]``."""
        people = normalised.astype(np.float64).reshape(*normalised.shape[:-1], 2, -1)
        return people * self.std + self.mean


def _statistics(header: Mapping[str, Any], where: str) -> list[NDArray[np.float32]]:
    try:
        return [np.asarray(header["statistics"][name], np.float32) for name in ("mean", "std")]
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError("the header has no statistics", where=where) from error
