"""Fitting a small network: what a crash costs, and what a state is checked for."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from generator.training.fit import REPORT, Fit, fit
from generator.training.learner import TrainingDiverged
from robots.errors import CheckpointError, SpecError

HOW = Fit(steps=3 * REPORT, learning_rate=1e-2)


class Stop(Exception):
    """Whatever a report may raise."""


def model() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(3, 4), nn.Dropout(0.2), nn.Linear(4, 1))


def loss_of(net: nn.Module, calls: list[int] | None = None):
    def loss(step: int) -> Tensor:
        if calls is not None:
            calls.append(step)
        x = torch.randn(8, 3, generator=torch.Generator().manual_seed(step))
        return ((net(x)[:, 0] - x.sum(dim=1)) ** 2).mean()

    return loss


def weights(net: nn.Module) -> Tensor:
    return torch.cat([p.detach().flatten() for p in net.parameters()])


def test_a_fit_that_was_stopped_ends_with_the_same_weights(tmp_path: Path):
    whole = model()
    fit(whole, loss_of(whole), HOW)

    def stop(step: int, loss: float) -> None:
        if step == 2 * REPORT:
            raise Stop

    first, calls = model(), []
    with pytest.raises(Stop):
        fit(first, loss_of(first), HOW, state=tmp_path, report=stop)
    second = model()
    fit(second, loss_of(second, calls), HOW, state=tmp_path)
    assert calls == list(range(2 * REPORT, 3 * REPORT))
    assert torch.equal(weights(second), weights(whole))
    assert not torch.equal(weights(second), weights(first))


def test_a_finished_fit_is_not_done_again(tmp_path: Path):
    first, second, calls = model(), model(), []
    fit(first, loss_of(first), HOW, state=tmp_path)
    fit(second, loss_of(second, calls), HOW, state=tmp_path)
    assert not calls
    assert torch.equal(weights(first), weights(second))


def test_the_state_of_another_run_is_refused(tmp_path: Path):
    net = model()
    fit(net, loss_of(net), HOW, state=tmp_path, identity="one")
    with pytest.raises(CheckpointError, match="another run"):
        fit(net, loss_of(net), HOW, state=tmp_path, identity="other")
    with pytest.raises(CheckpointError):
        fit(nn.Linear(3, 1), loss_of(net), HOW, state=tmp_path, identity="one")


def test_a_loss_that_is_not_finite_ends_the_run():
    net = model()
    with pytest.raises(TrainingDiverged, match="step 0"):
        fit(net, lambda _: loss_of(net)(0) * float("nan"), HOW)


def test_settings_out_of_range_are_refused():
    with pytest.raises(SpecError):
        Fit(steps=0)
    with pytest.raises(SpecError):
        Fit(learning_rate=0.0)
