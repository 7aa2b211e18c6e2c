"""CLIP's byte-pair tokenizer. Its vocabulary is not shipped; it is looked for on this machine."""

from __future__ import annotations

import gzip
import html
import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robots.errors import CheckpointError

CONTEXT = 77
"""Tokens of a sentence, with the marks of start and end; longer ones are cut off."""
VOCABULARY_FILES = ("bpe_simple_vocab_16e6.txt.gz", "tokenizer.json")
PACKAGES = ("clip", "open_clip")
"""Installable packages that contain the first of these files."""

_START, _END = "<|startoftext|>", "<|endoftext|>"
_MERGES = 49152 - 256 - 2
_MAX_BYTES = 16 * 2**20
_PATTERN = r"'s|'t|'re|'ve|'m|'ll|'d|\p{L}+|\p{N}|[^\s\p{L}\p{N}]+"


class ClipTokenizer:
    """Sentences to token numbers, as OpenAI's CLIP counts them."""

    def __init__(self, vocabulary: str | Path) -> None:
        """Read the vocabulary.

        Args:
            vocabulary: ``bpe_simple_vocab_16e6.txt.gz``, or a ``tokenizer.json``.

        Raises:
            CheckpointError: The file is missing, damaged, or of another tokenizer.
        """
        path = Path(vocabulary)
        try:
            from tokenizers import Tokenizer

            if path.suffix == ".json":
                self._tokenizer: Any = Tokenizer.from_file(str(path))
            else:
                self._tokenizer = _from_merges(_read_merges(path))
        except CheckpointError:
            raise
        except Exception as error:  # tokenizers raises bare Exception
            raise CheckpointError(f"cannot be read: {error}", where=str(path)) from error
        start, end = (self._tokenizer.token_to_id(mark) for mark in (_START, _END))
        if start is None or end is None or end != self._tokenizer.get_vocab_size() - 1:
            raise CheckpointError(
                "it is not CLIP's vocabulary",
                where=str(path),
                allowed=" or ".join(VOCABULARY_FILES),
            )
        self._start, self._end = start, end

    def encode(self, sentences: Sequence[str]) -> NDArray[np.int64]:
        """Return ``[N, 77]``: start mark, tokens, end mark, zeros; what is too long is cut."""
        tokens = np.zeros((len(sentences), CONTEXT), dtype=np.int64)
        for row, sentence in zip(tokens, sentences, strict=True):
            clean = html.unescape(html.unescape(sentence)).strip()
            ids = self._tokenizer.encode(clean, add_special_tokens=False).ids[: CONTEXT - 2]
            marked = [self._start, *ids, self._end]
            row[: len(marked)] = marked
        return tokens


def find_vocabulary(given: str | Path | None, folder: str | Path | None = None) -> Path:
    """Return the file of CLIP's vocabulary.

    Args:
        given: The file, if the user named one.
        folder: Looked into next; then the installed packages ``clip`` and ``open_clip``.

    Raises:
        CheckpointError: It is nowhere.
    """
    if given is not None:
        if not Path(given).is_file():
            raise CheckpointError("there is no such file", where=str(given))
        return Path(given)
    folders = [] if folder is None else [Path(folder)]
    for package in PACKAGES:
        found = importlib.util.find_spec(package)
        if found is not None and found.submodule_search_locations:
            folders.append(Path(found.submodule_search_locations[0]))
    for place in folders:
        for name in VOCABULARY_FILES:
            if (place / name).is_file():
                return place / name
    raise CheckpointError(
        "CLIP's vocabulary is not on this machine",
        where=VOCABULARY_FILES[0],
        hint="put the file beside the weights, or pip install openai-clip, which contains it",
    )


def _read_merges(path: Path) -> list[tuple[str, str]]:
    try:
        with gzip.open(path) as file:
            text = file.read(_MAX_BYTES).decode()
    except (OSError, EOFError, ValueError) as error:
        raise CheckpointError(f"cannot be read: {error}", where=str(path)) from error
    lines = text.split("\n")[1 : 1 + _MERGES]
    merges = [tuple(line.split()) for line in lines]
    if len(merges) != _MERGES or any(len(pair) != 2 for pair in merges):
        raise CheckpointError(
            f"it holds {len(merges)} merges", where=str(path), allowed=f"{_MERGES} pairs"
        )
    return merges  # type: ignore[return-value]


def _from_merges(merges: list[tuple[str, str]]) -> Any:
    """Build the tokenizer: 256 bytes, the same at a word's end, one token per merge, two marks."""
    from tokenizers import AddedToken, Regex, Tokenizer, models, normalizers, pre_tokenizers

    letters = _byte_letters()
    names = [*letters, *(letter + "</w>" for letter in letters)]
    names += ["".join(pair) for pair in merges] + [_START, _END]
    vocabulary = {name: index for index, name in enumerate(names)}
    tokenizer = Tokenizer(
        models.BPE(vocab=vocabulary, merges=merges, end_of_word_suffix="</w>", unk_token=_END)
    )
    tokenizer.normalizer = normalizers.Sequence(
        [normalizers.NFC(), normalizers.Replace(Regex(r"\s+"), " "), normalizers.Lowercase()]
    )
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence(
        [
            pre_tokenizers.Split(Regex(_PATTERN), behavior="removed", invert=True),
            pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False),
        ]
    )
    tokenizer.add_special_tokens([AddedToken(mark, normalized=False) for mark in (_START, _END)])
    return tokenizer


def _byte_letters() -> list[str]:
    """Return one printable letter per byte value, in the order in which GPT-2 numbers them.

    Bytes that are printable in Latin-1 stand for themselves and come first; the other 68 borrow the
    letters from U+0100 on.
    """
    printable = [*range(0x21, 0x7F), *range(0xA1, 0xAD), *range(0xAE, 0x100)]
    others = 256 - len(printable)
    return [chr(code) for code in printable] + [chr(0x100 + i) for i in range(others)]
