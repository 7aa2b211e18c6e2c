"""Faster arithmetic for sampling on a CPU: the same numbers sooner, or bfloat16.

**The problem.** Nearly all time goes into products of matrices. On many CPUs the library that torch
takes for float32 by default is not the fastest one; one call changes it
(``torch.set_float32_matmul_precision("medium")``, about 1.9 times as fast on AMD). But that call
*permits* bfloat16, and a CPU with matrix tiles (AMX) makes use of the permission: results are then
off by a fraction of a percent. Such CPUs multiply bfloat16 up to ten times as fast, so there the
fast way is to ask for it, and to know what it costs. (Putting a float32 product together from four
bfloat16 ones was tried there: right to five digits, but on a busy machine slower.)

What a machine does is found out by trying, once: the choice depends on the machine, never on the
moment, so that the same seed stays the same motion.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Literal

import torch
from torch.nn import functional

from robots.errors import SpecError

if TYPE_CHECKING:
    from generator.model import InterGen

Precision = Literal["float32", "fast", "bfloat16"]
"""``float32``: torch's default. ``fast``: the same to five digits, by the fastest library that this
machine has for it. ``bfloat16``: two digits, half the memory."""

PRECISIONS: tuple[Precision, ...] = ("float32", "fast", "bfloat16")
SAME = 1e-5
"""Largest error, relative to the largest number, that counts as the same."""


@contextmanager
def matmul_precision(name: Literal["highest", "high", "medium"]) -> Iterator[None]:
    """Allow less precise float32 products in the block (torch's own names)."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(name)
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


@cache
def medium_is_float32() -> bool:
    """Whether this machine's "medium" products are the same as float32's."""
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.randn(256, 256, generator=generator) for _ in range(2))
    exact = (a.double() @ b.double().T).float()
    with matmul_precision("medium"):
        error = (functional.linear(a, b) - exact).abs().max() / exact.abs().max()
    return float(error) < SAME


def prepared(model: InterGen, precision: Precision) -> InterGen:
    """Return a copy of a model for sampling only; the model itself stays as it is.

    Weights that need no change are shared with the copy.

    Raises:
        SpecError: There is no such precision.
    """
    if precision not in PRECISIONS:
        raise SpecError(f"precision {precision!r}", allowed=" or ".join(PRECISIONS))
    result = copy.copy(model)
    result._modules = dict(model._modules)
    if precision == "fast" and medium_is_float32():
        result.matmul = "medium"
    elif precision == "bfloat16":
        result.denoiser = copy.deepcopy(model.denoiser).bfloat16()
    return result
