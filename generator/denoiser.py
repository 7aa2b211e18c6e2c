"""The cooperative denoiser of InterGen (Sec. 4.2): two networks, one set of weights.

Each person's noisy motion runs through the same transformer. In every block a person attends to
itself and then to the *other person's hidden states at the block's input*, so neither waits for the
other, and exchanging the persons exchanges the outputs exactly (eq. 7). Because the weights are
shared, both persons are stacked along the batch and computed as one: person a in the first half,
b in the second, and "the partner" is the batch rolled by half.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from generator.architecture import DenoiserConfig

MAX_POSITIONS = 5000
"""Length of the table of sinusoids: longest motion in frames, and number of diffusion steps."""


def sinusoids(positions: int, width: int) -> Tensor:
    """Return the table ``[positions, width]`` of sines (even) and cosines (odd), base 10000."""
    rate = torch.exp(torch.arange(0, width, 2) * (-math.log(10_000.0) / width))
    angle = torch.arange(positions)[:, None] * rate
    return torch.stack([angle.sin(), angle.cos()], dim=-1).reshape(positions, width)


class AdaptiveNorm(nn.Module):
    """Layer norm whose scale and shift come from time and text: ``h (1 + scale) + shift``."""

    def __init__(self, width: int) -> None:
        """Start as a plain layer norm: scale and shift are zero."""
        super().__init__()
        self.modulation = nn.Linear(width, 2 * width)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)

    def forward(self, hidden: Tensor, condition: Tensor) -> Tensor:
        """Return ``[B, T, D]`` normed; ``condition [B, D]`` is already activated."""
        scale, shift = self.modulation(condition)[:, None].chunk(2, dim=-1)
        normed = functional.layer_norm(hidden, hidden.shape[-1:], eps=1e-6)
        return torch.addcmul(shift, normed, 1 + scale)


class Attention(nn.Module):
    """Multi-head attention (eq. 9) with one added empty key: attending to nothing is allowed.

    Own linears instead of ``nn.MultiheadAttention``: that one copies a transposed batch, which on a
    CPU in bfloat16 is an order of magnitude slower.
    """

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        """Make packed query, key and value weights."""
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.project = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        nn.init.xavier_uniform_(self.project.weight)
        nn.init.zeros_(self.project.bias)
        nn.init.zeros_(self.out.bias)

    def forward(self, queries: Tensor, context: Tensor, keep: Tensor | None) -> Tensor:
        """Return ``[B, T, D]``.

        Args:
            queries: ``[B, T, D]``.
            context: ``[B, S, D]``, source of keys and values.
            keep: ``[B, 1, 1, S + 1]``, which keys may be attended to; ``None``: all.
        """
        width = queries.shape[-1]
        if queries is context:
            q, k, v = self.project(queries).chunk(3, dim=-1)
        else:
            weight, bias = self.project.weight, self.project.bias
            q = functional.linear(queries, weight[:width], bias[:width])
            k, v = functional.linear(context, weight[width:], bias[width:]).chunk(2, dim=-1)
        q = self._split(q)
        k, v = (functional.pad(self._split(part), (0, 0, 0, 1)) for part in (k, v))
        mixed = functional.scaled_dot_product_attention(
            q, k, v, attn_mask=keep, dropout_p=self.dropout if self.training else 0.0
        )
        return self.out(mixed.transpose(1, 2).flatten(2))

    def _split(self, part: Tensor) -> Tensor:
        return part.unflatten(-1, (self.heads, -1)).transpose(1, 2)


class FeedForward(nn.Module):
    """Two linears around a GELU; starts as zero."""

    def __init__(self, width: int, hidden: int, dropout: float) -> None:
        """Make the two layers."""
        super().__init__()
        self.inner = nn.Linear(width, hidden)
        self.outer = nn.Linear(hidden, width)
        self.dropout = nn.Dropout(dropout)
        nn.init.zeros_(self.outer.weight)
        nn.init.zeros_(self.outer.bias)

    def forward(self, hidden: Tensor) -> Tensor:
        """Return ``[B, T, D]``."""
        return self.outer(self.dropout(functional.gelu(self.inner(hidden))))


class Block(nn.Module):
    """Self attention, attention to the partner (eq. 10), feed-forward; all residual."""

    def __init__(self, config: DenoiserConfig) -> None:
        """Make the layers of one block."""
        super().__init__()
        width = config.width
        self.self_norm = AdaptiveNorm(width)
        self.self_attention = Attention(width, config.heads, config.dropout)
        self.mutual_norm = AdaptiveNorm(width)
        self.partner_norm = AdaptiveNorm(width)
        self.mutual_attention = Attention(width, config.heads, config.dropout)
        self.feedforward_norm = AdaptiveNorm(width)
        self.feedforward = FeedForward(width, config.feedforward, config.dropout)

    def forward(
        self, hidden: Tensor, partner: Tensor, condition: Tensor, keep: Tensor | None
    ) -> Tensor:
        """Return the next hidden states ``[B, T, D]`` of one person given the partner's."""
        own = self.self_norm(hidden, condition)
        hidden = hidden + self.self_attention(own, own, keep)
        queries = self.mutual_norm(hidden, condition)
        context = self.partner_norm(partner, condition)
        hidden = hidden + self.mutual_attention(queries, context, keep)
        return hidden + self.feedforward(self.feedforward_norm(hidden, condition))


