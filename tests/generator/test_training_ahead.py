"""Batches that are made ready ahead of the step that learns from them."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from generator.data import Batch
from generator.training.ahead import ahead
from robots.errors import MotionFileError


def numbered(number: int) -> Batch:
    empty = np.zeros((1, 1, 2), np.float32)
    return Batch(empty, empty[..., 0], np.array([1]), (f"sentence {number}",), (str(number),))


def test_batches_keep_their_order_and_their_sentences_are_read_first() -> None:
    read: list[str] = []
    names = []
    for batch in ahead(map(numbered, range(20)), read.extend, depth=2):
        assert batch.texts[0] in read
        names.append(batch.names[0])
    assert names == [str(number) for number in range(20)]


def test_what_goes_wrong_while_reading_ahead_is_raised_at_its_turn() -> None:
    def broken() -> Iterator[Batch]:
        yield numbered(0)
        raise MotionFileError("cut short", where="clip 1")

    batches = ahead(broken(), len)
    assert next(batches).names == ("0",)
    with pytest.raises(MotionFileError, match="cut short"):
        next(batches)


def test_an_encoder_that_fails_stops_training_instead_of_leaving_it_waiting() -> None:
    def fails(_: Sequence[str]) -> None:
        raise RuntimeError("no encoder")

    with pytest.raises(RuntimeError, match="no encoder"):
        next(ahead(map(numbered, range(3)), fails))


def test_reading_ahead_ends_when_nobody_asks_any_more() -> None:
    before = threading.active_count()
    batches = ahead(map(numbered, range(10**9)), len, depth=1)
    next(batches)
    assert threading.active_count() == before + 1
    batches.close()
    assert threading.active_count() == before
