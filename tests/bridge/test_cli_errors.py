"""Bad input at the command line: a one-line reason, the right exit code, nothing half-written."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from bridge.cli import main
from generator.choreographer import choreograph
from generator.io import write_motion

TRACK = ("track", "--controller", "assist")
"""Quick; which controller it is does not matter here."""


@pytest.fixture(scope="module")
def motion_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("motion") / "motion.npz"
    write_motion(choreograph("wave", seed=1), path)
    return path


def complain(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    """Run the command; return its status and the one line that it complains with."""
    status = main(arguments)
    err = capsys.readouterr().err
    lines = [line for line in err.splitlines() if line.startswith("pasdedeux:")]
    assert "Traceback" not in err
    assert len(lines) == 1, err
    return status, lines[0]


def bad_files(folder: Path, good: Path) -> dict[str, tuple[Path, str]]:
    """Write one file of each kind of badness; return it with a word its reason must hold."""
    files: dict[str, tuple[Path, str]] = {}
    truncated = folder / "truncated.npz"
    truncated.write_bytes(good.read_bytes()[:2000])
    files["truncated"] = truncated, "cut off"
    greedy = folder / "greedy_a.bvh"
    for path in (greedy, folder / "greedy_b.bvh"):
        path.write_text(
            "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition"
            " Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\n"
            "Frames: 1000000000\nFrame Time: 0.0333\n0 0 0 0 0 0\n"
        )
    files["greedy"] = greedy, "1000000000"
    pickled = folder / "pickled.pkl"
    pickled.write_bytes(pickle.dumps({"a": [1, 2, 3]}))
    files["pickled"] = pickled, "pickle"
    tiny = folder / "tiny.npy"
    np.save(tiny, np.zeros((30, 2, 3, 3)))
    files["tiny"] = tiny, "22"
    joints = choreograph("wave", seed=1).keypoints
    joints[17, 0, 5] = np.nan
    broken = folder / "broken.npy"
    np.save(broken, joints)
    files["broken"] = broken, "frame 17"
    files["absent"] = folder / "absent.npz", "no such file"
    return files


@pytest.mark.parametrize("kind", ["truncated", "greedy", "pickled", "tiny", "broken", "absent"])
@pytest.mark.parametrize("verb", ["run", "track", "retarget", "score"])
def test_a_bad_motion_file_is_refused_in_one_line(
    kind: str,
    verb: str,
    motion_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path, word = bad_files(tmp_path, motion_file)[kind]
    out = tmp_path / "out"
    status, line = complain(
        capsys, verb, str(path), "-o", str(out), "--fps", "30", "--up", "z", "--scale", "1"
    )
    assert status == 2
    assert word in line
    assert str(path) in line
    assert not out.exists() or not list(out.iterdir())


def test_a_missing_robot_is_refused_before_any_work(
    motion_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for verb in ("retarget", "run"):
        status, line = complain(
            capsys, verb, str(motion_file), "--robot", "op4", "-o", str(tmp_path / "out")
        )
        assert status == 2
        assert "op4" in line
        assert "op3" in line
        assert not (tmp_path / "out").exists()


def test_a_sentence_outside_the_repertoire_names_the_nearest_and_exits_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.npz"
    text = "the stock market fell by three percent on monday"
    words = ["generate", text, "-o", str(out)]  # by whichever generator is the default
    status, line = complain(capsys, *words)
    assert status == 1
    assert "--nearest" in line
    assert not out.exists()
    assert main([*words, "--nearest"]) == 0
    assert out.exists()


def test_an_error_under_json_is_one_json_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["track", str(tmp_path / "absent.npz"), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["error"]["type"] == "MotionFileError"


def test_an_unknown_verb_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["dance"])
    assert stop.value.code == 2
    assert "invalid choice" in capsys.readouterr().err


def test_generate_json_tells_what_was_understood(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.npz"
    words = ["generate", "two people shake hands", "--generator", "choreographer"]
    assert main([*words, "-o", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["generator"] == "choreographer"
    assert told["interaction"] == "handshake"
    assert 0.5 < told["confidence"] <= 1
    assert told["frames"] > 60
    assert {c["a"] for c in told["contacts"]} == {"right_hand"}


@pytest.fixture(scope="module")
def trajectory_files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("trajectories")
    write_motion(choreograph("bow", seed=1), folder / "motion.npz")
    assert (
        main(["retarget", str(folder / "motion.npz"), "-o", str(folder), "--robot", "marionette"])
        == 0
    )
    return [str(folder / f"trajectory-{person}.npz") for person in "ab"]


def test_an_unreachable_port_is_a_hardware_fault_and_leaves_no_telemetry(
    trajectory_files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The header of a performance that never began used to stay behind."""
    report = passing_report(trajectory_files, tmp_path)
    out = tmp_path / "telemetry.jsonl"
    words = ["play", *trajectory_files, "--report", report, "-o", str(out)]
    ports = ["--port", "/dev/tty-nowhere-1", "/dev/tty-nowhere-2"]
    status, line = complain(capsys, *words, *ports, "--arm")
    assert status == 3
    assert "/dev/tty-nowhere-1" in line
    assert line.count("No such file") == 1
    assert not out.exists()
    status, line = complain(capsys, *words, *ports)
    assert status == 1
    assert "--arm" in line


def passing_report(trajectory_files: list[str], folder: Path) -> str:
    """Write the report that these trajectories need."""
    motion = Path(trajectory_files[0]).parent / "motion.npz"
    assert main([*TRACK, str(motion), "-o", str(folder / "rollout.npz")]) == 0
    assert main(["score", str(folder / "rollout.npz"), "-o", str(folder / "report.json")]) == 0
    return str(folder / "report.json")


def test_nothing_is_played_without_a_report_or_with_that_of_another_motion(
    trajectory_files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, line = complain(capsys, "play", *trajectory_files, "-o", str(tmp_path / "t.jsonl"))
    assert status == 1
    assert "report" in line
    write_motion(choreograph("bow", seed=2), tmp_path / "motion.npz")
    assert main([*TRACK, str(tmp_path / "motion.npz"), "-o", str(tmp_path)]) == 0
    assert main(["score", str(tmp_path / "rollout.npz"), "-o", str(tmp_path)]) == 0
    capsys.readouterr()
    report = str(tmp_path / "report.json")
    status, line = complain(
        capsys, "play", *trajectory_files, "--report", report, "-o", str(tmp_path / "t.jsonl")
    )
    assert status == 1
    assert "another motion" in line
