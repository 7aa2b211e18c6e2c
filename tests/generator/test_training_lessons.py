"""Reading is taught on sentences alone, before anything is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from generator.architecture import DenoiserConfig
from generator.choreographer import GESTURES
from generator.data.choreographed import clauses_of
from generator.denoiser import Denoiser
from generator.text.encoder import packaged_encoder
from generator.text.grammar import ORDINARY
from generator.text.manner import manner_of
from generator.text.mentions import mentions
from generator.training import lessons
from generator.training.lessons import deeds, lesson, teach
from generator.training.texts import TextTable

torch.set_num_threads(1)
STEPS = 50


def reading(seed: int = 0) -> Denoiser:
    torch.manual_seed(seed)
    config = DenoiserConfig(
        width=32, layers=1, heads=2, feedforward=16, dropout=0.0, text_width=40 * 385,
        text_tokens=40, text_names=True, text_layers=1, told_apart=True,
    )  # fmt: skip
    return Denoiser(config)


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> TextTable:
    monkeypatch.setattr(lessons, "POOL", 40)
    monkeypatch.setattr(lessons, "BATCH", 16)
    monkeypatch.setattr(lessons, "RATE", 5e-3)
    encoder = packaged_encoder("minilm-names")
    assert encoder is not None
    return TextTable(encoder)


def test_a_lesson_knows_what_its_sentences_say() -> None:
    found, known = lesson(150, 3, exchanges=True), deeds()
    assert found.second_leads.any()
    assert found.left.any()
    for row, text in enumerate(found.texts):
        style = manner_of(text)
        if found.second_leads[row]:
            assert style.swap or mentions(text)[0].person == "b", text
        assert found.left[row].any() == ("left" in text), text
        one, other = found.deed[row]
        if one != other:
            assert {known[one], known[other]} <= {*GESTURES}, text
        if row % lessons.EXCHANGES == 0:
            continue
        for column, (field, ordinary) in enumerate(ORDINARY.items()):
            for said in found.manner[row, :, column]:
                away = getattr(style, field) - ordinary
                assert [True, away < 0, away > 0][int(said)], (text, field)
    assert (found.deed[:, 0] != found.deed[:, 1]).mean() == pytest.approx(
        1 / lessons.EXCHANGES, abs=0.1
    )
    first = known[found.deed[1, 0]]
    unseen = {clause.words for clause in clauses_of(first, unseen=True)}
    assert not any(found.texts[1].endswith(words) for words in unseen)


def test_who_draws_no_exchanges_is_not_taught_about_them() -> None:
    found = lesson(len(deeds()), 3, exchanges=False)
    assert {*found.deed[:, 0]} == {*range(len(deeds()) - 1)}  # one of each, and nobody just stands
    assert (found.deed[:, 0] == found.deed[:, 1]).all()


def test_each_hears_first_what_they_do_themselves() -> None:
    """Loss is least where the listener's own deed comes first: a's for a, b's for b."""
    found = lesson(40, 3, exchanges=True)
    rows = np.flatnonzero(found.deed[:, 0] != found.deed[:, 1])[:1]
    told = [torch.zeros(2, 1, 2, len(deeds())), torch.zeros(2, 1),
            torch.zeros(2, 1, 2, found.manner.shape[2], 3), torch.zeros(2, 1, 2)]  # fmt: skip
    unsure = float(lessons.loss(told, found, rows))
    for person, who in enumerate(found.deed[rows[0]]):
        told[0][person, 0, 0, who] = 9.0
        told[0][1 - person, 0, 1, who] = 9.0
    assert float(lessons.loss(told, found, rows)) < unsure - 2.0
    told[0] = told[0].flip(2)
    assert float(lessons.loss(told, found, rows)) > unsure


def test_who_reads_learns_and_is_frozen_then(table: TextTable) -> None:
    denoiser, heard = reading(), []
    before = {name: p.clone() for name, p in denoiser.named_parameters()}
    teach(denoiser, table, STEPS, exchanges=True, report=lambda step, loss: heard.append(loss))
    fresh = lessons.loss(
        lessons.Pupil(reading(), len(deeds()), 5)(
            torch.from_numpy(table.vectors(lesson(40, 0, exchanges=True).texts))
        ),
        lesson(40, 0, exchanges=True),
        np.arange(40),
    )
    assert heard[-1] < 0.6 * float(fresh.detach())
    for name, parameter in denoiser.named_parameters():
        reads = "embed_text" in name or name == "listener"
        assert parameter.requires_grad != reads, name
        assert torch.equal(parameter, before[name]) != reads, name


def test_lessons_that_are_over_are_read_again_from_their_state(
    table: TextTable, tmp_path: Path
) -> None:
    one, other = reading(), reading(1)
    teach(one, table, STEPS, exchanges=True, state=tmp_path)
    teach(
        other,
        table,
        STEPS,
        exchanges=True,
        state=tmp_path,
        report=lambda *_: pytest.fail("taught again"),
    )
    assert torch.equal(one.listener, other.listener)
    for a, b in zip(one.networks[0].embed_text.parameters(),
                    other.networks[0].embed_text.parameters(), strict=True):  # fmt: skip
        assert torch.equal(a, b)


@torch.no_grad()
def test_each_reads_the_sentence_as_if_it_were_the_first(table: TextTable) -> None:
    """With the same listener, b hears of *B pushes A* what a hears of *A pushes B*."""
    denoiser = reading().eval()
    for parameter in denoiser.networks[0].embed_text.parameters():
        if parameter.dim() > 1:
            parameter.normal_(std=0.2)
    cond = torch.from_numpy(table.vectors(["The first one pushes the second one."]))
    tokens = cond.unflatten(-1, (40, -1)).clone()
    tokens[..., -1] *= -1
    heard, turned = denoiser.read(cond), denoiser.read(tokens.flatten(-2))
    torch.testing.assert_close(heard[0], turned[1])
    torch.testing.assert_close(heard[1], turned[0])
    assert (heard[0] - heard[1]).abs().max() > 0.01
