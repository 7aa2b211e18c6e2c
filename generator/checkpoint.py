"""Models on disk: this project's own folders, and the checkpoint that InterGen's authors published.

The published file is a Lightning checkpoint, which is a pickle. It is opened only with torch's
restricted unpickler, which knows tensors and plain containers and refuses what could run code.
"""

from __future__ import annotations

import logging
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from generator.architecture import DenoiserConfig
from generator.denoiser import sinusoids
from generator.model import InterGen
from generator.model_folder import from_json, require_format
from generator.provenance import Provenance
from generator.release_keys import (
    DUPLICATE,
    TABLES,
    TEXT_PREFIXES,
    denoiser_shapes,
    denoiser_state,
    infer_config,
)
from generator.text.encoder import (
    MiniLmEncoder,
    SentenceEncoder,
    TokenEncoder,
    packaged_encoder,
)
from generator.text.release_text import ReleaseText
from generator.weights import adopt, load_weights, require, save_weights
from robots.errors import CheckpointError, DuetError
from robots.files import parse_npy

logger = logging.getLogger(__name__)

FORMAT = "pasdedeux-intergen"
VERSION = 1
RELEASE_LICENCE = "CC BY-NC-SA 4.0"
RELEASE_NOTICE = (
    "the weights of InterGen (Liang et al., IJCV 2024) are licensed CC BY-NC-SA 4.0: "
    "not for commercial use, and what is made with them is to be shared alike"
)
STATISTICS = ("global_mean.npy", "global_std.npy")
_TEXT = "text."


def load_release(
    path: str | Path,
    *,
    text: bool = False,
    heads: int = 8,
    statistics: str | Path | None = None,
    vocabulary: str | Path | None = None,
) -> InterGen:
    """Return the public InterGen model from its ``.ckpt``.

    Every key and shape is checked. The authors' normalisation lies in two files of their
    repository, not in the checkpoint; without them samples stay normalised, without metres.

    Args:
        path: The Lightning checkpoint.
        text: Whether to load the text path too (CLIP's text tower and two more layers).
        heads: Attention heads, which no shape tells.
        statistics: Folder of ``global_mean.npy`` and ``global_std.npy``; where the checkpoint lies
            by default, if they are there.
        vocabulary: CLIP's ``bpe_simple_vocab_16e6.txt.gz`` or ``tokenizer.json``; looked for where
            the checkpoint lies and in installed packages by default.

    Raises:
        CheckpointError: The file is not such a checkpoint; the text names the key.
    """
    path = Path(path)
    where = path.name
    state = read_lightning(path)
    network = {key: value for key, value in state.items() if not key.startswith(TEXT_PREFIXES)}
    config = infer_config(network, heads=heads, where=where)
    require(denoiser_shapes(config), network, where=where)
    own = sinusoids(*network[TABLES[0]].shape)
    for key in TABLES:
        if not torch.allclose(network[key].float(), own, atol=1e-3):
            raise CheckpointError(f"key '{key}' is not the table of sinusoids", where=where)
    encoder = None
    if text:
        words = {key: value for key, value in state.items() if key.startswith(TEXT_PREFIXES)}
        encoder = ReleaseText.from_release_state(
            words, where=where, vocabulary=vocabulary, folder=path.parent
        )
    provenance = Provenance(source=f"InterGen release ({where})", licence=RELEASE_LICENCE)
    with torch.device("meta"):
        model = InterGen(config, text=encoder, provenance=provenance)
    tensors = {f"denoiser.{k}": v for k, v in denoiser_state(network, config).items()}
    tensors |= {"mean": torch.zeros(config.features), "std": torch.ones(config.features)}
    adopt(model, tensors, where=where)
    _take_statistics(model, path.parent if statistics is None else Path(statistics), statistics)
    _warn_of_licence()
    return model.eval()


def save(model: InterGen, folder: str | Path, *, half: bool = False, **entries: Any) -> str:
    """Write a model as a folder of safetensors and JSON, whole or not at all.

    A text encoder that has weights of its own (:class:`ReleaseText`) is saved with it; of any other
    the kind is noted.

    Args:
        model: The model.
        folder: Made if it does not exist; an older model in it is replaced.
        half: Whether the network's weights are stored in half the bytes, rounded to 11 bits.
        entries: Further entries of the header.

    Returns:
        The SHA-256 of the weights.

    Raises:
        CheckpointError: The folder cannot be written to.
    """
    tensors = {key: value.float() for key, value in model.state_dict().items()}
    if half:
        tensors |= {f"denoiser.{k}": v.half() for k, v in model.denoiser.named_parameters()}
    if isinstance(model.text, ReleaseText):
        tensors |= {_TEXT + key: value for key, value in model.text.state_dict().items()}
    header = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": asdict(model.config),
        "text_encoder": text_kind(model.text),
        "provenance": asdict(model.provenance),
        **entries,
    }
    return save_weights(folder, header, tensors)


