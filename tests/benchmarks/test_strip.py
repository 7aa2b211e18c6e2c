"""The README's picture: which moments it shows, and how it is laid out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.strip import COLUMNS, EDGE, GAP, MOMENTS, joined, load_panels, picture
from generator.choreographer import choreograph
from generator.text import understand
from robots.errors import SpecError
from sim.gl import choose_backend


def test_eight_different_interactions_are_asked_for(tmp_path) -> None:
    panels = load_panels()
    meanings = [understand(panel.text) for panel in panels]
    assert all(meaning.known for meaning in meanings)
    assert len({meaning.interaction for meaning in meanings}) == len(panels) == 8
    wrong = tmp_path / "strip.toml"
    wrong.write_text('[[panel]]\ntext = "they bow"\nmoment = "lowest"\n')
    with pytest.raises(SpecError, match="lowest"):
        load_panels(wrong)


def test_the_moment_is_the_one_that_tells_most() -> None:
    shake = choreograph("handshake", seed=0)
    for motion in (shake, replace(shake, contacts=())):
        index = int(np.argmax(MOMENTS["touch"](motion)))
        gap = motion.a.point("right_hand")[index] - motion.b.point("right_hand")[index]
        assert np.linalg.norm(gap) < 0.1
    kick = choreograph("kick", seed=0)
    index = int(np.argmax(MOMENTS["kick"](kick)))
    assert max(p.point("right_foot")[index, 2] for p in kick.people) > 0.5
    propose = choreograph("propose", seed=0)
    index = int(np.argmax(MOMENTS["low"](propose)))
    heads = [person.point("head")[:, 2] for person in propose.people]
    assert min(h[index] for h in heads) < min(h.min() for h in heads) + 0.05


def test_panels_stand_in_rows_with_their_sentences_below() -> None:
    frame = np.full((EDGE, EDGE, 3), 200, np.uint8)
    drawn = joined([("two people wave", frame)] * (COLUMNS + 1))
    assert drawn.shape[1] == COLUMNS * (EDGE + GAP) - GAP
    below = drawn.shape[0] // 2 - EDGE
    assert (drawn[:EDGE, :EDGE] == 200).all()
    assert (drawn[EDGE : EDGE + below, :EDGE] < 60).any(), "no sentence"
    assert (drawn[EDGE + below :, EDGE:] == 255).all(), "the second row has one panel"


@pytest.mark.gl
@pytest.mark.slow
def test_a_panel_shows_both_people() -> None:
    if choose_backend() == "disable":
        pytest.skip("no offscreen OpenGL")
    frame = picture(choreograph("high_five", seed=0), "touch").astype(int)
    red, blue = frame[..., 0] - frame[..., 2], frame[..., 2] - frame[..., 0]
    assert (red[:, : EDGE // 2] > 60).mean() > 0.05, "person a on the left"
    assert (blue[:, EDGE // 2 :] > 60).mean() > 0.05, "person b on the right"
