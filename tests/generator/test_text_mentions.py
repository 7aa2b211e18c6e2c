"""Whom a sentence names, and where."""

from __future__ import annotations

import numpy as np
import pytest

from generator.text.encoder import NAMING, packaged_encoder
from generator.text.mentions import mentions


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("the first person bows and the other waves", "a:the first person b:the other"),
        ("The second is pushed by the first one", "b:The second a:the first one"),
        ("Person two hugs person 1", "b:Person two a:person 1"),
        ("dancer B turns, the other one is turned", "b:dancer B a:the other one"),
        ("A pushes B", "a:A b:B"),
        ("A man pushes a woman", ""),
        ("one person waves, the other one waves back", ""),
        ("for the second time they meet", ""),
        ("the two hug, first loosely", ""),
    ],
)
def test_names_are_found(text: str, expected: str) -> None:
    assert " ".join(f"{m.person}:{text[m.start : m.end]}" for m in mentions(text)) == expected


def test_a_token_says_whom_it_names() -> None:
    named, plain = packaged_encoder("minilm-names"), packaged_encoder("minilm-tokens")
    assert named is not None
    assert plain is not None
    sentences = ["Person A pushes the second one.", "They hug.", "A pushes B " + "hard " * 60]
    vectors = named.encode(sentences).reshape(3, 40, 385)
    np.testing.assert_array_equal(
        vectors[..., :-1], plain.encode(sentences).reshape(3, 40, 384), "the rest has changed"
    )
    # [CLS] person a pushes the second one . [SEP]
    assert (vectors[0, :9, -1] / NAMING).tolist() == [0, 1, 1, 0, -1, -1, -1, 0, 0]
    assert not vectors[1, :, -1].any()
    assert (vectors[2, :5, -1] / NAMING).tolist() == [0, 1, 0, -1, 0]
    assert named.encode(["A pushes B"]).dtype == np.float32
