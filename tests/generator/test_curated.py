"""Clips that physics repaired or rejected, as training reads them."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from generator.assessment import held_out
from generator.data import Choreographed, Curated, Curation, Verdict, cached
from generator.features import poses_of
from generator.io import write_motion
from generator.motion import DuetMotion
from generator.training.config import load_config, parse
from generator.training.prepare import make_source
from robots.errors import MotionFileError, SpecError

CONFIGS = Path(__file__).parents[2] / "configs"
COUNT, SEED = 5, 3
KEPT, REJECTED, OPEN = (0, 3), (1,), (2, 4)


def shifted(motion: DuetMotion, licence: str = "CC0-1.0") -> DuetMotion:
    """A motion a centimetre beside where it was, standing on one foot less."""
    a, b = (
        replace(
            person,
            keypoints=person.keypoints + np.array([0.01, 0, 0]),
            foot_contacts=np.asarray(person.foot_contacts) & [True, True, True, False],
        )
        for person in motion.people
    )
    return replace(motion, a=a, b=b, kind="simulated", licence=licence)


def write_verdict(curation: Curation, number: int, *, kept: bool) -> None:
    verdict = Verdict(kept=kept, interaction=curation.clips.interaction(number))
    verdict.save(curation.verdict_file(number))


@cache
def invented(number: int, seed: int = SEED) -> DuetMotion:
    return Choreographed(COUNT, seed=seed).motion(number)


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Curation:
    """Five clips: two kept, one rejected, two not judged."""
    made = Curation(tmp_path_factory.mktemp("judged") / "curated", "train", SEED, COUNT)
    for number in (*KEPT, *REJECTED):
        write_verdict(made, number, kept=number in KEPT)
    for number in KEPT:
        write_motion(shifted(invented(number)), made.motion_file(number))
    return made


@pytest.fixture
def curation(judged: Curation, tmp_path: Path) -> Curation:
    """A copy that a test may change."""
    shutil.copytree(judged.root, tmp_path / "curated")
    return replace(judged, root=tmp_path / "curated")


def test_a_verdict_comes_back_as_it_was(tmp_path: Path) -> None:
    verdict = Verdict(
        kept=False,
        interaction="bow",
        text="they bow",
        reasons=("mpjpe_global",),
        why=("mpjpe_global of simulated a: 200 mm (≤ 150) at 1.00 s",),
        changed_mm=None,
        figures={"reference": {"penetration_p95": 1.5}, "simulated": {"penetration_p95": 0.0}},
        cpu_s=7.25,
        made_with={"versions": {"mujoco": "3"}, "settings": {"rate": 60.0}},
    )
    verdict.save(tmp_path / "x.json")
    assert Verdict.load(tmp_path / "x.json") == verdict
    assert Verdict.load(tmp_path / "none.json") is None


@pytest.mark.parametrize(
    "content", [b"", b"\xff", b"[]", b"3", b'{"schema": "pasdedeux.verdict/1"}', b"[" * 5000]
)
def test_what_is_not_a_verdict_gives_one_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(content)
    with pytest.raises(MotionFileError, match=r"x\.json.*judges the clip again"):
        Verdict.load(path)


@pytest.mark.parametrize(
    "wrong", [{"kept": 1}, {"figures": 3}, {"reasons": None}, {"schema": "pasdedeux.verdict/9"}]
)
def test_a_verdict_with_a_wrong_entry_is_refused(tmp_path: Path, wrong: dict) -> None:
    path = tmp_path / "x.json"
    Verdict(kept=True, interaction="bow").save(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | wrong))
    with pytest.raises(MotionFileError, match="not a verdict"):
        Verdict.load(path)


def test_kept_clips_have_the_repaired_poses_and_their_own_sentences(curation: Curation) -> None:
    source, raw = Curated(curation), curation.clips
    assert len(source) == len(KEPT)
    for index, number in enumerate(KEPT):
        clip, before = source.clip(index), raw.clip(number)
        repaired = poses_of(shifted(invented(number)).a)
        np.testing.assert_allclose(clip.poses[0].positions, repaired.positions, atol=1e-12)
        found, labelled, was = (
            np.asarray(p.contacts) for p in (clip.poses[0], repaired, before.poses[0])
        )
        np.testing.assert_array_equal(found, labelled)
        assert not np.array_equal(found, was)
        assert (clip.texts, clip.symmetric) == (before.texts, before.symmetric)
        assert (clip.fps, clip.frames) == (before.fps, before.frames)
    with pytest.raises(IndexError):
        source.clip(len(KEPT))


def test_a_raw_run_has_the_same_clips_as_they_were_invented(curation: Curation) -> None:
    source, repaired = Curated(curation, poses="raw"), Curated(curation)
    assert len(source) == len(repaired)
    for index, number in enumerate(KEPT):
        clip, before = source.clip(index), curation.clips.clip(number)
        np.testing.assert_array_equal(clip.poses[1].positions, before.poses[1].positions)
        assert clip.texts == repaired.clip(index).texts
    assert source.fingerprint != repaired.fingerprint


def test_clips_without_a_verdict_can_be_kept_as_they_were_invented(curation: Curation) -> None:
    source, raw = Curated(curation, unjudged="keep"), curation.clips
    assert len(source) == len(KEPT) + len(OPEN)
    found = [source.clip(index).poses[0].positions for index in range(len(source))]
    for number, positions in zip(sorted((*KEPT, *OPEN)), found, strict=True):
        off = np.abs(positions - raw.clip(number).poses[0].positions).max()
        assert off == pytest.approx(0.01 if number in KEPT else 0.0, abs=1e-9)


def test_the_licence_of_the_repaired_motion_is_the_clip_s(curation: Curation) -> None:
    write_motion(shifted(invented(0), "CC-BY-4.0"), curation.motion_file(0))
    assert [Curated(curation).clip(i).licence for i in (0, 1)] == ["CC-BY-4.0", "CC0-1.0"]


def test_the_cache_is_made_anew_when_the_folder_s_content_changes(
    curation: Curation, tmp_path: Path
) -> None:
    seen = {Curated(curation).fingerprint}
    assert Curated(curation).fingerprint in seen
    os.utime(curation.motion_file(0), ns=(1, 1))
    seen.add(Curated(curation).fingerprint)
    write_verdict(curation, OPEN[0], kept=True)
    write_motion(shifted(invented(OPEN[0])), curation.motion_file(OPEN[0]))
    seen.add(Curated(curation).fingerprint)
    write_verdict(curation, KEPT[0], kept=False)
    seen.add(Curated(curation).fingerprint)
    assert len(seen) == 4
    folders = {cached(Curated(curation), tmp_path / "cache").folder}
    write_verdict(curation, KEPT[1], kept=False)
    folders.add(cached(Curated(curation), tmp_path / "cache").folder)
    assert len(folders) == 2


def test_a_repair_of_another_motion_is_refused(curation: Curation) -> None:
    """When the choreographer changes, the numbers stay, and mean other motions."""
    other = invented(0, SEED + 1)
    write_motion(shifted(other), curation.motion_file(0))
    with pytest.raises(MotionFileError, match=r"0\.npz.*another motion"):
        Curated(curation).clip(0)
    raw = invented(0)
    cut = [
        replace(
            p,
            keypoints=p.keypoints[1:],
            rotations=np.asarray(p.rotations)[1:],
            foot_contacts=np.asarray(p.foot_contacts)[1:],
        )
        for p in raw.people
    ]
    write_motion(replace(raw, a=cut[0], b=cut[1]), curation.motion_file(0))
    with pytest.raises(MotionFileError, match="another motion"):
        Curated(curation).clip(0)


def test_the_same_length_alone_does_not_make_it_the_same_motion(curation: Curation) -> None:
    raw = invented(0)
    taller = [replace(p, keypoints=p.keypoints * 1.02) for p in raw.people]
    write_motion(replace(raw, a=taller[0], b=taller[1]), curation.motion_file(0))
    with pytest.raises(MotionFileError, match="another motion"):
        Curated(curation).clip(0)


def test_a_verdict_on_another_interaction_is_refused(curation: Curation) -> None:
    Verdict(kept=True, interaction="yodel").save(curation.verdict_file(0))
    with pytest.raises(MotionFileError, match=r"yodel.*repertoire has changed"):
        Curated(curation)


def test_a_kept_clip_without_its_motion_is_an_error_and_not_a_lost_clip(
    curation: Curation,
) -> None:
    curation.motion_file(0).unlink()
    with pytest.raises(MotionFileError, match=r"0\.npz"):
        Curated(curation)
    assert len(Curated(curation, poses="raw")) == len(KEPT), "a raw run needs no motion"


def test_a_folder_in_which_nothing_was_kept_says_what_to_do(tmp_path: Path) -> None:
    empty = Curation(tmp_path, "train", 0, 2)
    with pytest.raises(MotionFileError, match="pasdedeux curate"):
        Curated(empty)
    for number in range(2):
        write_verdict(empty, number, kept=False)
    with pytest.raises(MotionFileError, match="pasdedeux curate"):
        Curated(empty, unjudged="keep")


def test_a_configuration_takes_repaired_clips(curation: Curation) -> None:
    source = {
        "kind": "choreographed",
        "count": COUNT,
        "seed": SEED,
        "repaired": str(curation.root),
    }
    names = []
    for extra, length in (({}, 2), ({"poses": "raw"}, 2), ({"unjudged": "keep"}, 4)):
        run = parse({"data": {"source": [source | extra]}})
        made = make_source(run.data.source[0])
        assert len(made) == length
        names.append(made.name)
    assert "repaired" in names[0]
    assert "raw" in names[1]


def test_what_is_held_out_from_a_run_on_judged_clips_needs_no_verdict() -> None:
    run = load_config(CONFIGS / "physics/raw.toml")
    source = held_out("", run)
    assert source.seed != run.data.source[0].seed
    assert isinstance(make_source(source), Choreographed)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"kind": "duets", "root": "x", "repaired": "y"}, "repaired"),
        ({"kind": "choreographed", "poses": "raw"}, "poses"),
        ({"kind": "choreographed", "unjudged": "keep"}, "unjudged"),
        ({"kind": "choreographed", "repaired": "x", "poses": "rwa"}, "did you mean 'raw'"),
        ({"kind": "choreographed", "repaired": "x", "unjudged": "no"}, "drop, keep"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(source: dict, words: str) -> None:
    with pytest.raises(SpecError, match=words):
        parse({"data": {"source": [source]}})


def test_the_two_runs_of_the_comparison_differ_in_the_poses_alone() -> None:
    runs = [load_config(CONFIGS / f"physics/{name}.toml") for name in ("raw", "repaired")]
    (raw,), (repaired,) = (run.data.source for run in runs)
    assert (raw.poses, repaired.poses) == ("raw", "repaired")
    assert replace(raw, poses="repaired") == repaired
    same = [replace(r, name="", data=replace(r.data, source=(repaired,))) for r in runs]
    assert same[0] == same[1]
