"""The whole way, as a person runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bridge.cli import main
from bridge.trajectory import JointTrajectory
from generator.choreographer import choreograph
from generator.io import read_motion, write_motion
from robots.files import read_archive
from sim.gl import choose_backend

FILES = {
    "motion.npz",
    "rollout.npz",
    "report.json",
    "trajectory-a.npz",
    "trajectory-b.npz",
    "telemetry.jsonl",
    "video.mp4",
    "picture.png",
    "summary.json",
}
TOUCHING = ("handshake", "high_five", "fist_bump", "circle_dance", "pass_object", "waltz")
FAMILIAR = (
    *TOUCHING,
    *("wave", "bow", "beckon", "hug", "push", "box", "mirror_dance", "walk_together"),
    *("help_up", "twirl", "tug_of_war", "cha_cha"),
)
"""Some interactions of every kind; each takes seconds."""
COMPOSED = ("--generator", "choreographer")
"""Whatever model ships."""
ASSIST = ("--controller", "assist")
"""Quick; which controller it is does not matter here."""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo") / "out"
    words = ["run", "two people shake hands", *COMPOSED, "-o", str(out), "--seed", "3", *ASSIST]
    assert main(words) == 0
    return out


@pytest.mark.slow
@pytest.mark.realtime
def test_run_leaves_every_file(demo: Path) -> None:
    left = {path.name for path in demo.iterdir()}
    wanted = FILES if choose_backend() != "disable" else FILES - {"video.mp4", "picture.png"}
    assert wanted <= left


@pytest.mark.slow
@pytest.mark.realtime
def test_summary_says_how_every_stage_went(demo: Path) -> None:
    summary = json.loads((demo / "summary.json").read_text())
    assert summary["motion"]["interaction"] == "handshake"
    assert summary["motion"]["generator"] == "choreographer"
    assert summary["report"]["passed"] is True
    assert summary["retargeting"]["contact_recall"] >= 0.9
    for robot in ("a", "b"):
        assert 0 < summary["performance"]["rms_deg"][robot] < 10


def same(one: Path, other: Path) -> None:
    """Check that two archives hold the same arrays."""
    first, second = read_archive(one)[1], read_archive(other)[1]
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


@pytest.mark.slow
@pytest.mark.realtime
def test_every_stage_alone_gives_what_run_gives(demo: Path, tmp_path: Path) -> None:
    def go(*arguments: str | Path) -> None:
        assert main([str(word) for word in arguments]) == 0

    words = ("generate", "two people shake hands", *COMPOSED)
    go(*words, "--seed", "3", "-o", tmp_path / "motion.npz")
    same(tmp_path / "motion.npz", demo / "motion.npz")
    go("track", tmp_path / "motion.npz", "-o", tmp_path, *ASSIST)
    same(tmp_path / "rollout.npz", demo / "rollout.npz")
    go("score", tmp_path / "rollout.npz", "-o", tmp_path / "report.json")
    assert json.loads((tmp_path / "report.json").read_text()) == json.loads(
        (demo / "report.json").read_text()
    )
    go("retarget", tmp_path / "motion.npz", "-o", tmp_path)
    for name in ("trajectory-a.npz", "trajectory-b.npz"):
        same(tmp_path / name, demo / name)
    go(
        *("play", tmp_path / "trajectory-a.npz", tmp_path / "trajectory-b.npz"),
        *("--report", tmp_path / "report.json", "-o", tmp_path / "telemetry.jsonl"),
    )
    assert (tmp_path / "telemetry.jsonl").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.realtime
def test_real_mocap_goes_the_whole_way(duets: Path, tmp_path: Path) -> None:
    clip = duets / "pseudo" / "cmu_18_01_handshake_sym.npz"
    motion = read_motion(clip)
    hands = motion.a.point("right_hand") - motion.b.point("right_hand")
    assert np.linalg.norm(hands, axis=1).min() < 0.05
    assert main(["run", str(clip), "-o", str(tmp_path), "--no-video", *ASSIST]) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["retargeting"]["contact_recall"] >= 0.9
    assert summary["performance"]["rms_deg"].keys() == {"a", "b"}


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIAR)
def test_interaction_is_retargeted_with_hands_that_meet(name: str, tmp_path: Path) -> None:
    write_motion(choreograph(name, seed=0), tmp_path / "motion.npz")
    assert main(["retarget", str(tmp_path / "motion.npz"), "-o", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "retargeting.json").read_text())
    assert report["limit_violations"] == 0
    if name in TOUCHING:
        assert report["contact_gap_error_max_mm"] <= 30
    for side in "ab":
        assert JointTrajectory.load(tmp_path / f"trajectory-{side}.npz").duration > 1
