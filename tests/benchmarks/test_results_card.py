"""What of the results gets onto the card of a model."""

from __future__ import annotations

import pytest

from benchmarks.results.card import card
from generator.training.card import Figures
from robots.errors import SpecError
from robots.files import write_json


def record(row: str, split: str, **figures: float) -> dict:
    return {"row": row, "split": split, "figures": figures, "clips": 400, "weights": "abc"}


def test_a_model_stands_beside_the_truth_of_its_split_with_what_was_measured(tmp_path) -> None:
    records = [
        record("ground truth", "test", fid=0.02, met=1.0),
        record("net", "test", fid=0.5, met=0.8),
        record("net", "test", fid=0.7, met=0.8),
        record("other", "sentences", fid=9.0),
    ]
    write_json(tmp_path / "card.json", card("net", records))
    figures = Figures.load(tmp_path / "card.json")
    assert "abc" in figures.about
    assert "400 clips" in figures.about
    (truth, net) = figures.columns.values()
    assert (truth["FID"], net["FID"]) == ("0.020", "0.600 ± 0.139")
    assert net["hands meet, %"] == "80.0 ± 0.0"
    assert "jerk, m/s³" not in net, "it was not measured"
    assert "| FID | 0.020 | 0.600 ± 0.139 |" in figures.markdown()
    with pytest.raises(SpecError, match="ground truth, net, other"):
        card("nte", records)
