"""One step of learning: loss, gradient, AdamW, moving average."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import cast

import torch
from torch import Tensor, nn

from generator.data import Batch
from generator.losses import Losses, interaction_losses, release_losses
from generator.model import InterGen
from generator.schedule import warmup_cosine
from generator.training.config import RunConfig
from generator.training.draws import Draws, draw, noised, seed_dropout
from generator.training.processes import Processes
from generator.training.texts import TextTable
from robots.errors import CheckpointError, DuetError

_EMA, _OPTIMISER, _WEIGHTS = "ema.", "optimizer.", "weights."


class TrainingDiverged(DuetError):
    """The loss or the gradient is no longer a number."""

    exit_code = 1


class Learner:
    """A model that learns; :meth:`tensors` is its whole state besides the number of steps."""

    def __init__(
        self,
        run: RunConfig,
        model: InterGen,
        texts: TextTable,
        *,
        cycle: int,
        warmup: float,
        processes: Processes,
    ) -> None:
        """Prepare to learn.

        Args:
            run: Settings.
            model: What learns, on its device, with statistics.
            texts: Condition vectors.
            cycle: Steps over which the learning rate falls, and then once more.
            warmup: Steps over which it rises, in the first cycle alone.
            processes: Who else learns.
        """
        self.run, self.model, self.texts = run, model, texts
        self._cycle, self._warmup, self._processes = cycle, warmup, processes
        self._names = {name: p for name, p in model.denoiser.named_parameters() if p.requires_grad}
        training = run.training
        self.optimiser = torch.optim.AdamW(
            self._names.values(),
            lr=training.learning_rate,
            betas=training.betas,
            weight_decay=training.weight_decay,
            fused=True,  # one pass over memory instead of a dozen
        )
        self.average = {name: p.detach().clone() for name, p in self._names.items()}
        self._network = processes.shared(model.denoiser)

    def step(self, number: int, batch: Batch) -> dict[str, Tensor]:
        """Take a step; return the losses, weighted, and the gradient's ``norm``.

        Args:
            number: Of the step, from 0.
            batch: This process' share.

        Raises:
            TrainingDiverged: The gradient is not finite.
        """
        training = self.run.training
        device = self.model.mean.device
        rank = self._processes.rank
        first = number * training.batch + rank * len(batch)
        shape = batch.x_raw.shape
        draws = draw(training, first, batch.lengths.tolist(), shape[1], shape[2])
        seed_dropout(training.seed, number, rank)
        for group in self.optimiser.param_groups:
            group["lr"] = self.learning_rate(number)
        self.model.denoiser.train()
        self.optimiser.zero_grad(set_to_none=True)
        losses = self._losses(batch, draws, device)
        losses["total"].backward()
        limit = training.clip or math.inf
        norm = nn.utils.clip_grad_norm_(list(self._names.values()), limit)
        if not bool(torch.isfinite(norm)):
            raise TrainingDiverged(
                f"the gradient is not finite at step {number}",
                hint="lower training.learning_rate; the last checkpoint is whole",
            )
        self.optimiser.step()
        self._follow(number)
        return {**{name: value.detach() for name, value in losses.items()}, "norm": norm.detach()}

    def learning_rate(self, number: int) -> float:
        """Return the learning rate of a step."""
        rate = self.run.training.learning_rate
        warmup = self._warmup if number < self._cycle else 0
        return rate * warmup_cosine(number % self._cycle, warmup, self._cycle)

    def _losses(self, batch: Batch, draws: Draws, device: torch.device) -> Losses:
        training, model = self.run.training, self.model
        raw = torch.from_numpy(batch.x_raw).to(device)
        mask = torch.from_numpy(batch.mask).to(device)
        vectors = torch.from_numpy(self.texts.vectors(batch.texts))
        cond = (vectors * draws.keep_text).to(device)
        t = draws.t.to(device)
        # Padding is 0 once normalised too: it is masked out everywhere, but must stay small.
        clean = model.normalise(raw) * mask[..., None]
        x = noised(clean, t, draws.noise.to(device))
        if draws.frozen is not None:
            x = torch.where(draws.frozen.to(device), clean, x)
        with torch.autocast(device.type, torch.bfloat16, enabled=training.precision == "bfloat16"):
            predicted = self._network(x, t, cond, mask)
        predicted = predicted.float()
        if training.loss == "release":
            lengths = torch.from_numpy(batch.lengths).to(device)
            return release_losses(raw, clean, predicted, mask, lengths, t, model.mean, model.std)
        objective = self.run.objective
        return interaction_losses(predicted, clean, mask, t, model.mean, model.std, objective)

    @torch.no_grad()
    def _follow(self, number: int) -> None:
        """Let the average follow the weights; early on it follows closely."""
        decay = min(self.run.training.ema, (1 + number) / (10 + number))
        if not self.run.training.ema:
            decay = 0.0
        for name, parameter in self._names.items():
            self.average[name].lerp_(parameter, 1 - decay)

    def averaged(self) -> InterGen:
        """Return the model as it is to be used: with the averaged weights."""
        model = InterGen(
            self.model.config,
            mean=self.model.mean,
            std=self.model.std,
            text=self.model.text,
            provenance=self.model.provenance,
        )
        state = {**self.model.denoiser.state_dict(), **self.average}
        model.denoiser.load_state_dict(state)
        return model.eval()

    def tensors(self) -> dict[str, Tensor]:
        """Return weights, their average and the optimiser's moments, by name."""
        result = {_WEIGHTS + name: p.detach() for name, p in self._names.items()}
        result |= {_EMA + name: value for name, value in self.average.items()}
        for name, parameter in self._names.items():
            for key, value in self.optimiser.state.get(parameter, {}).items():
                result[f"{_OPTIMISER}{key}.{name}"] = torch.as_tensor(value)
        return result

    def restore(self, tensors: Mapping[str, Tensor], *, where: str) -> None:
        """Take over what :meth:`tensors` gave.

        Raises:
            CheckpointError: A tensor is missing, unknown, or of another shape.
        """
        known = set()
        for name, parameter in self._names.items():
            moments: dict[str, Tensor] = {}
            for prefix, target in ((_WEIGHTS, parameter), (_EMA, self.average[name])):
                key = prefix + name
                with torch.no_grad():
                    target.copy_(_fitting(tensors, key, target.shape, where))
                known.add(key)
            for key in ("step", "exp_avg", "exp_avg_sq"):
                full = f"{_OPTIMISER}{key}.{name}"
                shape = torch.Size([]) if key == "step" else parameter.shape
                value = _fitting(tensors, full, shape, where).clone()
                moments[key] = value if key == "step" else value.to(parameter.device)
                known.add(full)
            self.optimiser.state[cast(Tensor, parameter)] = moments
        unknown = sorted(set(tensors) - known)
        if unknown:
            raise CheckpointError(f"key '{unknown[0]}' does not belong to this run", where=where)


def _fitting(tensors: Mapping[str, Tensor], key: str, shape: torch.Size, where: str) -> Tensor:
    if key not in tensors:
        raise CheckpointError(f"key '{key}' is missing", where=where)
    if tensors[key].shape != shape:
        raise CheckpointError(
            f"key '{key}' has shape {tuple(tensors[key].shape)}",
            where=where,
            allowed=str(tuple(shape)),
        )
    return tensors[key]
