"""Whether simulated people manage what is drawn: measured once, by the physics that users have."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.results import takes
from benchmarks.results.clips import HeldOut
from benchmarks.results.models import Models
from benchmarks.results.performed import NAMES, performed
from benchmarks.results.rows import Protocol, Row
from benchmarks.results.takes import Makers, Order
from generator.data import Choreographed
from generator.motion import Motion

ROW = Row(name="low", kind="data", decoded=True, performed=True)


@pytest.mark.slow
def test_a_performance_is_good_enough_and_is_simulated_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    asked, chunk = HeldOut("test", 7.5, 75, tmp_path / "clips", 1).chunk(0)
    makers = Makers(tmp_path / "takes", Protocol(chunk=1), Models(7.5))
    order = Order("one", asked, [asked[0].text(0)], [[0]], chunk)
    found = makers.performed(ROW, order)
    (figures,) = found.figures
    assert set(figures) == set(NAMES)
    assert (figures["passed"], figures["upright"]) == (1, 1)
    assert figures["off"] is not None
    assert 1 < figures["off"] < 60
    assert np.array_equal(found.features[0], chunk.features[0])
    monkeypatch.setattr(takes, "performed", None)
    assert makers.performed(ROW, order).figures == found.figures


@pytest.mark.slow
def test_who_is_thrown_across_the_room_does_not_keep_their_feet():
    motion = Choreographed(1).motion(0)
    a, b = (
        Motion(p.fps, p.keypoints[:30], np.asarray(p.rotations)[:30], skeleton=p.skeleton)
        for p in motion.people
    )
    points = b.keypoints.copy()
    points[15:, :, 0] += 3.0
    figures = performed(replace(motion, a=a, b=replace(b, keypoints=points), contacts=()))
    assert (figures["passed"], figures["upright"]) == (0, 0)
