"""``pasdedeux track`` as a person uses it: one motion, many, impossible ones."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.cli import main
from bridge.cli.options import QUALITIES, add_seed, add_tracking, track_settings
from bridge.stages import CONTROLLERS
from generator.choreographer import choreograph
from generator.io import read_motion, write_motion
from generator.motion import Contact, DuetMotion, Motion
from robots.skeleton import FloatArray
from sim.rollout import Rollout

ASSIST = ("--controller", "assist")
"""Quick; which controller it is does not matter to most tests here."""


def cut(motion: DuetMotion, frames: int) -> DuetMotion:
    """Return the first frames of a motion."""
    people = [
        Motion(
            person.fps,
            person.keypoints[:frames],
            None if person.rotations is None else person.rotations[:frames],
            skeleton=person.skeleton,
        )
        for person in motion.people
    ]
    return replace(motion, a=people[0], b=people[1], contacts=())


def changed(motion: DuetMotion, change: Callable[[FloatArray], FloatArray]) -> DuetMotion:
    """Return a motion with changed keypoints of both people."""
    a, b = (Motion(p.fps, change(p.keypoints.copy()), skeleton=p.skeleton) for p in motion.people)
    return replace(motion, a=a, b=b)


@pytest.fixture(scope="module")
def wave() -> DuetMotion:
    return cut(choreograph("wave", seed=1), 16)


@pytest.fixture(scope="module")
def clip(wave: DuetMotion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "wave.npz"
    write_motion(wave, path)
    return path


def track(*words: str | Path) -> int:
    return main(["track", *map(str, words), *ASSIST])


def record(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "track.json").read_text())


def test_track_leaves_a_rollout_and_says_how_it_went(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert track(clip, "-o", tmp_path) == 0
    shown = capsys.readouterr().out
    assert "nobody fell" in shown
    assert "CPU-s" in shown
    assert {p.name for p in tmp_path.iterdir()} == {"rollout.npz", "track.json"}
    assert record(tmp_path)["success"] is True
    assert track(clip, "-o", tmp_path, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told.pop("file") == str(tmp_path / "rollout.npz")
    assert told == record(tmp_path)


def test_the_record_lies_beside_a_named_rollout(clip: Path, tmp_path: Path) -> None:
    assert track(clip, "-o", tmp_path / "deep" / "x.npz") == 0
    assert {p.name for p in (tmp_path / "deep").iterdir()} == {"x.npz", "track.json"}


def test_the_same_seed_gives_the_same_bytes(clip: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        assert track(clip, "-o", tmp_path / name, "--seed", "4") == 0
    one, two = ((tmp_path / name / "rollout.npz").read_bytes() for name in ("one", "two"))
    assert one == two


def test_what_was_simulated_is_exported_as_a_motion(
    clip: Path, wave: DuetMotion, tmp_path: Path
) -> None:
    out = tmp_path / "repaired.npz"
    assert track(clip, "-o", tmp_path / "run", "--export", out) == 0
    motion = read_motion(out)
    assert motion.kind == "simulated"
    assert motion.licence == wave.licence != ""
    assert motion.frames == wave.frames
    assert 0 < np.abs(motion.keypoints - wave.keypoints).max() < 0.1
    assert track(clip, "-o", tmp_path / "run", "--export", tmp_path / "anim" / "w.bvh") == 0
    assert {p.name for p in (tmp_path / "anim").iterdir()} == {"w_a.bvh", "w_b.bvh"}


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--export", "x.csv"), ".npz"),
        (("--push", "a 100 0 0"), "at"),
        (("--payload", "a tail 2"), "tail"),
        (("--friction", "-1"), "friction"),
        (("--assist", "-1"), "body weights"),
        (("--jobs", "0"), "1 or more"),
        (("--quality", "high"), "--controller ilqr"),
    ],
)
def test_options_that_make_no_sense_are_refused_before_any_work(
    words: tuple[str, ...],
    reason: str,
    clip: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert track(clip, "-o", tmp_path / "out", *words) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_the_controller_does_not_know_of_is_simulated_and_recorded(
    clip: Path, tmp_path: Path
) -> None:
    push = ("--push", "a 400 0 0 at 0.1 for 0.2")
    assert track(clip, "-o", tmp_path / "calm") == 0
    track(clip, "-o", tmp_path / "pushed", *push, "--mass-error", "0.1", "--assist", "0.25")
    settings = record(tmp_path / "pushed")["settings"]
    assert settings["disturbance"]["pushes"][0]["force"] == [400, 0, 0]
    assert settings["disturbance"]["mass_error"] == 0.1
    assert settings["assist"]["max_force"] == 0.25
    calm, pushed = (record(tmp_path / name)["mpjpe_global_mm"] for name in ("calm", "pushed"))
    assert pushed["a"] > 2 * calm["a"]


def test_levitating_people_fall_and_the_record_says_when(
    wave: DuetMotion, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_motion(changed(cut(wave, 16), lambda k: k + np.array([0, 0, 0.5])), tmp_path / "up.npz")
    assert track(tmp_path / "up.npz", "-o", tmp_path, "--assist", "0") == 1
    told = record(tmp_path)
    assert told["success"] is False
    assert told["fell"] == {"a": True, "b": True}
    assert 0.1 < told["fall_time_s"]["a"] < 0.5
    assert f"a fell at {told['fall_time_s']['a']:.2f} s" in capsys.readouterr().out


def test_absurd_speed_ends_with_a_record_of_why_and_the_state_before(
    wave: DuetMotion, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    away = np.arange(wave.frames)[:, None, None] * [100.0, 0, 0]
    write_motion(changed(wave, lambda k: k + away), tmp_path / "fast.npz")
    assert track(tmp_path / "fast.npz", "-o", tmp_path) == 1
    text = (tmp_path / "track.json").read_text()
    assert "NaN" not in text
    told = json.loads(text)
    assert told["finished"] is False
    assert "diverged at 0.000 s" in told["ended_because"]
    assert told["ended_because"] in " ".join(capsys.readouterr().out.split())
    assert Rollout.load(tmp_path / "rollout.npz").ended is not None


@pytest.fixture
def folder(wave: DuetMotion, tmp_path: Path) -> Path:
    """Two good motions and a damaged one."""
    for name in ("one", "two"):
        write_motion(wave if name == "one" else cut(wave, 12), tmp_path / "in" / f"{name}.npz")
    (tmp_path / "in" / "bad.npz").write_bytes(b"PK\x03\x04")
    return tmp_path / "in"


def test_every_motion_of_a_folder_gets_a_folder_and_a_damaged_one_stops_none(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert track(folder, "-o", out, "--export", "sim.npz") == 2
    for name in ("one", "two"):
        left = {p.name for p in (out / name).iterdir()}
        assert left == {"rollout.npz", "track.json", "sim.npz"}
    shown = capsys.readouterr().out
    assert "2 of 3" in shown
    assert "bad.npz" in shown
    lines = [json.loads(line) for line in (out / "track.jsonl").read_text().splitlines()]
    assert [line["status"] for line in lines] == ["failed", "tracked", "tracked"]
    (folder / "bad.npz").unlink()
    assert track(folder, "-o", out, "--json") == 0
    clips = json.loads(capsys.readouterr().out)["clips"]
    assert [c["status"] for c in clips] == ["kept", "kept"]
    assert clips[0]["mpjpe_global_mm"] == record(out / "one")["mpjpe_global_mm"]


def test_a_clip_is_done_again_when_its_motion_or_the_settings_change(
    folder: Path,
    wave: DuetMotion,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def here(function, items, processes):  # what is done matters here, not by which process
        for item in items:
            yield item, function(item)

    monkeypatch.setattr("sim.batch.in_processes", here)
    (folder / "bad.npz").unlink()

    def statuses(*words: str) -> list[str]:
        assert track(folder, "-o", tmp_path / "out", "--jobs", "1", "--json", *words) == 0
        return [c["status"] for c in json.loads(capsys.readouterr().out)["clips"]]

    assert statuses() == ["tracked", "tracked"]
    write_motion(cut(wave, 10), folder / "two.npz")
    assert statuses() == ["kept", "tracked"]
    touch = Contact("left_hand", "right_hand", 0.1, 0.2, gap=1.0)
    write_motion(replace(cut(wave, 10), contacts=(touch,)), folder / "two.npz")
    assert statuses() == ["kept", "tracked"]
    assert statuses("--seed", "1") == ["tracked", "tracked"]
    (tmp_path / "out" / "one" / "rollout.npz").unlink()
    assert statuses("--seed", "1") == ["tracked", "kept"]


@pytest.mark.slow
def test_a_killed_batch_loses_no_finished_clip(wave: DuetMotion, tmp_path: Path) -> None:
    for number in range(4):
        write_motion(cut(wave, 16 - number), tmp_path / "in" / f"{number}.npz")
    out = tmp_path / "out"
    words = ["track", tmp_path / "in", "-o", out, "--jobs", "1", *ASSIST]
    command = [sys.executable, "-m", "bridge.cli.main", *map(str, words)]
    batch = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not (out / "0" / "track.json").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    os.kill(batch.pid, signal.SIGKILL)
    batch.communicate(timeout=120)  # until the orphaned worker has ended, with the clip in hand
    finished = {
        path.parent.name: (path.stat().st_mtime_ns, json.loads(path.read_text())["success"])
        for path in out.glob("*/track.json")
    }
    assert 1 <= len(finished) < 4
    assert track(tmp_path / "in", "-o", out) == 0
    lines = [json.loads(line) for line in (out / "track.jsonl").read_text().splitlines()]
    assert {Path(c["folder"]).name for c in lines if c["status"] == "kept"} == set(finished)
    for name, (changed_at, _) in finished.items():
        assert (out / name / "track.json").stat().st_mtime_ns == changed_at


def test_several_motions_need_a_folder_and_names_of_their_own(
    clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other" / "wave.npz"
    other.parent.mkdir()
    other.write_bytes(clip.read_bytes())
    for words, reason in (
        ((clip, other, "-o", tmp_path / "x"), "two clips are called 'wave'"),
        ((clip, clip.with_name("b.npz"), "-o", tmp_path / "x.npz"), "a folder"),
        ((clip, clip.with_name("b.npz"), "--export", tmp_path / "x.npz"), "a name alone"),
        ((tmp_path, "-o", tmp_path / "x"), "no motion"),
    ):
        assert track(*words) == 2
        assert reason in capsys.readouterr().err


@pytest.mark.parametrize("quality", [None, *QUALITIES])
def test_quality_says_how_thoroughly_plans_are_made(quality: str | None) -> None:
    from sim.controllers.ilqr.settings import QUALITIES as PLANNING

    assert set(QUALITIES) == set(PLANNING)
    parser = argparse.ArgumentParser()
    add_tracking(parser)
    add_seed(parser)
    settings = track_settings(parser.parse_args(["--quality", quality] if quality else []))
    assert settings.controller == "ilqr"
    assert settings.ilqr == PLANNING[quality or "normal"]


def test_the_controllers_on_offer_are_those_of_the_simulator() -> None:
    from sim.track import CONTROLLERS as THERE

    assert set(CONTROLLERS) == set(THERE)


def test_help_loads_no_physics() -> None:
    code = "import sys, bridge.cli as c\ntry: c.main(['track', '--help'])\n"
    code += "except SystemExit: print('mujoco' in sys.modules or 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "False"
