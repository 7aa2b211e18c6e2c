"""What docs/results.md shows is what was measured."""

from __future__ import annotations

from pathlib import Path

from benchmarks.results.rows import load_plan
from benchmarks.results.run import KEPT, open_results
from benchmarks.results.table import latest, pages
from generator.evaluator import load_evaluator

ROOT = Path(__file__).parents[2]


def test_the_page_is_made_of_the_results_that_are_kept():
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    records = latest(open_results(KEPT).read().values())
    for name, text in pages(load_plan(), records).items():
        if name != "spectra":  # those of real clips are not kept
            assert f"<!-- {name} -->\n\n{text.strip()}\n\n<!-- /{name} -->" in page, name


def test_the_judges_that_are_kept_can_be_read():
    (folder,) = (KEPT / "judges").iterdir()
    assert load_evaluator(folder / "evaluator").config.width == 128
    assert (folder / "classifier" / "model.json").is_file()
