"""Training, evaluating and generating with InterGen from the command line."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bridge.cli import main
from generator.choreographer import choreograph
from generator.io import read_motion, write_motion
from generator.motion import DuetMotion
from robots.files import read_archive

torch = pytest.importorskip("torch")

STEPS, EVERY = 60, 5
CONFIG = """
name = "test"
[model]
width = 16
layers = 1
heads = 2
feedforward = 16
dropout = {dropout}
[data]
cache = "{cache}"
frames = 12
[[data.source]]
kind = "duets"
root = "{duets}"
[training]
batch = 4
steps = {steps}
warmup_steps = 5
learning_rate = 1e-3
[checkpoint]
steps = {every}
[log]
steps = 5
tensorboard = false
"""


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two duets of the choreographer below ``duets``."""
    root = tmp_path_factory.mktemp("train")
    for name in ("wave", "bow"):
        write_motion(choreograph(name, seed=0), root / "duets" / f"{name}.npz")
    return root


def config_file(clips: Path, name: str, *, dropout: float = 0.1, steps: int = STEPS) -> Path:
    path = clips / name
    text = CONFIG.format(
        cache=clips / "cache", duets=clips / "duets", dropout=dropout, steps=steps, every=EVERY
    )
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def trained(clips: Path) -> Path:
    """A model that was trained without interruption."""
    out = clips / "whole"
    assert main(["train", str(config_file(clips, "run.toml")), "-o", str(out)]) == 0
    return out


def command(*arguments: str | Path) -> list[str]:
    program = "import sys; from bridge.cli import main; sys.exit(main(sys.argv[1:]))"
    return [sys.executable, "-c", program, *map(str, arguments)]


def state_of(out: Path) -> tuple[int, dict]:
    from generator.weights import load_weights

    header, tensors = load_weights(out / "state")
    return header["step"], tensors


def log_of(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]


