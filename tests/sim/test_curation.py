"""Curating: what physics repairs, what the gate rejects, and that no clip is lost on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim.curation
from generator.choreographer import repertoire
from generator.data import Choreographed, Curated, Curation, Verdict
from generator.io import read_motion
from generator.motion import DuetMotion, Motion
from robots.errors import MotionError, SimDiverged
from sim.batch import Lost
from sim.curation import CurationSettings, Item, curate, curate_clip, in_order, judge, summary
from sim.gate import Gate
from sim.track import TrackSettings

ASSIST = CurationSettings(tracking=TrackSettings(controller="assist"))
"""Quick; who keeps the people on their feet does not matter here."""


@pytest.fixture
def curation(tmp_path: Path) -> Curation:
    return Curation(tmp_path / "curated", "train", 0, 6)


def items_of(curation: Curation) -> list[Item]:
    return [Item(curation, number) for number in range(curation.count)]


@cache
def invented(number: int) -> DuetMotion:
    """One of the first clips of seed 0, computed once."""
    return _MOTION(Choreographed(6), number)


_MOTION = Choreographed.motion


def counted(
    monkeypatch: pytest.MonkeyPatch, answer: Callable[[DuetMotion], bool] = lambda _: True
) -> list[str]:
    """Replace physics by an answer, in this process; return the interactions that are judged."""
    seen: list[str] = []

    def here(function, items, processes):
        for item in items:
            try:
                yield item, function(item)
            except Exception as error:
                yield item, Lost(str(error))

    def fake(asked: DuetMotion, settings: CurationSettings):
        seen.append(asked.interaction)
        kept = answer(asked)
        verdict = Verdict(
            kept=kept, interaction=asked.interaction, changed_mm=2.0 if kept else None
        )
        return verdict, asked if kept else None

    monkeypatch.setattr(sim.curation, "in_processes", here)
    monkeypatch.setattr(sim.curation, "judge", fake)
    monkeypatch.setattr(Choreographed, "motion", lambda self, number: invented(number))
    return seen


def test_a_clip_is_repaired_and_training_reads_it(curation: Curation) -> None:
    """The whole way: track, judge, write, read."""
    item = Item(curation, 3)
    verdict = curate_clip(item, settings=ASSIST)
    assert verdict.kept, verdict.why
    assert verdict == curation.verdict(3)
    assert verdict.cpu_s > 0
    assert verdict.figures["simulated"]["mpjpe_global"] > 0
    asked, made = curation.clips.motion(3), read_motion(curation.motion_file(3))
    off = np.linalg.norm(made.keypoints - asked.keypoints, axis=-1).mean() * 1000
    assert verdict.changed_mm == pytest.approx(off, abs=1e-3)
    assert 0.5 < off < 60, "physics changes something, and not much"
    assert (made.kind, made.licence) == ("simulated", asked.licence)
    assert (made.fps, made.frames, made.text) == (asked.fps, asked.frames, asked.text)
    clip, raw = Curated(curation).clip(0), curation.clips.clip(3)
    assert clip.texts == raw.texts
    assert not np.array_equal(clip.poses[0].positions, raw.poses[0].positions)
    contacts = clip.poses[0].contacts
    assert contacts is not None
    assert 0.5 < contacts.mean() <= np.asarray(raw.poses[0].contacts).mean()


def test_what_the_gate_refuses_is_rejected_with_its_reason(curation: Curation) -> None:
    strict = replace(ASSIST, gate=Gate(mpjpe_global_mm=0.1))
    motion = curation.clips.motion(3)
    cut = [
        Motion(p.fps, p.keypoints[:30], np.asarray(p.rotations)[:30], skeleton=p.skeleton)
        for p in motion.people
    ]
    verdict, repaired = judge(replace(motion, a=cut[0], b=cut[1], contacts=()), strict)
    assert not verdict.kept
    assert repaired is None
    assert verdict.reasons == ("mpjpe_global",)
    assert len(verdict.why) == 2
    assert "0.1" in verdict.why[0]
    assert verdict.changed_mm is None
    assert verdict.figures["reference"]["penetration_p95"] >= 0


def test_what_physics_cannot_do_is_rejected_and_stops_nothing(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverges(motion, *, settings):
        raise SimDiverged("the pelvis left the building", time=1.0)

    monkeypatch.setattr(sim.curation, "track", diverges)
    verdict = curate_clip(Item(curation, 0), settings=ASSIST)
    assert not verdict.kept
    assert verdict.reasons == ("impossible",)
    assert "building" in verdict.why[0]
    assert curation.verdict(0) == verdict
    assert not curation.motion_file(0).exists()


def test_a_clip_that_the_choreographer_spoils_is_rejected(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    def spoilt(self, index):
        raise MotionError("was spoilt in 20 draws")

    monkeypatch.setattr(Choreographed, "motion", spoilt)
    verdict = curate_clip(Item(curation, 0), settings=ASSIST)
    assert (verdict.kept, verdict.reasons) == (False, ("spoilt",))


def test_feet_that_had_to_move_lose_their_label(make_duet: Callable[..., DuetMotion]) -> None:
    duet = make_duet()
    all_down = np.ones((duet.frames, 4), bool)
    asked = replace(duet, a=replace(duet.a, foot_contacts=all_down))
    points = duet.a.keypoints.copy()
    skeleton = duet.a.skeleton
    slid = [skeleton.index("left_ankle"), skeleton.index("left_foot")]
    lifted = [skeleton.index("right_ankle"), skeleton.index("right_foot")]
    half = duet.frames // 2
    points[half:, slid, 0] += (np.arange(duet.frames - half) * 0.5 / duet.fps)[:, None]
    points[:half, lifted, 2] += 0.1
    made = replace(duet, a=Motion(duet.fps, points, skeleton=skeleton))
    labelled = sim.curation.labelled(made, asked)
    contacts = np.asarray(labelled.a.foot_contacts)
    assert contacts[: half - 1, :2].all(), "left stands"
    assert not contacts[half + 1 :, :2].any(), "left slides at 0.5 m/s"
    assert not contacts[: half - 1, 2:].any(), "right is in the air"
    assert contacts[half + 1 :, 2:].all(), "right stands"
    assert labelled.b.foot_contacts is None


def test_a_beginning_of_the_order_is_spread_over_the_interactions(tmp_path: Path) -> None:
    names = repertoire()
    curations = [Curation(tmp_path, "train", seed, 2 * len(names) + 3) for seed in (0, 1)]
    items = in_order(curations)
    assert len(items) == len(set(items)) == sum(c.count for c in curations)
    first = [items[i].curation.clips.interaction(items[i].number) for i in range(len(names))]
    assert sorted(first) == sorted(names)
    assert first[:10] != list(names[:10])
    assert {item.number for item in items[: 2 * len(names)]} == set(range(len(names)))


def test_a_clip_in_two_sources_is_judged_once(tmp_path: Path) -> None:
    small, large = (Curation(tmp_path, "train", 0, count) for count in (2, 5))
    test = Curation(tmp_path, "test", 0, 2)
    assert len(in_order([small, large, test])) == 5 + 2


def test_what_has_a_verdict_is_not_judged_again(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = counted(monkeypatch)
    curate(items_of(curation)[:4], ASSIST)
    assert len(seen) == 4
    curate(items_of(curation), ASSIST)
    assert len(seen) == 6
    curate(items_of(curation), replace(ASSIST, gate=Gate(speed_max=14.0)))
    assert len(seen) == 12, "another gate is another verdict"


def test_a_motion_without_its_verdict_is_judged_again_and_the_other_way_round(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process can be killed between the two files, and a person can delete one."""
    seen = counted(monkeypatch)
    curate(items_of(curation), ASSIST)
    curation.verdict_file(2).unlink()
    curation.motion_file(4).unlink()
    curate(items_of(curation), ASSIST)
    assert len(seen) == 8
    assert all(curation.motion_file(number).is_file() for number in range(6))


