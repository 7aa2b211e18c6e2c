"""Faster arithmetic: the same numbers, and nothing changed behind anyone's back."""

from __future__ import annotations

import pytest
import torch

from generator.architecture import DenoiserConfig
from generator.model import InterGen
from generator.precision import (
    PRECISIONS,
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


def test_fast_is_the_same_and_bfloat16_is_near(model: InterGen):
    exact = drawn(model)
    fast, coarse = drawn(prepared(model, "fast")), drawn(prepared(model, "bfloat16"))
    scale = float(exact.abs().max())
    assert float((fast - exact).abs().max()) < 2e-4 * scale
    assert 1e-4 * scale < float((coarse - exact).abs().max()) < 0.2 * scale
    assert coarse.dtype == torch.float32


def test_fast_uses_medium_products_only_where_they_are_float32(model: InterGen, monkeypatch):
    for exact, expected in ((True, "medium"), (False, "highest")):
        monkeypatch.setattr("generator.precision.medium_is_float32", lambda exact=exact: exact)
        assert prepared(model, "fast").matmul == expected
    assert model.matmul == "highest"
    seen = []
    fast = prepared(model, "fast")
    fast.matmul = "medium"
    fast.sample(
        torch.ones(1, 5), 4, steps=1, seed=0,
        constrain=lambda x, _: (seen.append(torch.get_float32_matmul_precision()), x)[1],
    )  # fmt: skip
    assert seen == ["medium"]


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