def step_of(out: Path) -> int:
    try:
        return json.loads((out / "state" / "model.json").read_text())["step"]
    except FileNotFoundError:
        return 0


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_bits(clips: Path, trained: Path, tmp_path: Path) -> None:
    """SIGKILL at any moment loses at most the steps since the last checkpoint, and no bit."""
    config = clips / "run.toml"
    process = subprocess.Popen(
        command("train", config, "-o", tmp_path), stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        limit = time.monotonic() + 120
        while step_of(tmp_path) < 3 * EVERY and process.poll() is None:
            assert time.monotonic() < limit
            time.sleep(0.002)
    finally:
        process.kill()
    assert process.wait() == -signal.SIGKILL
    reached = step_of(tmp_path)
    assert 3 * EVERY <= reached < STEPS
    assert main(["train", str(config), "-o", str(tmp_path), "--resume"]) == 0
    (whole, expected), (steps, found) = state_of(trained), state_of(tmp_path)
    assert whole == steps == STEPS
    assert expected.keys() == found.keys()
    for name, value in expected.items():
        assert torch.equal(value, found[name]), name
    logs = [
        [(entry["step"], entry["total"], entry["simple"]) for entry in log_of(out)]
        for out in (trained, tmp_path)
    ]
    assert logs[0] == logs[1]


@pytest.mark.slow
def test_a_stopped_run_saves_and_says_so(clips: Path, tmp_path: Path) -> None:
    config = config_file(clips, "long.toml", steps=100_000)
    process = subprocess.Popen(
        command("train", config, "-o", tmp_path, "--json"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("step "):
            break
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    result = json.loads(out)
    assert not result["finished"]
    assert result["steps"] == step_of(tmp_path) > 0


@pytest.mark.slow
def test_two_processes_learn_what_one_learns(clips: Path, tmp_path: Path) -> None:
    """Two processes with half a batch each, joined by gloo, against one with the whole batch."""
    config = config_file(clips, "shared.toml", dropout=0.0, steps=12)
    assert main(["train", str(config), "-o", str(tmp_path / "one")]) == 0
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    processes = [
        subprocess.Popen(
            command("train", config, "-o", tmp_path / "two"),
            env={
                **os.environ,
                "RANK": str(rank),
                "LOCAL_RANK": str(rank),
                "WORLD_SIZE": "2",
                "MASTER_ADDR": "127.0.0.1",
                "MASTER_PORT": str(port),
            },
        )
        for rank in range(2)
    ]
    try:
        assert [process.wait(timeout=200) for process in processes] == [0, 0]
    finally:
        for process in processes:
            process.kill()
    (_, one), (_, two) = state_of(tmp_path / "one"), state_of(tmp_path / "two")
    for name, value in one.items():
        if name.startswith("weights."):
            torch.testing.assert_close(two[name], value, rtol=1e-4, atol=2e-5)
    first, second = (log_of(tmp_path / name)[-1] for name in ("one", "two"))
    assert second["total"] == pytest.approx(first["total"], rel=1e-4)


def test_wrong_usage_is_one_line_and_exit_2(clips: Path, tmp_path: Path, capsys) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(config_file(clips, "x.toml").read_text().replace("warmup_steps", "warmup_step"))
    assert main(["train", str(path), "-o", str(tmp_path / "o")]) == 2
    error = capsys.readouterr().err
    assert "warmup_step" in error
    assert "did you mean 'warmup_steps'" in " ".join(error.split())
    assert not (tmp_path / "o").exists()
    assert main(["train", str(clips / "x.toml"), "--threads", "0"]) == 2
    assert main(["evaluate", str(tmp_path)]) == 2
    assert main(["generate", "hug", "--generator", "intergen"]) == 2
    assert "--weights" in capsys.readouterr().err


def test_a_run_is_not_overwritten(clips: Path, trained: Path, capsys) -> None:
    assert main(["train", str(clips / "run.toml"), "-o", str(trained)]) == 2
    assert "--resume" in capsys.readouterr().err


FEW = ("--steps", "3", "--threads", "1")


def generate(trained: Path, out: Path, text: str, *options: str | Path) -> dict:
    arguments = ["generate", text, "--generator", "intergen", "--weights", trained, "-o", out]
    assert main([*map(str, arguments), *FEW, *map(str, options)]) == 0
    motion = read_motion(out)
    header, _ = read_archive(out, header_only=True)
    assert header is not None
    return {"keypoints": motion.keypoints, "motion": motion}


def test_a_sentence_becomes_a_motion(trained: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "m.npz"
    made = generate(trained, out, "two people wave", "--frames", "20", "--seed", "3", "--json")
    facts = json.loads(capsys.readouterr().out)
    assert (facts["generator"], facts["model"], facts["frames"]) == ("intergen", "test", 20)
    assert made["motion"].text == "two people wave"
    assert made["motion"].source == "test"
    again = generate(
        trained, tmp_path / "n.npz", "two people wave", "--frames", "20", "--seed", "3"
    )
    assert np.array_equal(again["keypoints"], made["keypoints"])


def breathing(motion: DuetMotion) -> float:
    """Return by how much bones change their length, m."""
    parents = list(motion.a.skeleton.parents[1:])
    bones = motion.keypoints[:, :, 1:] - motion.keypoints[:, :, parents]
    return float(np.ptp(np.linalg.norm(bones, axis=-1), axis=0).max())


def test_a_finished_run_leaves_a_model_that_runs_without_torch(
    clips: Path, trained: Path, tmp_path: Path, capsys
) -> None:
    portable, out = tmp_path / "portable", tmp_path / "m.npz"
    again = ["train", clips / "run.toml", "-o", trained, "--resume", "--portable", portable]
    assert main([*map(str, again), "--precision", "int8", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["portable"] == str(portable)
    request = ["generate", "they bow", "--generator", "diffusion", "--weights", portable]
    assert main([*map(str, request), "-o", str(out), "--steps", "2", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["generator"], facts["model"], facts["steps"]) == ("diffusion", "test", 2)
    assert facts["frames"] == 12, "longer than what was learnt"
    assert facts["finishing"]["moved"] > 0
    whole = read_motion(out)
    assert main([*map(str, request), "-o", str(out), "--steps", "2", "--raw"]) == 0
    raw = read_motion(out)
    assert (raw.source, raw.licence) == (whole.source, whole.licence)
    assert breathing(whole) < 1e-6 < 1e-3 < breathing(raw)
    assert main([*map(str, request), "-o", str(out), "--steps", "2", "--then", "they wave"]) == 0
    assert read_motion(out).text == "they bow, then they wave"
    assert read_motion(out).source == "test"
    for wrong, said in (
        (["--given", str(out)], "--given"),
        (["--round", "they wave"], "--generator intergen"),
        (["--tempo", "3"], "0.6 to 1.4"),
        (["--like", "no such file"], "seed"),
        (["--weights", str(trained)], "pasdedeux pack"),
    ):
        assert main([*map(str, request), "-o", str(out), *wrong]) == 2
        assert said in capsys.readouterr().err


def test_the_applications_keep_what_is_given(clips: Path, trained: Path, tmp_path: Path) -> None:
    source = clips / "duets" / "wave.npz"
    given = read_motion(source).keypoints
    for person, at in (("a", 0), ("b", 1)):
        made = generate(
            trained, tmp_path / "p.npz", "they bow", "--given", source, "--given-person", person
        )["keypoints"]
        assert np.abs(made[:, at] - given[:, at]).max() < 1e-6
        assert np.abs(made[:, 1 - at] - given[:, 1 - at]).max() > 0.01
    path = tmp_path / "path.csv"
    path.write_text("time,x,y\n0,0.5,0\n1,1.5,0.5\n")
    made = generate(trained, tmp_path / "t.npz", "walk", "--path-b", path)["keypoints"]
    line = np.stack([np.linspace(0.5, 1.5, 31), np.linspace(0, 0.5, 31)], axis=1)
    assert np.abs(made[:, 1, 0, :2] - line).max() < 1e-6
    options = ("--start", f"{source}@0:0.5", "--end", f"{source}@1:1.5", "--seconds", "2")
    for text, more in (("they hug", ("--round", "they bow")), ("", ())):
        made = generate(trained, tmp_path / "i.npz", text, *options, *more)["keypoints"]
        assert np.abs(made[:16] - given[:16]).max() < 1e-6
        assert np.abs(made[-16:] - given[30:46]).max() < 1e-6


def test_an_evaluation_runs_on_a_trained_model(clips: Path, trained: Path, capsys) -> None:
    data = ("--data", f"duets:{clips / 'duets'}", "--cache", clips / "cache", "--threads", "1")
    few = ("--repetitions", "2", "--steps", "2", "--evaluator-steps", "2", "--multimodality", "0")
    capsys.readouterr()
    assert main([*map(str, ("evaluate", trained, *data, *few)), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report["rows"]) == ["ground truth", "model"]
    assert report["clips"] == 2
    assert report["rows"]["model"]["paper"]["fid"]["runs"] == 2
    assert json.loads((trained / "evaluation" / "evaluation.json").read_text()) == report
    assert (trained / "evaluator" / "model.json").is_file()
    assert main([*map(str, ("evaluate", trained, *data, *few))]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "MM Dist" in shown
    assert "release scale: 2 clips, 2 repetitions, pools of 96" in shown


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["generate", "--help"], ["train", "--help"], ["evaluate", "--help"],
     ["generate", "two people wave", "--generator", "choreographer", "-o", "OUT"], ["robots"]],
)  # fmt: skip
def test_torch_stays_out_of_what_does_not_need_it(arguments: list[str], tmp_path: Path) -> None:
    arguments = [str(tmp_path / "m.npz") if a == "OUT" else a for a in arguments]
    program = (
        "import sys\nfrom bridge.cli import main\n"
        "try: main(sys.argv[1:])\nexcept SystemExit: pass\n"
        "sys.exit(9 if 'torch' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
