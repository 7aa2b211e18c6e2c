"""Sentences from the grammar say what the motion does, in many ways."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from generator.choreographer import Style, random_style, repertoire
from generator.text.grammar import ORDINARY, choices, describe, entry_of, grammar
from generator.text.manner import manner_of
from robots.errors import PromptError

every_interaction = pytest.mark.parametrize("name", repertoire())


def told(name: str, style: Style, number: int):
    return describe(name, style, np.random.default_rng([number, *name.encode()]))


def test_grammar_covers_exactly_the_repertoire():
    assert set(grammar()) == set(repertoire())
    assert len(repertoire()) >= 40


def test_choices_are_all_combinations():
    assert choices("a [b|c] d") == ["a b d", "a c d"]
    assert choices("[x|y] [|z]") == ["x", "x z", "y", "y z"]
    assert choices("plain") == ["plain"]


@every_interaction
def test_at_least_200_sentences_before_any_adverb(name):
    plain = {told(name, Style(swap=bool(i % 2)), i).text.lower() for i in range(900)}
    assert len(plain) >= 200


@every_interaction
def test_active_and_passive_say_who_leads(name):
    voices = {clause.voice for clause in entry_of(name).clauses}
    assert voices == {"together", "active", "passive"}
    for number in range(30):
        assert manner_of(told(name, Style(swap=True), number).text).swap
        assert not manner_of(told(name, Style(), number).text).swap


@every_interaction
def test_ordinary_style_is_read_back_as_ordinary(name):
    for number in range(20):
        assert manner_of(told(name, Style(), number).text) == Style()


@every_interaction
def test_what_is_said_of_the_style_is_read_back_in_its_direction(name):
    for number in range(30):
        style = random_style(np.random.default_rng([3, number]))
        sentence = told(name, style, number)
        read = manner_of(sentence.text)
        assert read.swap == style.swap
        if entry_of(name).handed:
            assert read.handedness == style.handedness
        for field in sentence.said:
            meant = getattr(style, field) - ORDINARY[field]
            assert meant * (getattr(read, field) - ORDINARY[field]) > 0, (field, sentence.text)


def test_same_seed_same_sentence():
    style = Style(speed=0.7)
    assert told("waltz", style, 4) == told("waltz", style, 4)
    assert told("waltz", style, 4).text != told("waltz", style, 5).text
    assert "speed" in told("waltz", style, 4).said


def test_sentences_keep_to_the_clauses_they_are_given():
    only = entry_of("hug").clauses[3:5]
    rng = np.random.default_rng(0)
    drawn = {describe("hug", Style(), rng, clauses=only).clause for _ in range(40)}
    assert drawn == set(only)


def test_unknown_interactions_and_clauses_that_cannot_say_it_are_refused():
    with pytest.raises(PromptError, match="handshak"):
        entry_of("handshak")
    together = tuple(c for c in entry_of("hug").clauses if c.voice == "together")
    with pytest.raises(PromptError, match="leads"):
        describe("hug", replace(Style(), swap=True), np.random.default_rng(0), clauses=together)
