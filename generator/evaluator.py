"""The contrastive evaluator InterCLIP: motions and sentences in one space, near if they match.

The metrics of Sec. 5 are distances in this space. Three text paths: the release's own (byte-pair
tokens through a transformer), so that its published evaluator can be loaded
(:mod:`generator.release_evaluator`); vectors of any frozen sentence encoder through two layers, and
the states of its tokens through a small transformer, which are what can be trained on little data.
The last one reads who does what to whom, of which a mean over words keeps little.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from generator.architecture import FEATURES
from generator.checkpoint import text_kind
from generator.denoiser import sinusoids
from generator.model_folder import from_json, require_format
from generator.text.clip import sentence_end
from generator.text.clip_tokenizer import CONTEXT, ClipTokenizer, find_vocabulary
from generator.text.encoder import SentenceEncoder, packaged_encoder
from generator.weights import adopt, load_weights, save_weights
from robots.errors import CheckpointError, SpecError

CONTACTS = 4
"""Foot contacts at the end of each person's features, which the evaluator does not see."""
LONGEST = 2000
"""Positions that its table holds: the query and the frames."""
TEXTS = ("tokens", "sentence", "states")
"""Text paths."""
FORMAT = "pasdedeux-interclip"
VERSION = 1


@dataclass(frozen=True, slots=True)
class EvaluatorConfig:
    """Size of an evaluator; the defaults are the release's.

    Raises:
        SpecError: A number is out of range.
    """

    width: int = 1024
    """Width of the motion transformer."""
    layers: int = 8
    """Its layers; the token path has as many."""
    heads: int = 8
    """Attention heads."""
    feedforward: int = 2048
    """Hidden width of the feed-forward layers."""
    features: int = FEATURES
    """Numbers per person and frame, foot contacts included."""
    embedding: int = 512
    """Width of the common space."""
    dropout: float = 0.1
    """While training."""
    text: Literal["tokens", "sentence", "states"] = "tokens"
    """The release's text path, or vectors of a frozen sentence encoder: one a sentence, or the
    states of its tokens one after the other."""
    text_width: int = 768
    """Width of token states or of sentence vectors; with ``states``, of all of a sentence."""
    text_tokens: int = 1
    """Tokens of a sentence, with ``states``."""
    text_layers: int = 2
    """Layers that read these."""
    vocabulary: int = 49408
    """Tokens, for the release's text path."""

    def __post_init__(self) -> None:
        """Validate."""
        numbers = ("width", "layers", "heads", "feedforward", "embedding", "text_width")
        for name in (*numbers, "text_tokens", "text_layers"):
            if not isinstance(getattr(self, name), int) or getattr(self, name) < 1:
                raise SpecError(f"{name} is {getattr(self, name)!r}", where="evaluator")
        if self.width % self.heads or self.width % 2 or self.features <= CONTACTS:
            raise SpecError(f"width {self.width} with {self.heads} heads", where="evaluator")
        if self.text not in TEXTS:
            raise SpecError(f"text is {self.text!r}", where="evaluator", allowed=", ".join(TEXTS))
        if self.text_width % self.text_tokens:
            raise SpecError(f"{self.text_tokens} tokens in {self.text_width}", where="evaluator")


def _transformer(
    width: int, config: EvaluatorConfig, layers: int | None = None
) -> nn.TransformerEncoder:
    layer = nn.TransformerEncoderLayer(
        width,
        config.heads,
        config.feedforward,
        dropout=config.dropout,
        activation="gelu",
        batch_first=True,
    )
    return nn.TransformerEncoder(layer, layers or config.layers, enable_nested_tensor=False)


