"""Faster arithmetic for sampling on a CPU: the same numbers sooner, or bfloat16.

**The problem.** Nearly all time goes into products of matrices. On many CPUs the library that torch
takes for float32 by default is not the fastest one; one call changes it
(``torch.set_float32_matmul_precision("medium")``, about 1.9 times as fast on AMD). But that call
*permits* bfloat16, and a CPU with matrix tiles (AMX) makes use of the permission: results are then
off by a fraction of a percent. Such CPUs multiply bfloat16 eight times as fast as float32 though,
so there the float32 product is put together from bfloat16 ones (:class:`SplitLinear`).

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
from torch import Tensor, nn
from torch.nn import functional

from robots.errors import SpecError

if TYPE_CHECKING:
    from generator.model import InterGen

Precision = Literal["float32", "fast", "bfloat16"]
"""``float32``: torch's default. ``fast``: the same to five digits, however this machine does that
best. ``bfloat16``: three digits, half the memory."""

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


class SplitLinear(nn.Module):
    """A float32 linear made of bfloat16 products.

    Every number is the sum of two bfloat16 ones, ``x = x1 + x2``, to 16 of its 24 bits; the product
    needs ``x1 w1 + x2 w1 + x1 w2``. Products accumulate in float32 but *come out* rounded to
    bfloat16, so they are taken in two steps, the second of which starts from minus the first one's
    rounded result and thus yields what rounding lost:

        y1 = round(x1 w1)        y2 = round(x1 w1 - y1 + x2 w1 + x1 w2)        y = y1 + y2

    y2 is a 500th of y, and rounded to a 500th of itself: five digits are right. Four bfloat16
    products take less time than one in float32 where they run on matrix tiles. The two halves of
    the weights take as much memory as the weights did.
    """

    halves: Tensor
    bias: Tensor

    def __init__(self, linear: nn.Linear) -> None:
        """Split the weights of a linear."""
        super().__init__()
        weight = linear.weight.detach()
        high = weight.bfloat16()
        self.inputs = linear.in_features
        self.register_buffer("halves", torch.cat([high, (weight - high).bfloat16()], dim=1))
        self.register_buffer("bias", linear.bias.detach())

    def forward(self, x: Tensor) -> Tensor:
        """Return ``x W' + b`` in float32; no gradient."""
        rows = x.reshape(-1, self.inputs)
        split = rows.new_empty((len(rows), 2 * self.inputs), dtype=torch.bfloat16)
        low, high = split.chunk(2, dim=1)
        high.copy_(rows)
        low.copy_(rows - high.float())
        weight = self.halves[:, : self.inputs]
        coarse = functional.linear(high, weight)
        rest = torch.addmm(coarse, high, weight.T, beta=-1)
        rest = torch.addmm(rest, split, self.halves.T)
        # converted first: a sum of mixed types takes torch three times as long
        y = coarse.float().add_(rest.float()).add_(self.bias)
        return y.reshape(*x.shape[:-1], -1)


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
    if precision == "fast":
        if medium_is_float32():
            result.matmul = "medium"
        else:
            result.denoiser = copy.deepcopy(model.denoiser, _shared(model.denoiser))
            _split(result.denoiser)
    elif precision == "bfloat16":
        result.denoiser = copy.deepcopy(model.denoiser).bfloat16()
    return result.eval()


def _shared(module: nn.Module) -> dict[int, object]:
    """Return a memo with which ``deepcopy`` copies modules but not their weights."""
    tensors = [*module.parameters(), *module.buffers()]
    return {id(tensor): tensor for tensor in tensors}


def _split(module: nn.Module) -> None:
    """Replace the linears that are large and see every frame."""
    for name, child in list(module.named_children()):
        if isinstance(child, nn.Linear) and min(child.weight.shape) >= _SMALLEST:
            if name not in _ONCE:
                setattr(module, name, SplitLinear(child))
        elif name not in _ONCE:
            _split(child)


_ONCE = ("modulation", "embed_text", "embed_time")
"""Linears that are computed once for all frames."""
_SMALLEST = 64
"""Width from which splitting pays."""