def load(
    folder: str | Path, *, text: bool = True, encoder: SentenceEncoder | None = None
) -> InterGen:
    """Return a model that :func:`save` wrote.

    Args:
        folder: Where it lies.
        text: Whether to make its text encoder too.
        encoder: Use this one; needed for a kind that is not shipped.

    Raises:
        CheckpointError: A file or key is missing, damaged or unknown; the text names it.
    """
    header, tensors = load_weights(folder)
    where = str(folder)
    require_format(header, FORMAT, VERSION, where)
    words = {k.removeprefix(_TEXT): tensors.pop(k) for k in list(tensors) if k.startswith(_TEXT)}
    if encoder is None and text:
        encoder = _make_encoder(str(header.get("text_encoder", "")), words, Path(folder))
    config = from_json(DenoiserConfig, header.get("architecture"), where)
    provenance = from_json(Provenance, header.get("provenance"), where)
    with torch.device("meta"):
        model = InterGen(config, text=encoder, provenance=provenance)
    adopt(model, tensors, where=where)
    if provenance.licence == RELEASE_LICENCE:
        _warn_of_licence()
    return model.eval()


def text_kind(encoder: SentenceEncoder | None) -> str:
    """Return the name under which a text encoder is noted; empty for none."""
    if encoder is None:
        return ""
    if isinstance(encoder, MiniLmEncoder):
        return "minilm"
    if isinstance(encoder, TokenEncoder):
        return encoder.kind
    return str(getattr(encoder, "kind", type(encoder).__name__))


def _make_encoder(kind: str, words: dict[str, Tensor], folder: Path) -> SentenceEncoder | None:
    if kind == "":
        return None
    packaged = packaged_encoder(kind)
    if packaged is not None:
        return packaged
    if kind == ReleaseText.kind:
        return ReleaseText.from_state(words, where=str(folder), folder=folder)
    raise CheckpointError(
        f"the model was made with the text encoder '{kind}', which does not come with it",
        where=str(folder),
        hint="pass it as encoder=..., or load with text=False",
    )


def read_lightning(path: Path) -> dict[str, Tensor]:
    """Return a Lightning checkpoint's tensors, without the prefix ``model.`` and duplicates.

    Raises:
        CheckpointError: The file is damaged, holds code, or has no ``state_dict``.
    """
    where = path.name
    content = _unpickle(path)
    state = content.get("state_dict", content) if isinstance(content, Mapping) else None
    if not isinstance(state, Mapping):
        raise CheckpointError("the file holds no state_dict", where=where)
    tensors: dict[str, Tensor] = {}
    for key, value in state.items():
        if not isinstance(key, str) or not isinstance(value, Tensor):
            raise CheckpointError(f"entry {key!r} is not a tensor", where=where)
        name = key.removeprefix("model.")
        if not name.startswith(DUPLICATE):
            tensors[name] = value
    return tensors


def _unpickle(path: Path) -> Any:
    try:
        if not zipfile.is_zipfile(path):
            with open(path, "rb"):
                pass
            return torch.load(path, map_location="cpu", weights_only=True)
        return torch.load(path, map_location="cpu", weights_only=True, mmap=True)
    except FileNotFoundError as error:
        raise CheckpointError("there is no such file", where=str(path)) from error
    except Exception as error:  # every layer below has its own kinds, none of them promised
        code = "weights_only" in str(error) or "Unsupported" in str(error)
        raise CheckpointError(
            "it holds more than tensors, or is damaged, and is not opened further"
            if code
            else f"cannot be read: {str(error).splitlines()[0] if str(error) else repr(error)}",
            where=str(path),
            hint="a pickle can run code; get the file from its authors" if code else "",
        ) from error


def _take_statistics(model: InterGen, folder: Path, asked: str | Path | None) -> None:
    values = []
    for name in STATISTICS:
        file = folder / name
        if not file.is_file():
            if asked is not None:
                raise CheckpointError("there is no such file", where=str(file))
            logger.warning(
                "%s is not beside the checkpoint: samples stay normalised, without metres", name
            )
            return
        try:
            values.append(np.asarray(parse_npy(file.read_bytes(), where=str(file)), np.float32))
        except (DuetError, OSError, ValueError) as error:
            raise CheckpointError(f"cannot be read: {error}", where=str(file)) from error
    try:
        model.set_statistics(*values)
    except DuetError as error:
        raise CheckpointError(str(error), where=str(folder)) from error


@cache
def _warn_of_licence() -> None:
    logger.warning("%s", RELEASE_NOTICE)