class MotionEncoder(nn.Module):
    """A learned query reads the frames of both persons through a post-norm transformer."""

    positions: Tensor

    def __init__(self, config: EvaluatorConfig) -> None:
        """Make an untrained encoder."""
        super().__init__()
        width = config.width
        self.query_token = nn.Parameter(torch.randn(1, width))
        self.embed_motion = nn.Linear(2 * (config.features - CONTACTS), width)
        self.register_buffer("positions", sinusoids(LONGEST, width))
        self.dropout = nn.Dropout(config.dropout)
        self.transformer = _transformer(width, config)
        self.out_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, config.embedding)

    def forward(self, motion: Tensor, lengths: Tensor) -> Tensor:
        """Return ``[B, E]`` for raw features ``[B, T, 2F]`` of which ``lengths [B]`` frames count.

        Raises:
            SpecError: The motion is longer than the table of positions.
        """
        frames = motion.shape[1]
        if frames >= LONGEST:
            raise SpecError(f"{frames} frames", where="evaluator", allowed=f"below {LONGEST}")
        people = motion.unflatten(-1, (2, -1))[..., :-CONTACTS].flatten(-2)
        query = self.query_token.expand(len(motion), 1, -1)
        states = torch.cat([query, self.embed_motion(people)], dim=1)
        states = self.dropout(states + self.positions[: frames + 1])
        index = torch.arange(frames + 1, device=motion.device)
        padding = index[None] > lengths[:, None].to(motion.device)
        states = self.transformer(states, src_key_padding_mask=padding)
        return self.out(self.out_ln(states[:, 0]))


class TokenText(nn.Module):
    """The release's text path: CLIP's tokens and embeddings, then a transformer of its own."""

    def __init__(self, config: EvaluatorConfig) -> None:
        """Make an untrained path."""
        super().__init__()
        width = config.text_width
        self.token_embedding = nn.Embedding(config.vocabulary, width)
        self.positional_embedding = nn.Parameter(0.01 * torch.randn(CONTEXT, width))
        self.transformer = _transformer(width, config)
        self.text_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, config.embedding)
        self.token_embedding.requires_grad_(False)
        self.positional_embedding.requires_grad_(False)

    def forward(self, tokens: Tensor) -> Tensor:
        """Return ``[B, E]`` for tokens ``[B, 77]``; nothing is masked, as in training."""
        states = self.token_embedding(tokens) + self.positional_embedding
        states = self.text_ln(self.transformer(states))
        return self.out(states[torch.arange(len(tokens)), sentence_end(tokens)])


class SentenceText(nn.Sequential):
    """Vectors of a frozen sentence encoder through two layers."""

    def __init__(self, config: EvaluatorConfig) -> None:
        """Make untrained layers."""
        super().__init__(
            nn.Linear(config.text_width, 2 * config.embedding),
            nn.GELU(),
            nn.Dropout(config.dropout),
            nn.Linear(2 * config.embedding, config.embedding),
        )


class StatesText(nn.Module):
    """The states of a frozen encoder's tokens through a transformer; a learned query reads them."""

    def __init__(self, config: EvaluatorConfig) -> None:
        """Make an untrained path."""
        super().__init__()
        self.states = config.text_width // config.text_tokens
        self.embed = nn.Linear(self.states, config.width)
        self.places = nn.Parameter(0.02 * torch.randn(1 + config.text_tokens, config.width))
        self.transformer = _transformer(config.width, config, config.text_layers)
        self.out_ln = nn.LayerNorm(config.width)
        self.out = nn.Linear(config.width, config.embedding)

    def forward(self, vectors: Tensor) -> Tensor:
        """Return ``[B, E]`` for token states ``[B, L * C]``; a token of zeros is none."""
        tokens = vectors.unflatten(-1, (-1, self.states))
        there = (tokens != 0).any(dim=-1)
        longest = max(int(there.sum(dim=1).max()), 1)
        tokens, there = tokens[:, :longest], there[:, :longest]
        query = self.places[:1].expand(len(tokens), 1, -1)
        words = self.embed(tokens) + self.places[1 : longest + 1]
        padding = torch.cat([torch.zeros_like(there[:, :1]), ~there], dim=1)
        states = self.transformer(torch.cat([query, words], dim=1), src_key_padding_mask=padding)
        return self.out(self.out_ln(states[:, 0]))


_TEXT_PATHS: dict[str, type[nn.Module]] = {
    "tokens": TokenText,
    "sentence": SentenceText,
    "states": StatesText,
}


