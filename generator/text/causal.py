"""Any causal language model as a sentence encoder: the row "LLaMA" of the paper's Table 3."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from robots.errors import CheckpointError


class CausalEncoder:
    """Sentences to the last token's state in the penultimate layer of a frozen language model.

    Of a causal model only the last token has read the whole sentence.

    Attributes:
        dimension: Width of the vectors.
    """

    kind = "causal"

    def __init__(self, folder: str | Path, *, layer: int = -2, longest: int = 256) -> None:
        """Load a model and its tokenizer.

        Args:
            folder: A local folder in the layout of ``transformers``; nothing is downloaded, and no
                code that lies in it is run.
            layer: Which of the hidden states counts; -2 is the penultimate.
            longest: Tokens beyond this are cut off.

        Raises:
            CheckpointError: ``transformers`` is not installed, or the folder holds no such model.
        """
        where = str(folder)
        if not Path(folder).is_dir():
            raise CheckpointError("there is no such folder", where=where)
        try:
            import transformers  # type: ignore[import-not-found]
        except ImportError as error:
            raise CheckpointError(
                "language models need the package 'transformers'", hint="pip install transformers"
            ) from error
        options = {"local_files_only": True, "trust_remote_code": False}
        try:
            self._tokenizer: Any = transformers.AutoTokenizer.from_pretrained(where, **options)
            model: Any = transformers.AutoModel.from_pretrained(
                where, use_safetensors=True, **options
            )
        except Exception as error:  # transformers raises what its many loaders raise
            reason = (str(error) or repr(error)).splitlines()[0]
            raise CheckpointError(f"cannot be loaded: {reason}", where=where) from error
        self._model = model.eval().requires_grad_(False)
        self._layer, self._longest = layer, longest
        self.dimension = int(model.config.hidden_size)

    @torch.no_grad()
    def encode(self, sentences: Sequence[str]) -> NDArray[np.float32]:
        """Return ``[N, D]``, not scaled to unit length.

        One sentence at a time: padding on either side would change what some models see.
        """
        rows = np.zeros((len(sentences), self.dimension), np.float32)
        for row, sentence in zip(rows, sentences, strict=True):
            tokens = self._tokenizer(
                sentence, return_tensors="pt", truncation=True, max_length=self._longest
            )
            states = self._model(**tokens, output_hidden_states=True).hidden_states
            row[:] = states[self._layer][0, -1].float().numpy()
        return rows
