"""Faster arithmetic: the same numbers, and nothing changed behind anyone's back."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from generator.architecture import DenoiserConfig
from generator.model import InterGen
from generator.precision import (
    PRECISIONS,
    SplitLinear,
    matmul_precision,
    medium_is_float32,
    prepared,
)
from generator.threads import default_threads, thread_limit
from robots.errors import SpecError

CONFIG = DenoiserConfig(width=64, layers=2, heads=2, feedforward=128, features=64, text_width=5)


@pytest.fixture(scope="module")
def model() -> InterGen:
    torch.manual_seed(0)
    model = InterGen(CONFIG)
    for value in model.parameters():
        torch.nn.init.normal_(value, std=0.1)
    return model.eval()


def drawn(model: InterGen) -> torch.Tensor:
    return model.sample(torch.ones(1, 5), 20, steps=4, seed=0)


@torch.no_grad()
@pytest.mark.parametrize("bias", [0.0, 300.0])
def test_a_split_linear_is_right_to_five_digits(bias: float):
    torch.manual_seed(0)
    linear = nn.Linear(192, 96)
    linear.bias += bias
    x = torch.randn(3, 50, 192) * torch.logspace(-3, 3, 50)[:, None]
    exact = x.double() @ linear.weight.double().T + linear.bias.double()
    split = SplitLinear(linear)(x)
    assert split.shape == exact.shape
    assert split.dtype == torch.float32
    scale = (x.double().norm(dim=-1) * linear.weight.double().norm(dim=1).max() + bias)[..., None]
    assert ((split - exact).abs() / scale).max() < 1e-5
    coarse = nn.functional.linear(x.bfloat16(), linear.weight.bfloat16()).float() + linear.bias
    assert ((coarse - exact).abs() / scale).max() > 1e-4


def test_fast_is_the_same_and_bfloat16_is_near(model: InterGen):
    exact = drawn(model)
    fast, coarse = drawn(prepared(model, "fast")), drawn(prepared(model, "bfloat16"))
    scale = float(exact.abs().max())
    assert float((fast - exact).abs().max()) < 2e-4 * scale
    assert 1e-4 * scale < float((coarse - exact).abs().max()) < 0.2 * scale
    assert coarse.dtype == torch.float32


def test_split_products_take_over_where_medium_is_not_float32(model: InterGen, monkeypatch):
    monkeypatch.setattr("generator.precision.medium_is_float32", lambda: False)
    fast = prepared(model, "fast")
    kinds = [type(module) for module in fast.denoiser.modules()]
    assert kinds.count(SplitLinear) == 2 * 7 + 2
    assert fast.matmul == "highest"
    exact = drawn(model)
    assert float((drawn(fast) - exact).abs().max()) < 2e-4 * float(exact.abs().max())
    monkeypatch.setattr("generator.precision.medium_is_float32", lambda: True)
    assert prepared(model, "fast").matmul == "medium"


@pytest.mark.parametrize("precision", PRECISIONS)
def test_preparing_leaves_the_model_and_torch_as_they_were(model: InterGen, precision):
    before = {key: value.clone() for key, value in model.state_dict().items()}
    expected, setting = drawn(model), torch.get_float32_matmul_precision()
    fast = prepared(model, precision)
    first = drawn(fast)
    assert torch.equal(drawn(fast), first)
    assert torch.get_float32_matmul_precision() == setting
    after = model.state_dict()
    assert all(torch.equal(after[key], value) for key, value in before.items())
    assert torch.equal(drawn(model), expected)
    assert all(value.dtype == torch.float32 for value in model.parameters())


def test_an_unknown_precision_is_refused(model: InterGen):
    with pytest.raises(SpecError, match="bfloat16"):
        prepared(model, "float8")  # type: ignore[arg-type]


def test_the_machine_is_judged_by_what_it_computes():
    torch.manual_seed(0)
    a, b = torch.randn(300, 300), torch.randn(300, 300)
    with matmul_precision("medium"):
        error = float((a @ b - (a.double() @ b.double()).float()).abs().max())
    assert medium_is_float32() == (error < 1e-3)


def test_precision_is_restored_after_an_error():
    setting = torch.get_float32_matmul_precision()
    with pytest.raises(RuntimeError), matmul_precision("medium"):
        raise RuntimeError
    assert torch.get_float32_matmul_precision() == setting


def test_one_core_stays_free(monkeypatch):
    for cores, expected in ((1, 1), (2, 1), (8, 7)):
        monkeypatch.setattr("os.sched_getaffinity", lambda _, n=cores: set(range(n)), raising=False)
        assert default_threads() == expected
    before = torch.get_num_threads()
    with thread_limit(1) as count:
        assert torch.get_num_threads() == count == 1
    assert torch.get_num_threads() == before