class InterClip(nn.Module):
    """The evaluator.

    Attributes:
        config: Its size.
        motion_encoder: Raw features to the common space.
        text_encoder: Tokens, or vectors of ``sentences``, to the common space.
        sentences: The frozen sentence encoder, if the text path is ``sentence`` or ``states``.
        vocabulary: File of CLIP's vocabulary, if known, for the text path ``tokens``.
    """

    sentences: SentenceEncoder | None

    def __init__(
        self,
        config: EvaluatorConfig,
        *,
        sentences: SentenceEncoder | None = None,
        vocabulary: str | Path | None = None,
    ) -> None:
        """Make an untrained evaluator."""
        super().__init__()
        self.config = config
        self.motion_encoder = MotionEncoder(config)
        self.text_encoder = _TEXT_PATHS[config.text](config)
        self.latent_scale = nn.Parameter(torch.full((1,), math.sqrt(1 / 0.07)))
        self.__dict__["sentences"] = sentences
        self.vocabulary = vocabulary

    def embed_motion(self, motion: Tensor, lengths: Tensor) -> Tensor:
        """Return ``[B, E]`` of length ``latent_scale``.

        Args:
            motion: ``[B, T, 2F]`` raw features, metres, person a first.
            lengths: ``[B]`` frames that count.
        """
        return self._scaled(self.motion_encoder(motion, lengths))

    def embed_text(self, prepared: Tensor) -> Tensor:
        """Return ``[B, E]`` of length ``latent_scale`` for what :meth:`prepare` gives."""
        return self._scaled(self.text_encoder(prepared))

    def prepare(self, texts: Sequence[str]) -> Tensor:
        """Return sentences as tokens ``[B, 77]`` or vectors ``[B, C]``; can be kept and reused.

        Raises:
            CheckpointError: There is no vocabulary or no sentence encoder.
        """
        if self.config.text == "tokens":
            tokenizer = ClipTokenizer(find_vocabulary(self.vocabulary))
            return torch.from_numpy(tokenizer.encode(texts))
        if self.sentences is None:
            raise CheckpointError("this evaluator was made without its sentence encoder")
        return torch.from_numpy(np.asarray(self.sentences.encode(list(texts)), np.float32))

    def _scaled(self, embedding: Tensor) -> Tensor:
        return functional.normalize(embedding, dim=-1) * self.latent_scale

    def loss(
        self, motion: Tensor, lengths: Tensor, prepared: Tensor, groups: Tensor | None = None
    ) -> Tensor:
        """Return the symmetric InfoNCE loss of a batch of matching pairs.

        Args:
            motion: ``[B, T, 2F]`` raw features.
            lengths: ``[B]`` frames that count.
            prepared: Their sentences, from :meth:`prepare`.
            groups: ``[B]``, equal where two sentences mean the same: such pairs are not pushed
                apart.
        """
        logits = self.embed_motion(motion, lengths) @ self.embed_text(prepared).T
        targets = torch.arange(len(logits), device=logits.device)
        if groups is not None:
            same = (groups[:, None] == groups[None]) & ~torch.eye(
                len(groups), dtype=torch.bool, device=groups.device
            )
            logits = logits.masked_fill(same, float("-inf"))
        ways = (
            functional.cross_entropy(logits, targets),
            functional.cross_entropy(logits.T, targets),
        )
        return (ways[0] + ways[1]) / 2


def save_evaluator(model: InterClip, folder: str | Path) -> str:
    """Write an evaluator as a folder of safetensors and JSON, whole or not at all.

    Returns:
        The SHA-256 of the weights, which belongs beside every score made with them.

    Raises:
        CheckpointError: The folder cannot be written to.
    """
    header = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": asdict(model.config),
        "text_encoder": text_kind(model.sentences),
    }
    return save_weights(folder, header, model.state_dict())


def load_evaluator(folder: str | Path, *, sentences: SentenceEncoder | None = None) -> InterClip:
    """Return an evaluator that :func:`save_evaluator` wrote.

    Args:
        folder: Where it lies.
        sentences: Its sentence encoder, if that is not the one that ships.

    Raises:
        CheckpointError: A file or key is missing, damaged or unknown; the text names it.
    """
    header, tensors = load_weights(folder)
    where = str(folder)
    require_format(header, FORMAT, VERSION, where)
    kind = header.get("text_encoder", "")
    if sentences is None and kind:
        sentences = packaged_encoder(kind)
    if sentences is None and kind:
        raise CheckpointError(
            f"it was trained with the text encoder '{kind}', which does not come with it",
            where=where,
            hint="pass it as sentences=...",
        )
    config = from_json(EvaluatorConfig, header.get("architecture"), where)
    with torch.device("meta"):
        model = InterClip(config, sentences=sentences)
    adopt(model, tensors, where=where)
    return model.eval()
