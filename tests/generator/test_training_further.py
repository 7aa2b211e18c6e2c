"""Training that goes on from a model: what is taken over, what is learnt, what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from generator import checkpoint
from generator.runtime.portable import Sampling
from generator.training.card import model_card
from generator.training.train import train
from robots.errors import SpecError
from tests.generator.small_run import small


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def test_fine_tuning_starts_from_a_model_and_marks_what_it_learnt(
    folder: Path, tmp_path: Path
) -> None:
    train(small(folder), tmp_path / "first")
    tuned = small(
        folder,
        training={"initial": str(tmp_path / "first"), "freeze": "mixed", "learning_rate": 1e-9},
        text={"encoder": "initial"},
    )
    train(tuned, tmp_path / "second")
    first, second = (checkpoint.load(tmp_path / name) for name in ("first", "second"))
    assert second.provenance.training["freeze"] == "mixed"
    assert torch.equal(first.mean, second.mean)
    for a, b in zip(first.parameters(), second.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-6)
    wrong = small(folder, training={"initial": str(tmp_path / "first")}, model={"width": 32})
    with pytest.raises(SpecError, match="width 16"):
        train(wrong, tmp_path / "third")


def test_a_trained_network_learns_on_with_people_told_apart(folder: Path, tmp_path: Path) -> None:
    train(small(folder), tmp_path / "first")
    more = {"initial": str(tmp_path / "first")}
    train(small(folder, training=more, model={"told_apart": True}), tmp_path / "second")
    learnt = checkpoint.load(tmp_path / "second")
    assert learnt.config.told_apart
    assert learnt.denoiser.person.abs().max() > 0
    back = small(folder, training={"initial": str(tmp_path / "second")})
    with pytest.raises(SpecError, match="told_apart True"):
        train(back, tmp_path / "third")


def test_who_has_been_taught_to_read_is_not_taught_again(folder: Path, tmp_path: Path) -> None:
    told = {"model": {"told_apart": True}, "text": {"encoder": "minilm-names", "lessons": 2}}
    train(small(folder, **told), tmp_path / "first")
    assert (tmp_path / "first/lessons").is_dir()
    more = {"initial": str(tmp_path / "first"), "seed": 5}
    train(small(folder, **told, training=more), tmp_path / "second")
    assert not (tmp_path / "second/lessons").exists()
    first, second = (checkpoint.load(tmp_path / name) for name in ("first", "second"))
    assert second.provenance.training["lessons"] == 2
    assert second.provenance.training["earlier_steps"] == 6
    card = model_card(second, Sampling(frames=16), "float32")
    assert "6 steps, going on from a model of 6 steps; 2 steps of lessons in reading" in card
    third = small(folder, **told, training={"initial": str(tmp_path / "second")})
    train(third, tmp_path / "third")
    learnt = checkpoint.load(tmp_path / "third").provenance.training
    assert (learnt["earlier_steps"], learnt["lessons"]) == (12, 2)
    for name, parameter in first.denoiser.named_parameters():
        same = torch.equal(parameter, second.denoiser.get_parameter(name))
        assert same or not ("embed_text" in name or name == "listener"), name
    assert not torch.equal(first.denoiser.person, second.denoiser.person)


def test_a_published_checkpoint_can_be_trained_further(
    folder: Path, tmp_path: Path, golden: Path
) -> None:
    path = golden / "small_intergen_decoder.ckpt"
    heads = 4
    config = checkpoint.load_release(path, heads=heads).config
    size = {k: getattr(config, k) for k in ("width", "layers", "heads", "feedforward")}
    run = small(folder, model=size, training={"initial": str(path), "loss": "release"})
    with pytest.raises(SpecError, match="text_width"):  # the shipped sentence encoder is narrower
        train(run, tmp_path)
