import json
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.tracking.ablation import VARIANTS, ablation_clips, ablation_tasks
from benchmarks.tracking.clips import TOUCHING, BenchClip, clips_of, tier
from benchmarks.tracking.pictures import moments
from benchmarks.tracking.results import Results, key_of
from benchmarks.tracking.run import run
from benchmarks.tracking.table import (
    ablation,
    comparison,
    latest,
    replace_between_markers,
)
from benchmarks.tracking.tasks import Task, acceleration_error_from, perform
from generator.motion import Contact, DuetMotion, Motion
from robots.errors import MotionFileError, SpecError
from sim.track import TrackSettings, track


def record_of(task: Task, **changes) -> dict:
    """A result as a worker would return it, without having tracked anything."""
    clip, controller = task.clip, task.controller
    both = {"a": 10.0, "b": 30.0}
    return {
        **{"set": clip.set, "clip": clip.name, "controller": controller, "tier": "walking"},
        **{"variant": task.variant, "settings_hash": task.settings_hash, "jobs": 2},
        **{"success": True, "fell": {"a": False, "b": False}, "ended_because": None},
        **{"fall_time_s": {"a": None, "b": None}, "duration_s": 5.0, "revision": "abc"},
        **{"mpjpe_global_mm": both, "mpjpe_root_mm": both, "accel_error_mm_per_frame2": both},
        **{"contact_recall": 0.9, "recoveries": 1, "assist_max_bodyweight": 0.0},
        **{"penetration_p95_mm": {"reference": 40.0, "simulated": 4.0}},
        **{"floor_penetration_p95_mm": both, "mujoco_version": "3"},
        **{"cpu_seconds_per_second": 5.0, "wall_seconds_per_second": 6.0, **changes},
    }


def tasks_of(count: int) -> list[Task]:
    return [Task(clip=clip, controller="assist") for clip in clips_of("choreo")[:count]]


def test_what_is_done_is_not_done_again(tmp_path):
    results, asked = Results(tmp_path / "r.jsonl"), []

    def workers(tasks):
        for task in tasks:
            asked.append(task.clip.name)
            yield record_of(task)

    assert run(tasks_of(2), results, workers) == 2
    assert run(tasks_of(4), results, workers) == 2
    assert asked == [task.clip.name for task in tasks_of(4)]
    assert len(results.read()) == 4


def test_other_options_are_another_result(tmp_path):
    results = Results(tmp_path / "r.jsonl")
    clip = clips_of("choreo")[0]
    plain, other = (
        Task(clip=clip, controller="ilqr", options=options) for options in ({}, {"ghost": False})
    )
    results.append(record_of(plain))
    assert plain.key in results.read()
    assert other.key not in results.read()
    assert not other.settings.ilqr.ghost


