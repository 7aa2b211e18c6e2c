"""Telemetry is shown as the servos moved, where the robots stood."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bridge.player.recording import Recording
from bridge.player.telemetry import Telemetry
from bridge.servo.state import ServoState
from bridge.show import TELEMETRY_FPS, clip_of_telemetry, clips_of
from bridge.sources import FROM_FILE
from bridge.trajectory import JointTrajectory
from robots.errors import MotionFileError
from robots.registry import load_robot
from sim.clip import Clip

ROBOTS = {"a": load_robot("op3"), "b": load_robot("marionette")}
PERIOD = 1 / 50


def angles(person: str, time: float) -> np.ndarray:
    rest = ROBOTS[person].rest
    return rest + 0.2 * np.sin(3 * time + np.arange(len(rest)))


def record(path: Path, *, seconds: float = 1.0, skip: tuple[int, ...] = (), deaf: int = -1) -> Path:
    """Write telemetry of two robots whose servos lag 0.1 rad behind."""
    with Telemetry(path) as file:
        file.header(
            {
                "rate": 50.0,
                "robots": {
                    person: {"name": robot.name, "joints": list(robot.joint_names)}
                    for person, robot in ROBOTS.items()
                },
            }
        )
        for tick in range(-10, round(seconds / PERIOD) + 1):
            if tick in skip:
                continue
            time = tick * PERIOD
            for person, robot in ROBOTS.items():
                goal = angles(person, max(0.0, time))
                present = goal - 0.1
                if tick == deaf:
                    present[0] = np.nan
                zero = np.zeros(len(robot.joints))
                file.tick(
                    100 + time,
                    robot=person,
                    state="RAMP" if tick < 0 else "PLAY",
                    phase=max(0.0, time),
                    goal=goal,
                    servos=ServoState(
                        time=100 + time,
                        position=present,
                        velocity=zero,
                        current=zero,
                        seen=np.isfinite(present),
                        alert=np.zeros(len(zero), bool),
                    ),
                    late=0.0,
                    sent=0.0,
                )
    return path


def trajectory(person: str, base: np.ndarray, times: np.ndarray) -> JointTrajectory:
    robot = ROBOTS[person]
    position = np.array([angles(person, time) for time in times])
    facts = {"text": "they wave"}
    return JointTrajectory(times, position, robot.joint_names, robot.name, facts, base)


def save_trajectories(folder: Path) -> list[Path]:
    """Save a duet whose a walks 1 m along x while its attitude changes sign, and b stands."""
    times = np.linspace(0.0, 1.0, 11)
    base = np.zeros((11, 7))
    base[:, 0], base[:, 2], base[:, 3] = times, 0.4, np.where(np.arange(11) % 2, -1.0, 1.0)
    stand = np.tile([2.0, 0.5, 0.3, 0.0, 0.0, 0.0, 1.0], (11, 1))
    paths = [folder / "trajectory-a.npz", folder / "trajectory-b.npz"]
    trajectory("a", base, times).save(paths[0])
    trajectory("b", stand, times).save(paths[1])
    return paths


def shown(clip: Clip, person: str) -> np.ndarray:
    """Return the joint angles ``[N, D]`` that a clip shows."""
    names = ROBOTS[person].joint_names
    joints = [clip.model.joint(f"{person}/{name}").qposadr[0] for name in names]
    return clip.qpos[:, joints]


@pytest.mark.parametrize("person", ["a", "b"])
def test_telemetry_shows_what_the_servos_did_not_what_they_were_told(tmp_path, person):
    clip = clip_of_telemetry(record(tmp_path / "telemetry.jsonl"))
    assert clip.fps == TELEMETRY_FPS
    assert len(clip.qpos) == TELEMETRY_FPS + 1
    expected = np.array([angles(person, frame / TELEMETRY_FPS) for frame in range(61)]) - 0.1
    np.testing.assert_allclose(shown(clip, person), expected, atol=2e-3)


def test_ticks_and_answers_that_are_missing_are_bridged(tmp_path):
    path = record(tmp_path / "telemetry.jsonl", skip=(10, 11, 12), deaf=30)
    recording = Recording.load(path)
    assert len(recording.times) == 48
    assert np.isnan(recording.people[0].present).sum() == 1
    np.testing.assert_allclose(
        shown(clip_of_telemetry(path), "a")[12], angles("a", 0.2) - 0.1, atol=1e-2
    )


def test_robots_stand_where_the_trajectories_beside_the_telemetry_say(tmp_path):
    save_trajectories(tmp_path)
    clip = clip_of_telemetry(record(tmp_path / "telemetry.jsonl"))
    np.testing.assert_allclose(clip.qpos[:, 0], np.arange(61) / 60, atol=1e-9)
    np.testing.assert_allclose(clip.qpos[:, 2], 0.4)
    np.testing.assert_allclose(np.abs(clip.qpos[:, 3]), 1.0)  # no tumbling where the sign changes
    np.testing.assert_allclose(clip.model.body("b/base").pos, [2.0, 0.5, 0.3])
    assert clip.title == "they wave"


def test_without_trajectories_the_robots_face_each_other(tmp_path):
    clip = clip_of_telemetry(record(tmp_path / "telemetry.jsonl"))
    assert clip.qpos[0, 0] == -0.25
    np.testing.assert_allclose(clip.model.body("b/base").pos[:2], [0.25, 0.0])
    np.testing.assert_allclose(clip.model.body("b/base").quat, [0.0, 0.0, 0.0, 1.0])


def test_the_plan_can_be_shown_next_to_the_deed(tmp_path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    paths = save_trajectories(folder)
    deed, plan = clips_of([record(tmp_path / "telemetry.jsonl"), *paths], FROM_FILE)
    np.testing.assert_allclose(deed.qpos[-1, 0], plan.qpos[-1, 0])
    np.testing.assert_allclose(shown(deed, "a")[-1], shown(plan, "a")[-1] - 0.1, atol=1e-4)


def test_a_file_that_a_crash_cut_off_is_shown_as_far_as_it_goes(tmp_path):
    path = record(tmp_path / "telemetry.jsonl")
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    assert 10 < len(clip_of_telemetry(path).qpos) < 60


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "not a telemetry file"),
        ([{"schema": "something/1"}], "not a telemetry file"),
        ([{"kind": "header", "schema": "pasdedeux.telemetry/1", "robots": {}}], "did not dance"),
        ([{"schema": "pasdedeux.telemetry/1"}, {"kind": "tick"}], "damaged"),
        ([[1, 2]], "damaged"),
    ],
)
def test_what_is_no_telemetry_is_refused_in_words(tmp_path, lines, message):
    path = tmp_path / "telemetry.jsonl"
    path.write_text("\n".join(json.dumps(line) for line in lines))
    with pytest.raises(MotionFileError, match=message):
        Recording.load(path)
