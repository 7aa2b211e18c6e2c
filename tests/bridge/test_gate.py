"""The gate: what was judged must be what is played."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from bridge import gate
from bridge.trajectory import JointTrajectory
from robots.errors import GateRefused
from robots.files import write_json

JUDGED = "f00d"


def trajectory(seed: int) -> JointTrajectory:
    position = np.random.default_rng(seed).uniform(-1, 1, (4, 2))
    times = np.linspace(0.0, 0.3, 4)
    return JointTrajectory(times, position, ("one", "two"), "puppet", {"motion_sha256": JUDGED})


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Two trajectory files as ``retarget`` leaves them, under a report that passed."""
    from sim.report import Report

    @dataclasses.dataclass
    class Passed:
        input_sha256: str = JUDGED
        passed: bool = True

    monkeypatch.setattr(Report, "load", lambda path: Passed())
    tracks = [trajectory(0), trajectory(1)]
    paths = [tmp_path / f"trajectory-{person}.npz" for person in "ab"]
    for path, track in zip(paths, tracks, strict=True):
        track.save(path)
    write_json(tmp_path / gate.RETARGETING, {"penetration_max_mm": 0.5, **gate.vouch(tracks)})
    return paths


def judge(paths: list[Path]):
    loaded = [JointTrajectory.load(path) for path in paths]
    return gate.verdict(paths[0].with_name("report.json"), paths, loaded)


def test_files_as_they_were_written_pass(stage: list[Path]) -> None:
    verdict = judge(stage)
    assert verdict.passed
    assert verdict.overlap_mm == 0.5


@pytest.mark.parametrize("change", ["position", "times", "joint_names"])
def test_a_trajectory_changed_after_retargeting_is_refused(stage: list[Path], change: str) -> None:
    track = JointTrajectory.load(stage[1])
    position, times = track.position.copy(), track.times.copy()
    position[2, 1] += 1e-9
    changes = {"position": position, "times": times * 0.5, "joint_names": ("two", "one")}
    dataclasses.replace(track, **{change: changes[change]}).save(stage[1])
    with pytest.raises(GateRefused, match=r"trajectory-b.*trajectory of b is not the one"):
        judge(stage)


def test_exchanged_trajectories_are_refused(stage: list[Path]) -> None:
    with pytest.raises(GateRefused, match="trajectory of a is not the one"):
        judge(stage[::-1])


@pytest.mark.parametrize("text", [None, "{", "[]", '{"trajectories": {"a": "x"}}'])
def test_trajectories_that_nothing_vouches_for_are_refused(
    stage: list[Path], text: str | None
) -> None:
    record = stage[0].with_name(gate.RETARGETING)
    record.unlink() if text is None else record.write_text(text)
    with pytest.raises(GateRefused, match=r"retarget"):
        judge(stage)


def test_robots_that_overlap_unknowably_are_refused_on_metal_alone(stage: list[Path]) -> None:
    record = stage[0].with_name(gate.RETARGETING)
    facts = json.loads(record.read_text())
    del facts["penetration_max_mm"]
    record.write_text(json.dumps(facts))
    assert judge(stage).overlap_mm == float("inf")