class Denoiser(nn.Module):
    """Predicts the clean motion of two people from a noisy one (x0 prediction, eq. 8)."""

    positions: Tensor

    def __init__(self, config: DenoiserConfig) -> None:
        """Make the network; without weight sharing, each person has blocks of its own."""
        super().__init__()
        self.config = config
        width = config.width
        self.register_buffer("positions", sinusoids(MAX_POSITIONS, width), persistent=False)
        self.embed_motion = nn.Linear(config.features, width)
        self.embed_text = nn.Linear(config.text_width, width)
        self.embed_time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        branches = 1 if config.share_weights else 2
        self.branches = nn.ModuleList(
            nn.ModuleList(Block(config) for _ in range(config.layers)) for _ in range(branches)
        )
        self.out = nn.Linear(width, config.features)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Tensor, t: Tensor, cond: Tensor, mask: Tensor | None = None) -> Tensor:
        """Return the predicted clean motion ``[B, T, 2F]``, normalised.

        Args:
            x: ``[B, T, 2F]`` noisy motion, normalised: person a's F features, then b's.
            t: ``[B]`` diffusion step, 0 (clean) to 999.
            cond: ``[B, C]`` condition; zeros for the unconditional branch.
            mask: ``[B, T]``, nonzero where a frame exists; ``None``: everywhere.
        """
        frames = x.shape[1]
        condition = self.embed_time(self.positions[t]) + self.embed_text(cond)
        hidden = self.embed_motion(torch.cat(x.chunk(2, dim=-1)))
        hidden = hidden + self.positions[:frames]
        concat = self.config.conditioning == "concat"
        if concat:
            hidden = torch.cat([condition.repeat(2, 1)[:, None], hidden], dim=1)
            active = torch.zeros_like(condition)
        else:
            active = functional.silu(condition)
        hidden = self._blocks(hidden, active, _keys(mask, extra=concat))
        return torch.cat(self.out(hidden[:, -frames:]).chunk(2), dim=-1)

    def _blocks(self, hidden: Tensor, active: Tensor, keep: Tensor | None) -> Tensor:
        half = len(active)
        if len(self.branches) == 1:
            both = active.repeat(2, 1)
            keys = None if keep is None else keep.repeat(2, 1, 1, 1)
            for block in self.branches[0]:  # type: ignore[attr-defined]
                hidden = block(hidden, hidden.roll(half, dims=0), both, keys)
            return hidden
        a, b = hidden.chunk(2)
        for block_a, block_b in zip(*self.branches, strict=True):  # type: ignore[arg-type]
            a, b = block_a(a, b, active, keep), block_b(b, a, active, keep)
        return torch.cat([a, b])


def _keys(mask: Tensor | None, *, extra: bool) -> Tensor | None:
    """Return which keys count, ``[B, 1, 1, S + 1]``: the real frames, and the empty one."""
    if mask is None:
        return None
    keep = functional.pad(mask > 0.5, (1 if extra else 0, 1), value=True)
    return keep[:, None, None]
