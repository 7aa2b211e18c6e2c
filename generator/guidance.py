"""Classifier-free guidance, with everything that does not depend on the motion made ahead."""

from __future__ import annotations

import torch
from torch import Tensor

from generator.denoiser import Denoiser
from generator.diffusion import SamplerConfig, timesteps

CACHE_BYTES = 256 * 2**20
"""Largest table of modulations that is kept; a larger batch makes them step by step."""


class Guided:
    """A denoiser that knows its texts: predicts ``[B, T, F]`` from ``x_t`` and the step t.

    Guidance (Ho & Salimans 2021) acts on x0: both branches go through the network as one batch;
    outside the interval, and at weight 1, only the one with the text does. What time and text do to
    the layer norms is the same for every motion, so it is computed once for all steps.
    """

    def __init__(self, denoiser: Denoiser, cond: Tensor, config: SamplerConfig) -> None:
        """Prepare.

        Args:
            denoiser: The network.
            cond: ``[B, C]``, one text vector per motion.
            config: Steps, spacing, guidance and its interval.
        """
        self._denoiser, self._config = denoiser, config
        self._both = denoiser.read(torch.cat([cond, torch.zeros_like(cond)]))
        self._steps = timesteps(config.steps, config.spacing)
        architecture = denoiser.config
        numbers = self._both.shape[:2].numel() * architecture.layers * 8 * architecture.width
        size = numbers * len(self._steps) * denoiser.positions.element_size()
        self._table = self._modulations(self._steps) if size <= CACHE_BYTES else None

    def _modulations(self, steps: list[int]) -> Tensor:
        """Return ``[P, layers, steps, 2 B, ...]``."""
        rows = self._both.shape[1]
        t = torch.tensor(steps, device=self._both.device).repeat_interleave(rows)
        table = self._denoiser.modulations(t, self._both.repeat(1, len(steps), 1))
        return table.unflatten(2, (len(steps), rows))

    def is_guided(self, step: int) -> bool:
        """Whether the step takes both branches."""
        low, high = self._config.guidance_interval
        return self._config.guidance != 1 and low <= step <= high

    def __call__(self, x: Tensor, step: int) -> Tensor:
        """Return the predicted clean motion ``[B, T, F]``, in the type of ``x``."""
        if self._table is not None:
            modulations = self._table[:, :, self._steps.index(step)]
        else:
            modulations = self._modulations([step])[:, :, 0]
        noisy = x.to(modulations.dtype)
        if not self.is_guided(step):
            return self._denoiser.denoise(noisy, modulations[:, :, : len(x)]).to(x.dtype)
        predicted = self._denoiser.denoise(noisy.repeat(2, 1, 1), modulations).to(x.dtype)
        with_text, without = predicted.chunk(2)
        return torch.lerp(without, with_text, self._config.guidance)
