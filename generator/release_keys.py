"""The keys of the public InterGen checkpoint, and how they map to this project's.

A published file is only numbers under names; this module lists those names with their shapes for an
architecture, so that a file is checked completely before it is used. Two things are packed
differently here: what a block's layer norms get from time and text is one linear instead of four,
and attention's query is apart from its key and value.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import torch
from torch import Tensor

from generator.architecture import DenoiserConfig
from generator.denoiser import MAX_POSITIONS
from generator.text.clip import ClipConfig
from robots.errors import CheckpointError

Shapes = dict[str, tuple[int, ...]]

NET = "decoder.net."
TABLES = (f"{NET}sequence_pos_encoder.pe", f"{NET}embed_timestep.sequence_pos_encoder.pe")
"""Two copies of the table of sinusoids."""
DUPLICATE = "decoder.cfg_model."
"""The release registers the network a second time as soon as it has sampled."""
TEXT_PREFIXES = (
    "positional_embedding",
    "token_embedding.",
    "clip_transformer.",
    "ln_final.",
    "clipTransEncoder.",
    "clip_ln.",
)
_NORMS = ("sa_block.norm", "ffn.norm", "ca_block.norm", "ca_block.xf_norm")
"""The layer norms of a block in the order of :class:`generator.denoiser.Block`."""


def denoiser_shapes(config: DenoiserConfig) -> Shapes:
    """Return every key of the release's denoiser with its shape."""
    width, hidden = config.width, config.feedforward
    shapes: Shapes = dict.fromkeys(TABLES, (MAX_POSITIONS, width))

    def linear(name: str, outputs: int, inputs: int) -> None:
        shapes[f"{NET}{name}.weight"] = (outputs, inputs)
        shapes[f"{NET}{name}.bias"] = (outputs,)

    linear("embed_timestep.time_embed.0", width, width)
    linear("embed_timestep.time_embed.2", width, width)
    linear("motion_embed", width, config.features)
    linear("text_embed", width, config.text_width)
    linear("out.linear", config.features, width)
    for i in range(config.layers):
        for norm in _NORMS:
            linear(f"blocks.{i}.{norm}.emb_layers.1", 2 * width, width)
        for block in ("sa_block", "ca_block"):
            attention = f"blocks.{i}.{block}.attention"
            shapes[f"{NET}{attention}.in_proj_weight"] = (3 * width, width)
            shapes[f"{NET}{attention}.in_proj_bias"] = (3 * width,)
            linear(f"{attention}.out_proj", width, width)
        linear(f"blocks.{i}.ffn.linear1", hidden, width)
        linear(f"blocks.{i}.ffn.linear2", width, hidden)
    return shapes


def post_norm_shapes(prefix: str, layers: int, width: int, hidden: int) -> Shapes:
    """Return the keys of a stack of post-norm transformer layers."""
    shapes: Shapes = {}
    for i in range(layers):
        name = f"{prefix}.layers.{i}"
        shapes |= {
            f"{name}.self_attn.in_proj_weight": (3 * width, width),
            f"{name}.self_attn.in_proj_bias": (3 * width,),
            f"{name}.self_attn.out_proj.weight": (width, width),
            f"{name}.self_attn.out_proj.bias": (width,),
            f"{name}.linear1.weight": (hidden, width),
            f"{name}.linear1.bias": (hidden,),
            f"{name}.linear2.weight": (width, hidden),
            f"{name}.linear2.bias": (width,),
        }
        for norm in ("norm1", "norm2"):
            shapes |= {f"{name}.{norm}.weight": (width,), f"{name}.{norm}.bias": (width,)}
    return shapes


