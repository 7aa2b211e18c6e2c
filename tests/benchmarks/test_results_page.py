"""What is compared and how the page tells it: rows, ablations, tables, targets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch

from benchmarks.results.ablations import load_ablations, train_all, trained_steps
from benchmarks.results.measure import mean_of
from benchmarks.results.rows import Row, load_plan
from benchmarks.results.table import MISSING, Column, cell, pages
from benchmarks.results.targets import target_lines
from generator.training import lessons
from generator.training.config import parse
from robots.errors import SpecError

PAGE = Path(__file__).parents[2] / "docs" / "results.md"


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def test_every_row_of_the_plan_can_be_looked_up():
    plan = load_plan()
    assert plan.chosen(None) == plan.row
    (one,) = plan.chosen(["choreographer"])
    assert one.kind == "choreographer"
    with pytest.raises(SpecError, match="choreographer"):
        plan.chosen(["coreographer"])
    names = {v.name for v in load_ablations().variant}
    folder = load_ablations().folder
    trained = {r.folder for r in plan.row if r.folder.startswith(folder)}
    assert trained == {f"{folder}/{name}" for name in names}, "what is trained is measured"
    for row in plan.row:
        for split in row.splits:
            assert plan.size(split).chunks * plan.protocol.chunk >= 300, "for Diversity"


def test_an_ablation_changes_what_it_says_and_nothing_else():
    ablations = load_ablations()
    base = ablations.run(ablations.variant[0]).tables()
    changed = {}
    for variant in ablations.variant[1:]:
        tables = ablations.run(variant).tables()
        changed[variant.name] = {
            f"{table}.{key}": value
            for table in ("model", "objective", "data", "training", "text")
            for key, value in tables[table].items()
            if base[table][key] != value
        }
    assert changed == {
        "canonical": {"model.representation": "canonical"},
        "concat": {"model.conditioning": "concat"},
        "unshared": {"model.share_weights": False},
        "without-dm": {"objective.distance_map": 0.0},
        "without-ro": {"objective.relative_orientation": 0.0},
        "none": {"objective.regularisation": 0.0},
        "t03": {"objective.damping": 0.3},
        "t10": {"objective.damping": 1.0},
        "once": {"training.cycles": 1},
    } | {
        name: {"data.source": changed[name]["data.source"], "training.cycles": 1}
        for name in ("real", "raw", "repaired")
    }


def test_one_clip_in_ten_is_real() -> None:
    ablations = load_ablations()
    (variant,) = (v for v in ablations.variant if v.real)
    *invented, real = ablations.run(variant).data.source
    assert (real.kind, real.root) == ("duets", ablations.real)
    assert {source.kind for source in invented} == {"choreographed"}
    weights = [source.weight for source in (*invented, real)]
    assert weights[-1] / sum(weights) == pytest.approx(0.1)


def test_what_there_are_no_clips_for_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ablations = load_ablations()
    tables = {"data": {"source": [{"kind": "duets", "root": "nowhere"}]}, "training": {"steps": 5}}
    monkeypatch.setattr(type(ablations), "run", lambda self, variant: parse(tables))
    said: list[str] = []
    assert train_all(ablations, only=["real"], say=said.append)
    assert said == ["real: there is no nowhere yet, left out"]


@dataclass
class Small:
    """Ablations of one variant, at a size that a test can afford."""

    folder: str
    cache: str
    steps: int = 4

    @property
    def variant(self) -> tuple[Any, ...]:
        return load_ablations().variant[:1]

    def run(self, variant: Any) -> Any:
        run = load_ablations().run(variant)
        data = replace(
            run.data, cache=self.cache, source=(replace(run.data.source[0], count=2),), frames=20
        )
        model = replace(run.model, width=16, layers=1, heads=2, feedforward=16)
        training = replace(run.training, batch=2, steps=self.steps, cycles=1, warmup_steps=1)
        text = replace(run.text, lessons=2)
        return replace(run, data=data, model=model, text=text, training=training)


def test_ablations_stop_when_told_and_go_on_where_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(lessons, "POOL", 40)
    small: Any = Small(str(tmp_path / "runs"), str(tmp_path / "cache"))
    asked = iter([False, False, True, True])
    assert not train_all(small, stop=lambda: next(asked))
    assert trained_steps(tmp_path / "runs" / "base") == 2
    said: list[str] = []
    assert train_all(small, say=said.append)
    assert trained_steps(tmp_path / "runs" / "base") == 4
    said.clear()
    assert train_all(small, say=said.append)
    assert not said, "what is trained is not trained again"


def test_the_page_has_every_table_and_invents_nothing():
    plan = load_plan()
    texts = pages(plan, [])
    page = PAGE.read_text(encoding="utf-8")
    for name, text in texts.items():
        assert f"<!-- {name} -->" in page
        assert f"<!-- /{name} -->" in page
        if name == "made":
            assert text.strip() == MISSING
            continue
        figures_from = 2 if name == "targets" else 1
        for line in text.strip().split("\n")[2:]:
            cells = [part.strip() for part in line.strip("|").split("|")]
            assert cells[0]
            assert set(cells[figures_from:]) == {MISSING}, line
    assert page.count("<!-- /") == len(texts)


def test_targets_are_kept_or_fallen_short_of():
    row = Row(name="net", kind="model", folder="somewhere")
    records = [
        {"row": name, "split": split, "figures": figures}
        for name, split, figures in (
            ("ground truth", "sentences", {"class": 0.9}),
            ("net", "sentences", {"class": 0.8}),
            ("net", "sentences", {"class": 0.7}),
            ("net", "test", {"met": 0.85, "bones": 0.006, "jerk": 3.0}),
        )
    ]
    (_, *names), *lines = target_lines([row], records, MISSING)
    assert names == ["target", "net"]
    cells = {name: cell for name, _, cell in lines}
    assert cells["right interaction, of ground truth's (sentences)"] == "0.83 **short**"
    assert cells["hands meet (test)"] == "85.00 % ok"
    assert cells["bones (test)"] == "0.60 % **short**"
    assert cells["jerk, of ground truth's (test)"] == MISSING, "there is no ground truth yet"


def test_cells_say_mean_interval_or_that_there_is_none():
    column = Column("x", "x", 1, 100)
    records = [{"figures": {"x": value}} for value in (0.1, 0.2, None)]
    assert cell([], column) == MISSING
    assert cell(records[2:], column) == ""
    assert cell(records[:1], column) == "10.0"
    assert cell(records, column) == "15.0 ± 6.9"
    assert mean_of([None]) is None
