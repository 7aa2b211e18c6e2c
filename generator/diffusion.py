"""Noise schedules and samplers: DDIM and DPM-Solver++(2M), with classifier-free guidance.

The network predicts the clean motion x0, so everything is written in x0 and noise:

    x_t = sqrt(abar_t) x0 + sqrt(1 - abar_t) eps

Torch-free: the samplers are arithmetic, which torch's tensors and numpy's arrays both know, so the
same lines draw a motion in training and where torch is not installed.

Own code rather than a library's schedulers: it is forty lines, it keeps the *constrained*
prediction of the last step as the result, and docs/intergen.md compares it with ``diffusers``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from robots.errors import SpecError, nearest

if TYPE_CHECKING:
    from torch import Tensor

STEPS = 1000
"""Diffusion steps T of training."""

Array = TypeVar("Array", "Tensor", "NDArray[Any]")
"""What motions are kept in."""

Predict = Callable[[Array, int], Array]
"""Takes ``x_t [B, ...]`` and the step t, gives the predicted clean motion."""

Constrain = Callable[[Array, int], Array]
"""Takes a predicted clean motion ``[B, ...]`` and the step t, returns it with what is given put in
(person-to-person, trajectories, in-betweening: Sec. 5.4)."""

_CHOICES = {"solver": ("ddim", "dpm2m"), "spacing": ("leading", "trailing")}


def cosine_betas(steps: int = STEPS, offset: float = 0.008) -> NDArray[np.float64]:
    """Return ``beta_t [steps]`` of the cosine schedule (Nichol & Dhariwal 2021, eq. 17)."""

    def level(u: float) -> float:
        return math.cos((u + offset) / (1 + offset) * math.pi / 2) ** 2

    return np.array(
        [min(1 - level((i + 1) / steps) / level(i / steps), 0.999) for i in range(steps)]
    )


@cache
def cosine_alphas(steps: int = STEPS) -> NDArray[np.float64]:
    """Return ``abar_t [steps]``, the share of the clean motion's variance left at step t."""
    alphas = np.cumprod(1.0 - cosine_betas(steps)).astype(np.float64)
    alphas.setflags(write=False)
    return alphas


@dataclass(frozen=True, slots=True)
class SamplerConfig:
    """How a motion is drawn.

    Raises:
        SpecError: A number is out of range.
    """

    solver: Literal["ddim", "dpm2m"] = "ddim"
    """DDIM (Song et al. 2020), or the second-order DPM-Solver++(2M) (Lu et al. 2022)."""
    steps: int = 50
    """Network evaluations, without those of guidance."""
    spacing: Literal["leading", "trailing"] = "leading"
    """``leading``: from step 0 up, as the release; ``trailing``: from step 999 down, which few-step
    sampling needs because it starts where the noise is."""
    eta: float = 0.0
    """Share of fresh noise per DDIM step; 0 is deterministic."""
    guidance: float = 3.5
    """Weight of the condition; 1 is none (Sec. 5.1)."""
    guidance_interval: tuple[int, int] = (0, STEPS - 1)
    """First and last step t that are guided; others cost one evaluation instead of two."""

    def __post_init__(self) -> None:
        """Validate."""
        for name, allowed in _CHOICES.items():
            value = getattr(self, name)
            if value not in allowed:
                raise SpecError(
                    f"{name} {value!r}",
                    where="sampler",
                    allowed=" or ".join(allowed),
                    hint=nearest(str(value), allowed),
                )
        if not 1 <= self.steps <= STEPS:
            raise SpecError(f"{self.steps} sampling steps", allowed=f"1 to {STEPS}")
        if not 0 <= self.eta <= 1:
            raise SpecError(f"eta {self.eta}", allowed="0 to 1")
        if self.solver == "dpm2m" and self.eta:
            raise SpecError("DPM-Solver++ takes no fresh noise", allowed="eta 0")


def timesteps(steps: int, spacing: str) -> list[int]:
    """Return the steps t to visit, from noise to clean."""
    if spacing == "leading":
        stride = STEPS // steps
        return [i * stride for i in range(math.ceil(STEPS / stride))][:steps][::-1]
    return [round(STEPS * (1 - i / steps)) - 1 for i in range(steps)]


def sample(
    predict: Predict[Array],
    noise: Array,
    config: SamplerConfig,
    *,
    fresh: Callable[[Array], Array] | None = None,
    constrain: Constrain[Array] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Return the clean motion that a noise leads to.

    Args:
        predict: The (guided) network.
        noise: ``[B, T, F]``, standard normal.
        config: Solver, steps and spacing.
        fresh: Gives standard normal numbers of the shape of what it is given; needed for eta above
            0.
        constrain: Applied to every prediction, so that what it puts in is exact in the result.
        progress: Called with the share done.
    """
    visited = timesteps(config.steps, config.spacing)
    alphas = cosine_alphas()
    x, clean, previous = noise, noise, None
    for index, step in enumerate(visited):
        clean = predict(x, step)
        if constrain is not None:
            clean = constrain(clean, step)
        if progress:
            progress((index + 1) / len(visited))
        if index + 1 == len(visited):
            break
        now, then = float(alphas[step]), float(alphas[visited[index + 1]])
        if config.solver == "ddim":
            x = _ddim(x, clean, now, then, config.eta, fresh)
        else:
            before = float(alphas[visited[index - 1]]) if index else None
            x = _dpm2m(x, clean, previous, now, then, before)
            previous = clean
    return clean


def _ddim(
    x: Array,
    clean: Array,
    now: float,
    then: float,
    eta: float,
    fresh: Callable[[Array], Array] | None,
) -> Array:
    """One step of DDIM (Song et al. 2020, eq. 12) from level ``now`` to the cleaner ``then``.

    The release keeps ``then`` in single precision. Close to the clean end, where 1 - then is 4e-5,
    that is a thousandth of the noise that is put back, so it is done here too.
    """
    then = float(np.float32(then))
    noise = (x - math.sqrt(now) * clean) / math.sqrt(1 - now)
    share = eta * math.sqrt((1 - then) / (1 - now) * (1 - now / then))
    x = math.sqrt(then) * clean + math.sqrt(max(1 - then - share * share, 0.0)) * noise
    if share:
        if fresh is None:
            raise ValueError("eta above 0 needs fresh noise")
        x = x + share * fresh(x)
    return x


def _dpm2m(
    x: Array, clean: Array, previous: Array | None, now: float, then: float, before: float | None
) -> Array:
    """One step of DPM-Solver++(2M) (Lu et al. 2022, algorithm 2), in half log signal-to-noise."""

    def half_snr(alpha: float) -> float:
        return 0.5 * math.log(alpha / (1 - alpha))

    h = half_snr(then) - half_snr(now)
    target = clean
    if previous is not None and before is not None:
        r = (half_snr(now) - half_snr(before)) / h
        target = clean + (clean - previous) / (2 * r)
    return math.sqrt((1 - then) / (1 - now)) * x - math.sqrt(then) * math.expm1(-h) * target
