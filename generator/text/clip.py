"""CLIP's text tower (Radford et al. 2021) as a sentence encoder, from files on this machine.

A causal transformer over byte-pair tokens, with pre-norm blocks and a fast approximation of GELU.
The vector of a sentence is the state at its last token, after the final layer norm and *before*
CLIP's projection into the space it shares with pictures: that is what InterGen conditions on.
"""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from generator.text.clip_tokenizer import CONTEXT, ClipTokenizer, find_vocabulary
from generator.weights import adopt
from robots.errors import CheckpointError, SpecError


@dataclass(frozen=True, slots=True)
class ClipConfig:
    """Size of a text tower; the defaults are those of ViT-L/14, with or without ``@336px``.

    Raises:
        SpecError: A number is not positive, or the width does not divide by the heads.
    """

    width: int = 768
    """Width of the states."""
    layers: int = 12
    """Blocks."""
    heads: int = 12
    """Attention heads; 64 numbers each in every published CLIP."""
    context: int = CONTEXT
    """Tokens of a sentence, with padding."""
    vocabulary: int = 49408
    """Number of tokens."""

    def __post_init__(self) -> None:
        """Validate."""
        numbers = (self.width, self.layers, self.heads, self.context, self.vocabulary)
        if min(numbers) < 1 or self.width % self.heads:
            raise SpecError(f"a text tower cannot have sizes {numbers}", where="CLIP")


class QuickGelu(nn.Module):
    """``x sigmoid(1.702 x)``, which CLIP was trained with."""

    def forward(self, x: Tensor) -> Tensor:
        """Return the activation."""
        return x * torch.sigmoid(1.702 * x)


class ClipBlock(nn.Module):
    """Causal self attention and a feed-forward layer, both pre-norm and residual."""

    def __init__(self, width: int, heads: int) -> None:
        """Make the layers."""
        super().__init__()
        self.ln_1 = nn.LayerNorm(width)
        self.attn = nn.MultiheadAttention(width, heads, batch_first=True)
        self.ln_2 = nn.LayerNorm(width)
        parts = [
            ("c_fc", nn.Linear(width, 4 * width)),
            ("gelu", QuickGelu()),
            ("c_proj", nn.Linear(4 * width, width)),
        ]
        self.mlp = nn.Sequential(OrderedDict(parts))

    def forward(self, x: Tensor, causal: Tensor) -> Tensor:
        """Return the next states ``[N, S, D]``; ``causal [S, S]`` is true where not to look."""
        normed = self.ln_1(x)
        x = x + self.attn(normed, normed, normed, need_weights=False, attn_mask=causal)[0]
        return x + self.mlp(self.ln_2(x))


class ClipTextTower(nn.Module):
    """Tokens to states, frozen."""

    def __init__(self, config: ClipConfig) -> None:
        """Make an untrained tower."""
        super().__init__()
        self.config = config
        self.token_embedding = nn.Embedding(config.vocabulary, config.width)
        self.positional_embedding = nn.Parameter(torch.zeros(config.context, config.width))
        blocks = nn.ModuleList(ClipBlock(config.width, config.heads) for _ in range(config.layers))
        self.resblocks = cast(Sequence[ClipBlock], blocks)
        self.ln_final = nn.LayerNorm(config.width)

    def forward(self, tokens: Tensor) -> Tensor:
        """Return ``[N, S, D]`` for tokens ``[N, S]``, S up to the context."""
        x = self.token_embedding(tokens) + self.positional_embedding[: tokens.shape[1]]
        length = tokens.shape[1]
        causal = torch.ones(length, length, dtype=torch.bool, device=x.device).triu(1)
        for block in self.resblocks:
            x = block(x, causal)
        return self.ln_final(x)

    @classmethod
    def from_state(cls, state: Mapping[str, Tensor], *, where: str) -> ClipTextTower:
        """Return a frozen tower with these weights, in any naming that :func:`tower_state` knows.

        Raises:
            CheckpointError: The weights are not those of a text tower; names the key.
        """
        named = tower_state(state)
        with torch.device("meta"):
            tower = cls(_infer(named, where))
        adopt(tower, {key: value.float().clone() for key, value in named.items()}, where=where)
        return tower.eval().requires_grad_(False)


def sentence_end(tokens: Tensor) -> Tensor:
    """Return ``[N]``, where each sentence ends: the end mark has the highest number of all."""
    return tokens.argmax(dim=-1)