def text_shapes(config: ClipConfig, head_layers: int = 2, head_hidden: int = 2048) -> Shapes:
    """Return every key of the release's text path with its shape."""
    width = config.width
    shapes: Shapes = {
        "positional_embedding": (config.context, width),
        "token_embedding.weight": (config.vocabulary, width),
        "ln_final.weight": (width,),
        "ln_final.bias": (width,),
        "clip_ln.weight": (width,),
        "clip_ln.bias": (width,),
    }
    for i in range(config.layers):
        block = f"clip_transformer.resblocks.{i}"
        shapes |= {
            f"{block}.attn.in_proj_weight": (3 * width, width),
            f"{block}.attn.in_proj_bias": (3 * width,),
            f"{block}.attn.out_proj.weight": (width, width),
            f"{block}.attn.out_proj.bias": (width,),
            f"{block}.mlp.c_fc.weight": (4 * width, width),
            f"{block}.mlp.c_fc.bias": (4 * width,),
            f"{block}.mlp.c_proj.weight": (width, 4 * width),
            f"{block}.mlp.c_proj.bias": (width,),
        }
        for norm in ("ln_1", "ln_2"):
            shapes |= {f"{block}.{norm}.weight": (width,), f"{block}.{norm}.bias": (width,)}
    return shapes | post_norm_shapes("clipTransEncoder", head_layers, width, head_hidden)


def infer_config(state: Mapping[str, Tensor], *, heads: int, where: str) -> DenoiserConfig:
    """Return the architecture that the shapes in a checkpoint tell of.

    Args:
        state: The checkpoint's tensors, without the ``model.`` prefix.
        heads: Attention heads, which no shape tells.
        where: Name of the file, for errors.

    Raises:
        CheckpointError: A key that tells a size is missing or has another rank.
    """

    def shape(name: str) -> tuple[int, int]:
        key = NET + name
        if key not in state:
            raise CheckpointError(f"key '{key}' is missing", where=where)
        if state[key].dim() != 2:
            raise CheckpointError(
                f"key '{key}' has shape {tuple(state[key].shape)}", where=where, allowed="a matrix"
            )
        return (state[key].shape[0], state[key].shape[1])

    width, features = shape("motion_embed.weight")
    indices = [re.match(rf"{re.escape(NET)}blocks\.(\d+)\.", key) for key in state]
    layers = 1 + max((int(match[1]) for match in indices if match), default=-1)
    return DenoiserConfig(
        width=width,
        layers=layers,
        heads=heads,
        feedforward=shape("blocks.0.ffn.linear1.weight")[0],
        features=features,
        text_width=shape("text_embed.weight")[1],
    )


def denoiser_state(state: Mapping[str, Tensor], config: DenoiserConfig) -> dict[str, Tensor]:
    """Return the weights of a checked release under the names of :class:`Denoiser`."""
    net = "networks.0."
    names = {
        "embed_motion": "motion_embed",
        "embed_text": "text_embed",
        "embed_time.0": "embed_timestep.time_embed.0",
        "embed_time.2": "embed_timestep.time_embed.2",
        "out": "out.linear",
    }
    for i in range(config.layers):
        names[f"blocks.{i}.feedforward.inner"] = f"blocks.{i}.ffn.linear1"
        names[f"blocks.{i}.feedforward.outer"] = f"blocks.{i}.ffn.linear2"
        for own, theirs in (("self", "sa"), ("mutual", "ca")):
            names[f"blocks.{i}.{own}_attention.out"] = (
                f"blocks.{i}.{theirs}_block.attention.out_proj"
            )
    result = {"positions": state[TABLES[0]].clone()}
    for kind in ("weight", "bias"):
        for own, theirs in names.items():
            result[f"{net}{own}.{kind}"] = state[f"{NET}{theirs}.{kind}"].clone()
        for i in range(config.layers):
            block = f"{NET}blocks.{i}."
            result[f"{net}blocks.{i}.modulation.{kind}"] = torch.cat(
                [state[f"{block}{norm}.emb_layers.1.{kind}"] for norm in _NORMS]
            )
            own = f"{net}blocks.{i}.self_attention.project.{kind}"
            result[own] = state[f"{block}sa_block.attention.in_proj_{kind}"].clone()
            packed = state[f"{block}ca_block.attention.in_proj_{kind}"]
            own = f"{net}blocks.{i}.mutual_attention"
            result[f"{own}.query.{kind}"] = packed[: config.width].clone()
            result[f"{own}.key_value.{kind}"] = packed[config.width :].clone()
    return result
