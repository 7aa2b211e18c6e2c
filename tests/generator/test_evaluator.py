"""The contrastive evaluator: against the release's keys, and as something that learns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from generator.denoiser import sinusoids
from generator.evaluator import (
    EvaluatorConfig,
    InterClip,
    load_evaluator,
    save_evaluator,
)
from generator.release_evaluator import load_release_evaluator, release_shapes
from robots.errors import CheckpointError, SpecError

torch.set_num_threads(1)

TINY = EvaluatorConfig(
    width=16, layers=1, heads=2, feedforward=32, features=10, embedding=8, text="sentence",
    text_width=5, dropout=0.0,
)  # fmt: skip


class LetterEncoder:
    """Sentences to how often five letters occur in them."""

    def encode(self, sentences):
        return np.array([[s.count(c) for c in "abcde"] for s in sentences], np.float32)


def tiny(**options: object) -> InterClip:
    torch.manual_seed(0)
    return InterClip(TINY, **options).eval()  # type: ignore[arg-type]


def test_key_list_is_at_parity_with_the_release(golden: Path):
    expected = json.loads((golden / "state_dict_keys.json").read_text())["interclip"]
    own = release_shapes(EvaluatorConfig())
    assert {key: list(shape) for key, shape in own.items()} == expected
    assert len(own) == 207


@torch.no_grad()
def test_motion_encoder_of_the_release_loads_and_is_at_parity_with_plain_mathematics(golden: Path):
    """The reference vectors hold no outputs; the transformer is written out here once more."""
    file = golden / "small_interclip_motion.ckpt"
    model = load_release_evaluator(file, text=False)
    assert (model.config.width, model.config.feedforward, model.config.layers) == (64, 128, 8)
    assert model.config.features == 262
    assert float(model.latent_scale.detach()) == 3.0
    state = torch.load(file, weights_only=True)["state_dict"]
    state = {key.removeprefix("model.motion_encoder."): value for key, value in state.items()}

    def linear(x: torch.Tensor, name: str) -> torch.Tensor:
        return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]

    def norm(x: torch.Tensor, name: str) -> torch.Tensor:
        x = (x - x.mean(-1, keepdim=True)) / (x.var(-1, keepdim=True, correction=0) + 1e-5).sqrt()
        return x * state[f"{name}.weight"] + state[f"{name}.bias"]

    motion, length = torch.randn(1, 12, 524), 9
    both = torch.cat([motion[0, :length, :258], motion[0, :length, 262:520]], dim=-1)
    x = torch.cat([state["query_token"], linear(both, "embed_motion")])
    x = x + state["sequence_pos_encoder.pe"].reshape(-1, 64)[: length + 1]
    for i in range(8):
        name = f"transformer.layers.{i}"
        packed = x @ state[f"{name}.self_attn.in_proj_weight"].T
        packed = (packed + state[f"{name}.self_attn.in_proj_bias"]).reshape(-1, 3, 8, 8)
        q, k, v = packed.permute(1, 2, 0, 3)
        mixed = (q @ k.transpose(1, 2) / 8**0.5).softmax(-1) @ v
        attended = linear(mixed.transpose(0, 1).reshape(-1, 64), f"{name}.self_attn.out_proj")
        x = norm(x + attended, f"{name}.norm1")
        inner = torch.nn.functional.gelu(linear(x, f"{name}.linear1"))
        x = norm(x + linear(inner, f"{name}.linear2"), f"{name}.norm2")
    expected = linear(norm(x, "out_ln"), "out")[:1]
    lengths = torch.tensor([length])
    torch.testing.assert_close(
        model.motion_encoder(motion, lengths), expected, rtol=1e-4, atol=1e-4
    )
    embedded = model.embed_motion(motion, lengths)
    torch.testing.assert_close(embedded, 3 * expected / expected.norm(), rtol=1e-4, atol=1e-4)


def release_file(path: Path, change=None) -> tuple[Path, dict[str, torch.Tensor]]:
    config = EvaluatorConfig(
        width=16, layers=1, heads=2, feedforward=32, features=10, embedding=8, text_width=8,
        vocabulary=20,
    )  # fmt: skip
    torch.manual_seed(0)
    state = {key: torch.randn(shape) for key, shape in release_shapes(config).items()}
    state["motion_encoder.sequence_pos_encoder.pe"] = sinusoids(2000, 16)
    if change is not None:
        change(state)
    torch.save({"state_dict": {f"model.{k}": v for k, v in state.items()}}, path)
    return path, state


@torch.no_grad()
def test_a_whole_release_file_loads_with_its_text_path(tmp_path: Path):
    path, state = release_file(tmp_path / "evaluator.ckpt")
    model = load_release_evaluator(path, heads=2)
    tokens = torch.randint(1, 19, (2, 77))
    tokens[:, 5] = 19
    assert model.embed_text(tokens).norm(dim=-1) == pytest.approx(
        [abs(float(state["latent_scale"]))] * 2, rel=1e-5
    )
    assert torch.equal(model.text_encoder.out.weight, state["out.weight"])  # type: ignore[union-attr]
    assert torch.equal(model.motion_encoder.out.weight, state["motion_encoder.out.weight"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s.pop("motion_encoder.out_ln.bias"), r"out_ln\.bias"),
        (lambda s: s.pop("textTransEncoder.layers.0.norm1.bias"), r"norm1\.bias"),
        (lambda s: s.update(text_ln=torch.zeros(1)), "text_ln"),
        (lambda s: s["out.bias"].fill_(float("nan")), r"out\.bias"),
        (lambda s: s["motion_encoder.sequence_pos_encoder.pe"].add_(1), "sinusoids"),
    ],
)
def test_a_damaged_release_file_is_named(tmp_path: Path, change, message: str):
    path, _ = release_file(tmp_path / "evaluator.ckpt", change)
    with pytest.raises(CheckpointError, match=message):
        load_release_evaluator(path, heads=2)


@torch.no_grad()
def test_padding_and_foot_contacts_do_not_count_but_persons_do():
    model, motion, lengths = tiny(), torch.randn(2, 9, 20), torch.tensor([6, 9])
    expected = model.embed_motion(motion, lengths)
    other = motion.clone()
    other[0, 6:] = 50
    other[..., 6:10] = 7
    other[..., 16:] = -7
    torch.testing.assert_close(model.embed_motion(other, lengths), expected)
    torch.testing.assert_close(model.embed_motion(motion[:1, :6], lengths[:1]), expected[:1])
    exchanged = model.embed_motion(motion.roll(10, dims=-1), lengths)
    assert (exchanged - expected).abs().max() > 1e-3


def test_it_learns_to_tell_sentences_apart():
    model = tiny(sentences=LetterEncoder())
    texts = [letter * 3 for letter in "abcd"]
    prepared = model.prepare(texts)
    generator = torch.Generator().manual_seed(1)
    centres = torch.randn(4, 1, 20, generator=generator)
    lengths = torch.full((4,), 8)
    optimiser = torch.optim.Adam(model.parameters(), lr=3e-3)
    loss = torch.tensor(torch.inf)
    for _ in range(60):
        noise = 0.3 * torch.randn(4, 8, 20, generator=generator)
        loss = model.loss(centres + noise, lengths, prepared)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert float(loss.detach()) < 0.1
    with torch.no_grad():
        fresh = centres + 0.3 * torch.randn(4, 8, 20, generator=generator)
        match = model.embed_motion(fresh, lengths) @ model.embed_text(prepared).T
    assert match.argmax(dim=1).tolist() == [0, 1, 2, 3]


def test_loss_is_that_of_the_formula_and_spares_equal_sentences():
    model = tiny()
    motion, lengths = torch.randn(3, 5, 20), torch.full((3,), 5)
    prepared = torch.randn(3, 5)
    with torch.no_grad():
        logits = model.embed_motion(motion, lengths) @ model.embed_text(prepared).T
        both = [-(way.diag() - way.logsumexp(dim=1)).mean() for way in (logits, logits.T)]
        torch.testing.assert_close(model.loss(motion, lengths, prepared), (both[0] + both[1]) / 2)
        groups = torch.tensor([0, 1, 0])
        spared = model.loss(motion, lengths, prepared, groups)
        assert torch.isfinite(spared)
        assert spared < model.loss(motion, lengths, prepared)
        alone = model.loss(motion, lengths, prepared, torch.zeros(3))
    assert float(alone) == pytest.approx(0, abs=1e-6)


def test_a_saved_evaluator_comes_back_the_same(tmp_path: Path):
    model = tiny(sentences=LetterEncoder())
    digest = save_evaluator(model, tmp_path)
    assert len(digest) == 64
    with pytest.raises(CheckpointError, match="LetterEncoder"):
        load_evaluator(tmp_path)
    again = load_evaluator(tmp_path, sentences=LetterEncoder())
    motion, lengths = torch.randn(2, 7, 20), torch.tensor([7, 3])
    assert torch.equal(model.embed_motion(motion, lengths), again.embed_motion(motion, lengths))
    assert torch.equal(model.prepare(["abc"]), again.prepare(["abc"]))


def test_what_does_not_fit_is_refused():
    with pytest.raises(SpecError):
        EvaluatorConfig(width=10, heads=4)
    with pytest.raises(SpecError):
        EvaluatorConfig(text="words")  # type: ignore[arg-type]
    with pytest.raises(SpecError):
        tiny().embed_motion(torch.zeros(1, 2000, 20), torch.tensor([2000]))
    with pytest.raises(CheckpointError):
        tiny().prepare(["abc"])


def test_token_states_are_read_in_their_order_and_padding_is_not_read():
    torch.manual_seed(3)
    config = EvaluatorConfig(
        width=16, layers=1, heads=2, feedforward=32, features=10, embedding=8, text="states",
        text_width=5 * 6, text_tokens=6, dropout=0.0,
    )  # fmt: skip
    model = InterClip(config).eval()
    tokens = torch.randn(3, 5)
    short = torch.zeros(1, 30)
    short[0, :15] = tokens.flatten()
    long = torch.randn(1, 30)
    alone, beside = model.embed_text(short), model.embed_text(torch.cat([short, long]))
    assert torch.allclose(alone[0], beside[0], atol=1e-5)
    turned = short.clone()
    turned[0, :15] = tokens.flip(0).flatten()
    assert not torch.allclose(model.embed_text(turned), alone, atol=1e-3)


def test_states_that_do_not_fill_the_tokens_are_refused():
    with pytest.raises(SpecError, match="tokens"):
        EvaluatorConfig(text="states", text_width=31, text_tokens=6)