def test_a_clip_that_is_rejected_now_leaves_no_motion_from_before(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted(monkeypatch)
    curate(items_of(curation), ASSIST)
    counted(monkeypatch, lambda _: False)
    curate(items_of(curation), replace(ASSIST, gate=Gate(speed_max=14.0)))
    assert not list(curation.root.rglob("*.npz"))
    assert len(list(curation.root.rglob("*.json"))) == 6


def test_a_damaged_verdict_is_reported_and_stops_no_other(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = counted(monkeypatch)
    curation.folder.mkdir(parents=True)
    curation.verdict_file(1).write_text("{")
    results = curate(items_of(curation), ASSIST)
    assert len(seen) == 5
    lost = summary(results)["lost"]
    assert [Path(entry["clip"]).name for entry in lost] == ["1.json"]


def test_the_summary_counts_what_happened(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted(monkeypatch, lambda motion: motion.interaction != repertoire()[1])
    facts: dict[str, Any] = summary(curate(items_of(curation), ASSIST))
    assert (facts["kept"], facts["rejected"], facts["lost"]) == (5, 1, [])
    assert facts["changed_mm"] == 2.0
    one = facts["interactions"][repertoire()[1]]
    assert (one["kept"], one["rejected"], one["changed_mm"]) == (0, 1, None)
    assert sum(of["kept"] for of in facts["interactions"].values()) == 5


def test_a_clip_whose_process_dies_has_no_verdict_and_gets_one_next_time(
    curation: Curation, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted(monkeypatch)
    healthy = sim.curation.in_processes

    def dies(function, items, processes):
        for item in items:
            if item.number == 1:
                yield item, Lost("its process died (SIGKILL)")
            else:
                yield from healthy(function, [item], processes)

    monkeypatch.setattr(sim.curation, "in_processes", dies)
    lost = summary(curate(items_of(curation), ASSIST))["lost"]
    assert [(Path(entry["clip"]).name, entry["why"]) for entry in lost] == [
        ("1.json", "its process died (SIGKILL)")
    ]
    assert [n for n in range(6) if curation.verdict(n) is None] == [1]
    monkeypatch.setattr(sim.curation, "in_processes", healthy)
    facts = summary(curate(items_of(curation), ASSIST))
    assert (facts["kept"], facts["lost"]) == (6, [])
