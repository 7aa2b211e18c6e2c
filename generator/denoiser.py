"""The cooperative denoiser of InterGen (Sec. 4.2): two networks, one set of weights.

Each person's noisy motion runs through the same transformer. In every block a person attends to
itself and then to the *other person's hidden states at the block's input*, so neither waits for the
other, and exchanging the persons exchanges the outputs exactly (eq. 7). Because the weights are
shared, both persons are computed as one batch ``[2, B, T, D]``, and "the partner" is that batch
flipped along its first axis.

**Who is who.** That symmetry has a price where sentences name "the first person": the network
cannot know which of the two it is moving. Features put the first one at the origin, but in pure
noise nobody is there yet: half of what was drawn came out exchanged, and who led was a matter of
chance. With ``told_apart``, a learnt vector is added to each person's frames, and another one to
the words as that person reads them: the same sentence asks different things of the two. Both start
at zero, so that a trained network can go on learning with them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from generator.architecture import DenoiserConfig

MAX_POSITIONS = 5000
"""Length of the table of sinusoids: longest motion in frames, and number of diffusion steps."""


def sinusoids(positions: int, width: int) -> Tensor:
    """Return the table ``[positions, width]`` of sines (even) and cosines (odd), base 10000.

    In float32 throughout, as published checkpoints made theirs: at position 5000 that is off by
    2e-4, which their weights were trained with. The last bits depend on the machine's ``exp``, so
    the table is saved with the weights.
    """
    rate = torch.exp(torch.arange(0, width, 2) * (-math.log(10_000.0) / width))
    angle = torch.arange(positions)[:, None] * rate
    return torch.stack([angle.sin(), angle.cos()], dim=-1).reshape(positions, width)


def adaptive_norm(hidden: Tensor, scale: Tensor, shift: Tensor, *, width: int) -> Tensor:
    """Return layer norm without weights, then ``h (1 + scale) + shift``; both ``[P, B, 1, D]``.

    The width is given, not read off: whoever traces the network is to see a number.
    """
    normed = functional.layer_norm(hidden, (width,), eps=1e-6)
    return torch.addcmul(shift, normed, 1 + scale)


def attend(q: Tensor, k: Tensor, v: Tensor, keep: Tensor | None, dropout: float) -> Tensor:
    """Return what ``scaled_dot_product_attention`` does, written out.

    The library's gradient in bfloat16 takes a CPU eight times as long as that of these four lines
    (two people, 32 clips of 100 frames, 8 heads of 32: 356 against 47 ms).
    """
    scores = (q * q.shape[-1] ** -0.5) @ k.transpose(-1, -2)
    if keep is not None:
        scores = scores.masked_fill(~keep, -math.inf)
    weights = scores.softmax(-1).to(v.dtype)
    return functional.dropout(weights, dropout) @ v


class Attention(nn.Module):
    """Multi-head attention (eq. 9) with one added empty key: attending to nothing is allowed.

    Own linears instead of ``nn.MultiheadAttention``: that one copies a transposed batch, which on a
    CPU in bfloat16 is an order of magnitude slower.
    """

    def __init__(self, width: int, heads: int, dropout: float, *, mutual: bool) -> None:
        """Make the weights.

        Args:
            width: D.
            heads: Number of heads, which divides the width.
            dropout: Of attention weights, while training.
            mutual: Whether keys and values come from somewhere else than the queries.
        """
        super().__init__()
        self.heads, self.dropout, self.mutual = heads, dropout, mutual
        if mutual:
            self.query = nn.Linear(width, width)
            self.key_value = nn.Linear(width, 2 * width)
        else:
            self.project = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        bound = math.sqrt(6 / (width + 3 * width))  # Xavier's for one packed matrix
        for layer in (self.query, self.key_value) if mutual else (self.project,):
            nn.init.uniform_(layer.weight, -bound, bound)
            nn.init.zeros_(layer.bias)
        nn.init.zeros_(self.out.bias)

    def forward(self, queries: Tensor, context: Tensor | None, keep: Tensor | None) -> Tensor:
        """Return ``[P, B, T, D]``.

        Args:
            queries: ``[P, B, T, D]``.
            context: ``[P, B, S, D]``, source of keys and values; ``None`` if not mutual.
            keep: ``[P, B, 1, 1, S + 1]``, which keys may be attended to; ``None``: all.
        """
        if context is None:
            q, *keys_values = self.project(queries).chunk(3, dim=-1)
        else:
            q, keys_values = self.query(queries), self.key_value(context).chunk(2, dim=-1)
        k, v = (functional.pad(self._split(part), (0, 0, 0, 1)) for part in keys_values)
        q, k, v = (part.flatten(0, -4) for part in (self._split(q), k, v))
        keep = None if keep is None else keep.flatten(0, -4)
        dropout = self.dropout if self.training else 0.0
        if q.dtype == torch.bfloat16 and q.device.type == "cpu" and torch.is_grad_enabled():
            mixed = attend(q, k, v, keep, dropout)
        else:
            mixed = functional.scaled_dot_product_attention(q, k, v, keep, dropout)
        people, _, *rest = queries.shape  # -1: a trace would take the number of motions for fixed
        return self.out(mixed.transpose(1, 2).reshape(people, -1, *rest))

    def _split(self, part: Tensor) -> Tensor:
        return part.unflatten(-1, (self.heads, -1)).transpose(-2, -3)


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
        """Return ``[..., D]``."""
        return self.outer(self.dropout(functional.gelu(self.inner(hidden))))


class Block(nn.Module):
    """Self attention, attention to the partner (eq. 10), feed-forward; all residual.

    Before each stands a layer norm whose scale and shift come from time and text. All of a block
    come out of one linear, which starts at zero: plain layer norms.
    """

    def __init__(self, config: DenoiserConfig) -> None:
        """Make the layers of one block."""
        super().__init__()
        self.width = width = config.width
        self.mutual = config.conditioning == "mutual"
        self.norms = 4 if self.mutual else 2
        self.modulation = nn.Linear(width, 2 * self.norms * width)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)
        self.self_attention = Attention(width, config.heads, config.dropout, mutual=False)
        if self.mutual:
            self.mutual_attention = Attention(width, config.heads, config.dropout, mutual=True)
        self.feedforward = FeedForward(width, config.feedforward, config.dropout)

    def forward(
        self, hidden: Tensor, partner: Tensor, modulation: Tensor, keep: Tensor | None
    ) -> Tensor:
        """Return the next hidden states.

        Args:
            hidden: ``[P, B, T, D]`` of one or both persons.
            partner: ``[P, B, T, D]``, the other person's at this block's input.
            modulation: ``[P or 1, B, 2 norms D]``: scale and shift before self attention,
                feed-forward, mutual attention's queries and its context.
            keep: ``[P, B, 1, 1, T + 1]``, which frames count.
        """
        # As many as there are people: the gradient is then summed over one axis at a time, which
        # takes an eighth of what both at once take.
        each = modulation[:, :, None].expand(len(hidden), -1, -1, -1)
        parts = each.chunk(2 * self.norms, dim=-1)
        norm = partial(adaptive_norm, width=self.width)
        own = norm(hidden, *parts[0:2])
        hidden = hidden + self.self_attention(own, None, keep)
        if self.mutual:
            queries = norm(hidden, *parts[4:6])
            context = norm(partner, *parts[6:8])
            hidden = hidden + self.mutual_attention(queries, context, keep)
        return hidden + self.feedforward(norm(hidden, *parts[2:4]))


class TextReader(nn.Module):
    """Reads a sentence's tokens, with layers that learn what matters for motion.

    **The problem.** The mean of a sentence's token vectors says what is done, but hardly by whom:
    "A is pushed by B" and "B is pushed by A" have nearly the same one. Each token by itself knows
    its place. As the public release does on top of CLIP, a few layers of attention are trained to
    read them. If tokens say whom they name, that is positive for whoever reads and negative for the
    other one.
    """

    def __init__(self, config: DenoiserConfig) -> None:
        """Make the layers."""
        super().__init__()
        width = config.width
        self.tokens = config.text_tokens
        self.embed = nn.Linear(config.text_width // config.text_tokens, width)
        self.place = nn.Parameter(0.02 * torch.randn(config.text_tokens, width))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2 * config.text_layers + 1))
        self.attentions = nn.ModuleList(
            Attention(width, config.heads, config.dropout, mutual=False)
            for _ in range(config.text_layers)
        )
        self.feedforwards = nn.ModuleList(
            FeedForward(width, 2 * width, config.dropout) for _ in range(config.text_layers)
        )
        self.out = nn.Linear(width, width)

    def forward(self, cond: Tensor, listeners: Tensor) -> Tensor:
        """Return ``[P, B, D]`` of the tokens ``[P, B, C]``; without any, the same for all.

        Args:
            cond: Token vectors in a row.
            listeners: ``[P, D]``, who reads.
        """
        tokens = cond.unflatten(-1, (self.tokens, -1))
        real = (tokens != 0).any(-1).to(tokens.dtype)
        keep = (functional.pad(real, (0, 1), value=1.0) > 0.5)[:, :, None, None]
        hidden = self.embed(tokens) + self.place + listeners[:, None, None]  # [P, B, L, D]
        layers = zip(self.attentions, self.feedforwards, strict=True)
        for number, (attention, feedforward) in enumerate(layers):
            hidden = hidden + attention(self.norms[2 * number](hidden), None, keep)
            hidden = hidden + feedforward(self.norms[2 * number + 1](hidden))
        weight = real[..., None].to(hidden.dtype)
        mean = (self.norms[-1](hidden) * weight).sum(2) / weight.sum(2).clamp_min(1)
        return self.out(mean)


class Network(nn.Module):
    """The layers of one person's network; with weight sharing, of both persons'."""

    def __init__(self, config: DenoiserConfig) -> None:
        """Make the layers."""
        super().__init__()
        width = config.width
        inputs = config.features * (1 if config.conditioning == "mutual" else 2)
        self.embed_motion = nn.Linear(inputs, width)
        self.embed_text = (
            TextReader(config) if config.text_tokens else nn.Linear(config.text_width, width)
        )
        self.embed_time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        blocks = nn.ModuleList(Block(config) for _ in range(config.layers))
        self.blocks = cast(Sequence[Block], blocks)
        self.out = nn.Linear(width, config.features)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def read(self, cond: Tensor, listeners: Tensor) -> Tensor:
        """Return ``[P, B, D]``, what each listener ``[P, D]`` makes of its ``[P, B, C]``."""
        if isinstance(self.embed_text, TextReader):
            return self.embed_text(cond, listeners)
        return self.embed_text(cond) + listeners[:, None]

    def modulations(self, time: Tensor, text: Tensor) -> Tensor:
        """Return scales and shifts of every block, ``[P, layers, B, ...]``.

        Args:
            time: ``[B, D]`` sinusoids of the steps.
            text: ``[P, B, D]`` from :meth:`read`.
        """
        active = functional.silu(self.embed_time(time) + text)
        return torch.stack([block.modulation(active) for block in self.blocks], dim=1)


class Denoiser(nn.Module):
    """Predicts the clean motion of two people from a noisy one (x0 prediction, eq. 8)."""

    positions: Tensor

    def __init__(self, config: DenoiserConfig) -> None:
        """Make the network; without weight sharing, each person has one of its own."""
        super().__init__()
        self.config = config
        self.register_buffer("positions", sinusoids(MAX_POSITIONS, config.width))
        count = 1 if config.share_weights else 2
        networks = nn.ModuleList(Network(config) for _ in range(count))
        self.networks = cast(Sequence[Network], networks)
        if config.told_apart:
            self.person = nn.Parameter(torch.zeros(2, config.width))
            self.listener = nn.Parameter(torch.zeros(2, config.width))

    def forward(self, x: Tensor, t: Tensor, cond: Tensor, mask: Tensor | None = None) -> Tensor:
        """Return the predicted clean motion ``[B, T, 2F]``, normalised.

        Args:
            x: ``[B, T, 2F]`` noisy motion, normalised: person a's F features, then b's.
            t: ``[B]`` diffusion step, 0 (clean) to 999.
            cond: ``[B, C]`` condition; zeros for the unconditional branch.
            mask: ``[B, T]``, nonzero where a frame exists; ``None``: everywhere.
        """
        return self.denoise(x, self.modulations(t, self.read(cond)), mask)

    def read(self, cond: Tensor) -> Tensor:
        """Return ``[P, B, D]`` of condition vectors ``[B, C]``: the same at every step.

        P is 2 if two people or two networks read them differently, else 1.
        """
        shares = len(self.networks)
        if self.config.told_apart:
            listeners, texts = self.listener, torch.stack([cond, self._turned(cond)])
        else:
            listeners = self.positions.new_zeros(shares, self.config.width)
            texts = cond.expand(shares, *cond.shape)
        both = zip(self.networks, texts.chunk(shares), listeners.chunk(shares), strict=True)
        return torch.cat([net.read(*own) for net, *own in both])

    def _turned(self, cond: Tensor) -> Tensor:
        """Return a sentence's vectors with the names of the two people exchanged."""
        if not self.config.text_names:
            return cond
        tokens = cond.unflatten(-1, (self.config.text_tokens, -1))
        return torch.cat([tokens[..., :-1], -tokens[..., -1:]], dim=-1).flatten(-2)

    def modulations(self, t: Tensor, text: Tensor) -> Tensor:
        """Return what time and text do to every block: ``[P, layers, B, ...]``.

        It does not depend on the motion, so a sampler makes it for all its steps at once.

        Args:
            t: ``[B]`` diffusion steps.
            text: ``[P, B, D]`` from :meth:`read`.
        """
        time = self.positions[t]
        both = zip(self.networks, text.chunk(len(self.networks)), strict=True)
        return torch.cat([net.modulations(time, words) for net, words in both])

    def denoise(self, x: Tensor, modulations: Tensor, mask: Tensor | None = None) -> Tensor:
        """Return the predicted clean motion, as :meth:`forward`, given :meth:`modulations`."""
        shares = len(self.networks)
        people = torch.stack(x.chunk(2, dim=-1))
        if self.config.conditioning == "concat":
            people = torch.cat([people, people.flip(0)], dim=-1)
        keep = _keys(mask, 2 // shares)
        hidden = self._each("embed_motion", people) + self.positions[: x.shape[1]]
        if self.config.told_apart:
            hidden = hidden + self.person[:, None, None]
        for layer in range(self.config.layers):
            partner = hidden.flip(0)
            parts = zip(hidden.chunk(shares), partner.chunk(shares), strict=True)
            hidden = torch.cat(
                [
                    net.blocks[layer](own, other, modulation[:, layer], keep)
                    for net, (own, other), modulation in zip(
                        self.networks, parts, modulations.chunk(shares), strict=True
                    )
                ]
            )
        return torch.cat(self._each("out", hidden).unbind(), dim=-1)

    def _each(self, layer: str, people: Tensor) -> Tensor:
        parts = people.chunk(len(self.networks))
        return torch.cat(
            [getattr(net, layer)(part) for net, part in zip(self.networks, parts, strict=True)]
        )


def _keys(mask: Tensor | None, people: int) -> Tensor | None:
    """Return which keys count, ``[P, B, 1, 1, T + 1]``: the real frames, and the empty one."""
    if mask is None:
        return None
    keep = functional.pad(mask > 0.5, (0, 1), value=True)
    return keep[None, :, None, None].expand(people, -1, -1, -1, -1)
