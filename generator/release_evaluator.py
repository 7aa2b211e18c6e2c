"""The evaluator that InterGen's authors published, from its Lightning checkpoint."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from generator.checkpoint import read_lightning
from generator.denoiser import sinusoids
from generator.evaluator import CONTACTS, LONGEST, EvaluatorConfig, InterClip
from generator.release_keys import Shapes, post_norm_shapes
from generator.text.clip_tokenizer import CONTEXT
from generator.weights import adopt, require
from robots.errors import CheckpointError, SpecError

_TEXT_KEYS = ("positional_embedding", "token_embedding.", "textTransEncoder.", "text_ln.", "out.")


def release_shapes(config: EvaluatorConfig) -> Shapes:
    """Return every key of the release's evaluator with its shape."""
    width, text = config.width, config.text_width
    people = 2 * (config.features - CONTACTS)
    return (
        {
            "positional_embedding": (CONTEXT, text),
            "latent_scale": (1,),
            "motion_encoder.query_token": (1, width),
            "motion_encoder.embed_motion.weight": (width, people),
            "motion_encoder.embed_motion.bias": (width,),
            "motion_encoder.sequence_pos_encoder.pe": (LONGEST, width),
            "motion_encoder.out_ln.weight": (width,),
            "motion_encoder.out_ln.bias": (width,),
            "motion_encoder.out.weight": (config.embedding, width),
            "motion_encoder.out.bias": (config.embedding,),
            "token_embedding.weight": (config.vocabulary, text),
            "text_ln.weight": (text,),
            "text_ln.bias": (text,),
            "out.weight": (config.embedding, text),
            "out.bias": (config.embedding,),
        }
        | post_norm_shapes("motion_encoder.transformer", config.layers, width, config.feedforward)
        | post_norm_shapes("textTransEncoder", config.layers, text, config.feedforward)
    )


def load_release_evaluator(
    path: str | Path,
    *,
    text: bool = True,
    heads: int = 8,
    vocabulary: str | Path | None = None,
) -> InterClip:
    """Return the release's evaluator from its Lightning checkpoint, every key and shape checked.

    Args:
        path: The file.
        text: Whether it must hold the text path; without, only motions can be embedded.
        heads: Attention heads, which no shape tells.
        vocabulary: File of CLIP's vocabulary; looked for in installed packages by default.

    Raises:
        CheckpointError: The file is not such a checkpoint; the text names the key.
    """
    where = Path(path).name
    state = read_lightning(Path(path))
    if not text:
        state = {key: value for key, value in state.items() if not key.startswith(_TEXT_KEYS)}
    config = _infer(state, heads, where)
    shapes = release_shapes(config)
    if not text:
        shapes = {key: shape for key, shape in shapes.items() if not key.startswith(_TEXT_KEYS)}
    require(shapes, state, where=where)
    table = state["motion_encoder.sequence_pos_encoder.pe"].float()
    if not torch.allclose(table, sinusoids(*table.shape), atol=1e-3):
        raise CheckpointError(
            "key 'motion_encoder.sequence_pos_encoder.pe' is not the table of sinusoids",
            where=where,
        )
    model = InterClip(config, vocabulary=vocabulary)
    own = {_own_key(key): value.clone() for key, value in state.items()}
    if not text:
        own |= {k: v for k, v in model.state_dict().items() if k.startswith("text_encoder.")}
    adopt(model, own, where=where)
    return model.eval()


def _own_key(key: str) -> str:
    """Return the name in :class:`InterClip` of a key of the release."""
    if key == "motion_encoder.sequence_pos_encoder.pe":
        return "motion_encoder.positions"
    if key.startswith("textTransEncoder."):
        return "text_encoder.transformer." + key.removeprefix("textTransEncoder.")
    return f"text_encoder.{key}" if key.startswith(_TEXT_KEYS) else key


def _infer(state: dict[str, Tensor], heads: int, where: str) -> EvaluatorConfig:
    def shape(key: str) -> tuple[int, int]:
        if key not in state:
            raise CheckpointError(f"key '{key}' is missing", where=where)
        if state[key].dim() != 2:
            raise CheckpointError(
                f"key '{key}' has shape {tuple(state[key].shape)}", where=where, allowed="a matrix"
            )
        return (state[key].shape[0], state[key].shape[1])

    layers = "motion_encoder.transformer.layers."
    numbers = [int(key.split(".")[3]) for key in state if key.startswith(layers)]
    width, inputs = shape("motion_encoder.embed_motion.weight")
    tokens = shape("token_embedding.weight") if "token_embedding.weight" in state else (1, 768)
    try:
        return EvaluatorConfig(
            width=width,
            layers=1 + max(numbers, default=-1),
            heads=heads,
            feedforward=shape(f"{layers}0.linear1.weight")[0],
            features=inputs // 2 + CONTACTS,
            embedding=shape("motion_encoder.out.weight")[0],
            text_width=tokens[1],
            vocabulary=tokens[0],
        )
    except SpecError as error:
        raise CheckpointError(str(error), where=where) from error