def test_being_killed_loses_no_clip(tmp_path):
    """The writer is killed for real after three clips, in the middle of its fourth line."""
    path = tmp_path / "r.jsonl"
    script = f"""
import os, signal
from pathlib import Path
from benchmarks.tracking.results import Results
results = Results(Path({str(path)!r}))
for i in range(3):
    results.append({{"set": "s", "clip": str(i), "controller": "c", "settings_hash": "h"}})
with open(results.path, "ab") as file:
    file.write(b'{{"set": "s", "cl')
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""
    code = subprocess.run([sys.executable, "-c", script], env=os.environ, check=False).returncode
    assert code == -signal.SIGKILL
    results = Results(path)
    assert [key[1] for key in results.read()] == ["0", "1", "2"]
    results.append({"set": "s", "clip": "3", "controller": "c", "settings_hash": "h"})
    assert [key[1] for key in results.read()] == ["0", "1", "2", "3"]


def test_a_damaged_line_is_named(tmp_path):
    path = tmp_path / "r.jsonl"
    path.write_text('{"set": \n{}\n')
    with pytest.raises(MotionFileError, match=r"r\.jsonl:1"):
        Results(path).read()


def test_sixty_duets_cover_all_touching_interactions_in_many_styles():
    clips = clips_of("choreo")
    assert len(clips) == len({clip.name for clip in clips}) == 60
    assert {clip.interaction for clip in clips} == set(TOUCHING)
    assert np.ptp([clip.style.speed for clip in clips]) > 0.6
    assert {clip.style.handedness for clip in clips} == {"left", "right"}
    assert clips == clips_of("choreo")


def test_dirty_clips_are_the_clean_ones_spoilt():
    clean, dirty = clips_of("choreo")[3], clips_of("dirty")[3]
    before, after = clean.load(), dirty.load()
    error = np.linalg.norm(after.keypoints - before.keypoints, axis=-1)
    assert 0.02 < error.mean() < 0.15
    assert after.contacts == before.contacts
    assert before.contacts


def test_clips_and_tasks_can_be_sent_to_another_process():
    for task in (*tasks_of(1), ablation_tasks()[-1]):
        assert pickle.loads(pickle.dumps(task)).key == task.key


def test_runners_are_a_tier_of_their_own(make_walk):
    assert tier(make_walk(1.5)) == "walking"
    assert tier(make_walk(2.5)) == "running"


@pytest.fixture
def make_walk():
    def walk(speed: float) -> DuetMotion:
        still = clips_of("choreo")[0].load()
        path = speed * np.arange(still.frames)[:, None, None] / still.fps * [1.0, 0.0, 0.0]
        people = [Motion(p.fps, p.keypoints[:1] + path) for p in still.people]
        return DuetMotion(people[0], people[1])

    return walk


def test_a_motion_that_cannot_be_read_is_a_result(tmp_path):
    (tmp_path / "bad.npz").write_bytes(b"PK nonsense")
    (clip,) = clips_of("folder", tmp_path)
    record = perform(Task(clip=clip, controller="assist"))
    assert not record["success"]
    assert "bad.npz" in record["ended_because"]
    assert key_of(json.loads(json.dumps(record))) == Task(clip=clip, controller="assist").key
    assert "bad.npz" in comparison([record])


def test_an_unknown_set_names_the_known_ones():
    with pytest.raises(SpecError, match="pseudo"):
        clips_of("speudo")


def test_acceleration_errors_are_taken_from_the_given_motion(make_still):
    rollout = track(make_still(0.0), settings=TrackSettings(controller="assist"))
    near = acceleration_error_from(make_still(0.0), rollout)
    far = acceleration_error_from(make_still(0.01), rollout)
    assert max(near.values()) < 2.0
    assert min(far.values()) > 5.0


@pytest.fixture
def make_still():
    def still(shake: float) -> DuetMotion:
        whole = BenchClip(set="", name="", interaction="handshake").load()
        rng = np.random.default_rng(0)
        people = [
            Motion(p.fps, p.keypoints[:1] + shake * rng.standard_normal((15, 22, 3)))
            for p in whole.people
        ]
        return DuetMotion(people[0], people[1])

    return still


def test_the_table_judges_figures_by_their_bars():
    tasks = tasks_of(4)
    good = [record_of(task) for task in tasks[:3]]
    fallen = record_of(
        tasks[3],
        success=False,
        fell={"a": True, "b": False},
        fall_time_s={"a": 2.5, "b": None},
        contact_recall=0.5,
    )
    text = comparison([*good, fallen])
    assert "| success, % | ≥ 98 | 75.0 **short** |" in text
    assert "| falls |  | 1 |" in text
    assert "| MPJPE, global, mm | ≤ 30 | 20 (20) ok |" in text
    assert "| 0.80; 75 % ok |" in text
    assert "| in each other, asked for, p95, mm |  | 40 (40) |" in text
    assert "| wall, s per s | ≤ 3 | 3.00 (3.00) ok |" in text
    assert f"assist, choreo/{tasks[3].clip.name}: a fell at 2.50 s of 5.0 s" in text


def test_the_table_takes_the_last_result_of_a_clip(tmp_path):
    task = tasks_of(1)[0]
    old, new = record_of(task, settings_hash="old"), record_of(task, settings_hash="new")
    results = Results(tmp_path / "r.jsonl")
    for record in (new, old, new):
        results.append(record)
    assert [r["settings_hash"] for r in latest(results.read().values())] == ["new"]


def test_the_ablation_leaves_out_one_part_at_a_time():
    clips = ablation_clips()
    assert len(clips) == 12
    assert {clip.interaction for clip in clips[3:]} == set(TOUCHING)
    assert sum(clip.corruption is not None for clip in clips) == 3
    tasks = ablation_tasks(limit=1)
    assert [task.variant for task in tasks] == list(VARIANTS)
    assert len({task.key for task in tasks}) == len(VARIANTS)
    text = ablation([record_of(task) for task in tasks])
    assert "| without feedback | 1 | 100.0 |" in text


def test_only_what_is_between_the_markers_is_replaced(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- results -->\nold\n<!-- /results -->\nafter\n")
    replace_between_markers(page, "results", "new")
    assert page.read_text() == "before\n<!-- results -->\n\nnew\n\n<!-- /results -->\nafter\n"
    with pytest.raises(MotionFileError, match="ablation"):
        replace_between_markers(page, "ablation", "new")


def test_the_page_has_both_markers():
    text = (Path(__file__).parents[2] / "docs" / "tracking.md").read_text(encoding="utf-8")
    for name in ("results", "ablation"):
        assert f"<!-- {name} -->" in text
        assert f"<!-- /{name} -->" in text


def test_one_moment_of_a_picture_shows_the_touch():
    times = np.arange(301) / 60
    index = moments(times, (Contact("right_hand", "right_hand", 1.0, 1.2),))
    assert len(index) == 8
    assert 66 in index
    assert moments(times, ()) == [int(i) for i in np.rint(np.linspace(0, 300, 8))]
