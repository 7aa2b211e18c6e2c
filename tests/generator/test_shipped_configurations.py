"""Every configuration that comes with the project can be trained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from generator import checkpoint
from generator.training.config import RunConfig, load_config, parse
from generator.training.draws import draw
from generator.training.train import train

CONFIGS = Path(__file__).parents[2] / "configs"
TINY = {"width": 16, "layers": 1, "heads": 2, "feedforward": 16, "dropout": 0.1}
NAMES = sorted(str(path.relative_to(CONFIGS)) for path in CONFIGS.rglob("*.toml"))


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def shrunk(name: str, folder: Path, steps: int) -> RunConfig:
    """A shipped configuration at a size that a test can afford, on the three duets."""
    run = load_config(CONFIGS / name)
    tables = run.tables()
    tables["model"] |= TINY
    tables["text"] = {}
    tables["data"] |= {
        "cache": str(folder / "cache"),
        "frames": 16,
        "fps": 30.0,
        "source": [{"kind": "duets", "root": str(folder / "duets")}],
    }
    training = {"batch": 2, "steps": steps, "cycles": 1, "warmup_steps": 1, "initial": ""}
    tables["training"] |= training
    del tables["training"]["warmup_epochs"]
    tables["log"] = {"tensorboard": False}
    return parse(tables)


@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_configuration_takes_steps(name: str, folder: Path, tmp_path: Path) -> None:
    run = shrunk(name, folder, steps=2)
    outcome = train(run, tmp_path)
    assert outcome.finished
    losses = outcome.losses
    assert np.isfinite(losses["total"])
    objective = run.objective
    t = draw(run.training, 0, [1] * 2 * run.training.batch, 1, 2).t
    regular = objective.regularisation * bool((t <= objective.last_regularised_step).any())
    for term in ("distance_map", "relative_orientation", "bone_length"):
        assert (losses[term] > 0) == (regular * getattr(objective, term) > 0), term


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_configuration_takes_twenty_steps(
    name: str, folder: Path, tmp_path: Path
) -> None:
    outcome = train(shrunk(name, folder, steps=20), tmp_path)
    assert outcome.steps == 20
    assert np.isfinite(outcome.losses["total"])
    assert checkpoint.load(tmp_path).config.representation in ("canonical", "non_canonical")
