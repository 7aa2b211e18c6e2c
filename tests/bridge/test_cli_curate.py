"""``pasdedeux curate`` as a person uses it; physics is an answer here (see tests/sim)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import sim.curation
from bridge.cli import main
from generator.data import Verdict
from generator.motion import DuetMotion
from sim.curation import CurationSettings

CONFIG = """
[[data.source]]
kind = "choreographed"
count = 3
seed = 7
{more}
[[data.source]]
kind = "duets"
root = "nowhere"
"""


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[CurationSettings]:
    """Every second clip is kept; the settings that physics was asked with."""
    seen: list[CurationSettings] = []

    def here(function, items, processes):
        for item in items:
            yield item, function(item)

    def judge(motion: DuetMotion, settings: CurationSettings):
        seen.append(settings)
        kept = len(seen) % 2 == 1
        figures = {
            of: dict.fromkeys(sim.curation.FIGURES, 1.0) for of in ("reference", "simulated")
        }
        verdict = Verdict(
            kept=kept,
            interaction=motion.interaction,
            reasons=() if kept else ("fell",),
            changed_mm=3.0 if kept else None,
            figures=figures,
        )
        return verdict, motion if kept else None

    monkeypatch.setattr(sim.curation, "in_processes", here)
    monkeypatch.setattr(sim.curation, "judge", judge)
    return seen


def config(folder: Path, more: str = "") -> str:
    path = folder / "run.toml"
    path.write_text(CONFIG.format(more=more))
    return str(path)


def test_choreographed_clips_are_judged_once_and_counted(
    asked: list[CurationSettings], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "curated"
    command = ["curate", config(tmp_path), "-o", str(out)]
    assert main([*command, "--limit", "2", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["kept"], facts["rejected"], facts["folder"]) == (1, 1, str(out))
    assert main([*command]) == 0
    assert len(asked) == 3, "the two were not judged again"
    shown = capsys.readouterr().out
    assert "2 of 3 clips kept" in shown
    assert "rejected for fell: 1" in shown
    assert len(list((out / "train/7").glob("*.json"))) == 3
    assert len(list((out / "train/7").glob("*.npz"))) == 2


def test_quality_says_how_the_people_plan(asked: list[CurationSettings], tmp_path: Path) -> None:
    from sim.controllers.ilqr.settings import QUALITIES

    command = ["curate", config(tmp_path), "-o", str(tmp_path / "x"), "--limit", "1"]
    for words, name in (((), "preview"), (("--quality", "normal"), "normal")):
        assert main([*command, *words]) == 0
        ilqr, planned = asked[-1].tracking.ilqr, QUALITIES[name]
        assert (ilqr.horizon, ilqr.replan, ilqr.threads) == (planned.horizon, planned.replan, 1)
    assert len(asked) == 2, "another quality is another verdict"


def test_the_folder_is_the_one_that_the_configuration_reads_from(
    asked: list[CurationSettings], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "there"
    assert main(["curate", config(tmp_path, f'repaired = "{out}"'), "--limit", "1"]) == 0
    assert len(list(out.rglob("*.json"))) == 1
    assert main(["curate", config(tmp_path)]) == 2
    assert "name it with -o" in capsys.readouterr().err


def test_a_clip_without_a_verdict_is_said_and_gives_status_1(
    asked: list[CurationSettings], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    from sim.batch import Lost

    def dies(function, items, processes):
        for item in items:
            yield item, Lost("its process died (SIGKILL)") if item.number == 1 else function(item)

    monkeypatch.setattr(sim.curation, "in_processes", dies)
    command = ["curate", config(tmp_path), "-o", str(tmp_path / "x")]
    assert main(command) == 1
    shown = capsys.readouterr().out
    assert "1.json: its process died (SIGKILL)" in " ".join(shown.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--jobs", "0"), "--jobs"), (("--limit", "0"), "--limit"), (("--quality", "ultra"), "ultra")],
)
def test_absurd_wishes_are_refused(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["curate", config(tmp_path), "-o", str(tmp_path / "x"), *words]
    try:
        status = main(command)
    except SystemExit as stopped:  # argparse knows the choices itself
        status = stopped.code
    assert status == 2
    assert said in capsys.readouterr().err


def test_a_configuration_without_invented_clips_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.toml"
    path.write_text('[[data.source]]\nkind = "duets"\nroot = "x"\n')
    assert main(["curate", str(path), "-o", str(tmp_path / "out")]) == 2
    assert "no choreographed source" in capsys.readouterr().err
