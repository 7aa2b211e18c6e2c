"""What is drawn at random for a training step."""

from __future__ import annotations

import pytest
import torch

from generator.training.config import TrainingConfig
from generator.training.draws import draw


def test_what_is_drawn_does_not_depend_on_how_a_batch_is_divided() -> None:
    config = TrainingConfig(seed=3, freeze="mixed")
    whole = draw(config, 40, [9, 5, 12, 7], 12, 524)
    parts = [draw(config, 40, [9, 5], 9, 524), draw(config, 42, [12, 7], 12, 524)]
    assert torch.equal(whole.noise[:2, :9], parts[0].noise)
    assert torch.equal(whole.noise[2:], parts[1].noise)
    assert torch.equal(whole.t, torch.cat([part.t for part in parts]))
    assert torch.equal(whole.keep_text, torch.cat([part.keep_text for part in parts]))
    assert whole.frozen is not None
    assert parts[1].frozen is not None
    assert torch.equal(whole.frozen[2:], parts[1].frozen)


def test_draws_are_standard_noise_uniform_steps_and_a_tenth_without_text() -> None:
    config = TrainingConfig(unconditional=0.1)
    draws = draw(config, 0, [1] * 4000, 1, 8)
    assert abs(float(draws.noise.mean())) < 0.02
    assert float(draws.noise.std()) == pytest.approx(1, abs=0.02)
    assert (int(draws.t.min()), int(draws.t.max())) == (0, 999)
    assert float(draws.t.float().mean()) == pytest.approx(499.5, abs=15)
    assert float(draws.keep_text.mean()) == pytest.approx(0.9, abs=0.02)
    assert draws.frozen is None