class ClipEncoder:
    """Sentences to CLIP vectors, as the paper conditions on (Sec. 5.1).

    Attributes:
        dimension: Width of the vectors.
    """

    kind = "clip"

    def __init__(self, tower: ClipTextTower, tokenizer: ClipTokenizer) -> None:
        """Join a tower and its tokenizer."""
        self.tower, self.tokenizer = tower, tokenizer
        self.dimension = tower.config.width

    @classmethod
    def from_folder(cls, folder: str | Path, vocabulary: str | Path | None = None) -> ClipEncoder:
        """Return CLIP from local files: weights as ``.safetensors`` or ``.pt``, and a vocabulary.

        The names of OpenAI, open_clip and Hugging Face's transformers are understood.

        Args:
            folder: Where the weights lie, or the file itself.
            vocabulary: ``bpe_simple_vocab_16e6.txt.gz`` or ``tokenizer.json``; looked for in the
                folder and in installed packages by default.

        Raises:
            CheckpointError: There are no such weights, or they are damaged.
        """
        path = Path(folder)
        file = path if path.is_file() else _weights_in(path)
        tower = ClipTextTower.from_state(_read(file), where=str(file))
        near = path.parent if path.is_file() else path
        return cls(tower, ClipTokenizer(find_vocabulary(vocabulary, near)))

    @torch.no_grad()
    def encode(self, sentences: Sequence[str]) -> NDArray[np.float32]:
        """Return ``[N, D]``, not scaled to unit length."""
        tokens = torch.from_numpy(self.tokenizer.encode(sentences))
        states = self.tower(tokens)
        return states[torch.arange(len(tokens)), sentence_end(tokens)].numpy()


def tower_state(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the text tower's weights under the names of :class:`ClipTextTower`.

    Understood are the names of OpenAI and open_clip (``transformer.resblocks``), of the InterGen
    release (``clip_transformer.resblocks``) and of transformers (``text_model.encoder.layers``).
    Weights of the picture tower and the projection are left out.
    """
    if any(key.startswith("text_model.") for key in state):
        return _from_transformers(state)
    kept = (
        "token_embedding.",
        "positional_embedding",
        "ln_final.",
        "transformer.resblocks.",
        "clip_transformer.resblocks.",
        "resblocks.",
    )
    result = {}
    for key, value in state.items():
        name = key.removeprefix("text.")
        if name.startswith(kept):
            result[name.removeprefix("clip_").removeprefix("transformer.")] = value
    return result


def _from_transformers(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Rename, and pack query, key and value."""
    prefix = "text_model."
    fixed = {
        "embeddings.token_embedding.weight": "token_embedding.weight",
        "embeddings.position_embedding.weight": "positional_embedding",
        "final_layer_norm.weight": "ln_final.weight",
        "final_layer_norm.bias": "ln_final.bias",
    }
    inner = {
        "layer_norm1": "ln_1",
        "layer_norm2": "ln_2",
        "mlp.fc1": "mlp.c_fc",
        "mlp.fc2": "mlp.c_proj",
        "self_attn.out_proj": "attn.out_proj",
    }
    result: dict[str, Tensor] = {}
    packed: dict[str, dict[str, Tensor]] = {}
    for key, value in state.items():
        name = key.removeprefix(prefix)
        match = re.fullmatch(r"encoder\.layers\.(\d+)\.(.+)\.(weight|bias)", name)
        if not key.startswith(prefix):
            continue
        if name in fixed:
            result[fixed[name]] = value
        elif match and match[2] in inner:
            result[f"resblocks.{match[1]}.{inner[match[2]]}.{match[3]}"] = value
        elif match and match[2].startswith("self_attn."):
            target = f"resblocks.{match[1]}.attn.in_proj_{match[3]}"
            packed.setdefault(target, {})[match[2][-6]] = value
    for target, parts in packed.items():
        if sorted(parts) == ["k", "q", "v"]:
            result[target] = torch.cat([parts["q"], parts["k"], parts["v"]])
    return result


def _infer(named: Mapping[str, Tensor], where: str) -> ClipConfig:
    for key in ("token_embedding.weight", "positional_embedding"):
        if key not in named:
            raise CheckpointError(f"key '{key}' is missing", where=where)
        if named[key].dim() != 2:
            raise CheckpointError(
                f"key '{key}' has shape {tuple(named[key].shape)}", where=where, allowed="a matrix"
            )
    indices = [int(key.split(".")[1]) for key in named if re.match(r"resblocks\.\d+\.", key)]
    vocabulary, width = named["token_embedding.weight"].shape
    try:
        return ClipConfig(
            width=width,
            layers=1 + max(indices, default=-1),
            heads=max(1, width // 64),
            context=len(named["positional_embedding"]),
            vocabulary=vocabulary,
        )
    except SpecError as error:
        raise CheckpointError(str(error), where=where) from error


def _weights_in(folder: Path) -> Path:
    files = [*sorted(folder.glob("*.safetensors")), *sorted(folder.glob("*.pt"))]
    if len(files) != 1:
        raise CheckpointError(
            f"{len(files)} files of weights" if folder.is_dir() else "there is no such folder",
            where=str(folder),
            allowed="one .safetensors or .pt",
            hint="name the file itself" if files else "",
        )
    return files[0]


def _read(file: Path) -> Mapping[str, Tensor]:
    """Return the tensors of a file, from safetensors or torch's restricted unpickler."""
    try:
        if file.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(file)
        content: Any = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # every layer below has its own kinds
        raise CheckpointError(
            f"cannot be read: {(str(error) or repr(error)).splitlines()[0]}",
            where=str(file),
            hint="only safetensors and plain state dicts are read; convert other files",
        ) from error
    content = content.get("state_dict", content) if isinstance(content, Mapping) else content
    if not isinstance(content, Mapping):
        raise CheckpointError("the file holds no state dict", where=str(file))
    return {str(k).removeprefix("module."): v for k, v in content.items() if isinstance(v, Tensor)}
