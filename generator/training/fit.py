"""Fitting a small network in one process, with a state that a crash cannot break.

For what is trained beside the generator: the contrastive evaluator, classifiers. What a step draws
must depend on its number alone; then a run that went on from its state ends with the same weights
as one that was never stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from generator.model_folder import HEADER, require_format
from generator.schedule import warmup_cosine
from generator.training.draws import seed_dropout
from generator.training.learner import TrainingDiverged
from generator.weights import load_weights, require, save_weights
from robots.errors import CheckpointError, SpecError

FORMAT, VERSION = "pasdedeux-fit", 1
REPORT = 50
"""Steps between two reports."""
_WEIGHTS, _MOMENTS = "weights.", "moments."


@dataclass(frozen=True, slots=True)
class Fit:
    """How a network is fitted, by AdamW.

    Raises:
        SpecError: A number is out of range.
    """

    steps: int = 1000
    """Length of the run."""
    learning_rate: float = 5e-4
    """Highest learning rate; a tenth of the run warms up, then half a cosine."""
    weight_decay: float = 1e-3
    """Of AdamW."""
    clip: float = 1.0
    """Largest norm of the gradient."""
    seed: int = 0
    """Of drop-out; initial weights are the caller's."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.steps < 1 or not self.learning_rate > 0:
            raise SpecError(f"{self.steps} steps at {self.learning_rate}", where="fit")


def fit(
    model: nn.Module,
    loss_of: Callable[[int], Tensor],
    config: Fit,
    *,
    state: Path | None = None,
    identity: str = "",
    report: Callable[[int, float], None] | None = None,
) -> None:
    """Minimise a loss over the weights of a model, in place.

    Args:
        model: Freshly initialised, whatever the state.
        loss_of: The loss of a step, by its number from 0.
        config: How.
        state: Folder of what to go on from; written before every report. An exception that the
            report raises therefore costs nothing.
        identity: What is fitted to what; a state of another identity is refused.
        report: Told the step and the loss, every :data:`REPORT` steps and at the end.

    Raises:
        TrainingDiverged: The gradient is no longer finite.
        CheckpointError: The state is damaged or of another run.
    """
    optimiser = torch.optim.AdamW(
        model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )
    start = 0
    if state is not None and (state / HEADER).is_file():
        start = _restored(model, optimiser, state, identity)
    model.train()
    for step in range(start, config.steps):
        rate = warmup_cosine(step, config.steps / 10, config.steps) * config.learning_rate
        for group in optimiser.param_groups:
            group["lr"] = rate
        seed_dropout(config.seed, step, 0)
        loss = loss_of(step)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(list(model.parameters()), config.clip)
        if not bool(torch.isfinite(norm)):
            raise TrainingDiverged(f"the gradient is not finite at step {step}")
        optimiser.step()
        if (step + 1) % REPORT == 0 or step + 1 == config.steps:
            if state is not None:
                _save(model, optimiser, state, identity, step + 1)
            if report is not None:
                report(step + 1, float(loss.detach()))
                model.train()


def _save(
    model: nn.Module, optimiser: torch.optim.Optimizer, state: Path, identity: str, step: int
) -> None:
    tensors = {_WEIGHTS + name: value for name, value in model.state_dict().items()}
    for name, parameter in _learnt(model).items():
        for key, value in optimiser.state[parameter].items():
            tensors[f"{_MOMENTS}{key}.{name}"] = torch.as_tensor(value)
    header = {"format": FORMAT, "version": VERSION, "identity": identity, "step": step}
    save_weights(state, header, tensors)


def _restored(
    model: nn.Module, optimiser: torch.optim.Optimizer, state: Path, identity: str
) -> int:
    """Take over a state and return the number of the next step."""
    header, tensors = load_weights(state)
    where = str(state)
    require_format(header, FORMAT, VERSION, where)
    if header.get("identity") != identity:
        raise CheckpointError(
            "this is the state of another run", where=where, hint="delete it, or fit elsewhere"
        )
    step = header.get("step")
    if not isinstance(step, int) or step < 1:
        raise CheckpointError(f"step {step!r}", where=where)
    shapes = {_WEIGHTS + name: tuple(v.shape) for name, v in model.state_dict().items()}
    learnt = _learnt(model)
    for name, parameter in learnt.items():
        shapes |= {
            f"{_MOMENTS}{key}.{name}": tuple(parameter.shape) if key != "step" else ()
            for key in ("step", "exp_avg", "exp_avg_sq")
        }
    require(shapes, tensors, where=where)
    weights = {name: tensors[_WEIGHTS + name] for name in model.state_dict()}
    model.load_state_dict(weights)
    for name, parameter in learnt.items():
        optimiser.state[parameter] = {
            key: tensors[f"{_MOMENTS}{key}.{name}"] for key in ("step", "exp_avg", "exp_avg_sq")
        }
    return step


def _learnt(model: nn.Module) -> dict[str, nn.Parameter]:
    return {name: p for name, p in model.named_parameters() if p.requires_grad}
