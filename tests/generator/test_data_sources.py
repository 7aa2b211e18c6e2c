"""Sources of clips: InterHuman from disk, motion files, the choreographer."""

from __future__ import annotations

import logging
import pickle
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.data import (
    BatchConfig,
    BatchStream,
    Choreographed,
    DuetFolder,
    InterHuman,
    cached,
    clip_of,
    resampled,
)
from generator.data.choreographed import (
    SPLITS,
    TOLD,
    clauses_of,
    drawn_style,
    symmetries,
    unseen_manner,
)
from generator.features import encode, pair_features, release_features
from generator.io import write_motion
from generator.text.grammar import NOTABLE, ORDINARY, entry_of
from generator.text.manner import manner_of
from robots.errors import DuetError, MotionError, MotionFileError, PromptError, SpecError
from robots.files import write_archive


def interhuman_rows(duet, hip_shift=0.0):
    """The file arrays of a duet: body first, hands after, both in the release's columns."""
    rng = np.random.default_rng(0)
    arrays = []
    for person in duet.people:
        array = rng.normal(size=(person.frames, 492)).astype(np.float32)
        array[:, :66] = person.keypoints.reshape(-1, 66) + hip_shift
        array[:, 186:312] = np.tile([1, 0, 0, 1, 0, 0], 21)
        arrays.append(array)
    return arrays


@pytest.fixture
def dataset(make_duet, tmp_path):
    """A folder like InterHuman's with five clips: 1 to 3 train, 4 ignored, 5 test."""
    root = tmp_path / "InterHuman"
    for folder in ("motions_processed/person1", "motions_processed/person2", "annots", "split"):
        (root / folder).mkdir(parents=True)
    for i in range(1, 6):
        rows = interhuman_rows(make_duet(frames=20 + i, seed=i))
        for person, array in enumerate(rows, start=1):
            np.save(root / f"motions_processed/person{person}/{i}.npy", array)
        text = f"two people meet {i}\n\n  they raise the left hand {i} \nthey part {i}"
        (root / f"annots/{i}.txt").write_text(text)
    (root / "split/train.txt").write_text("1\n2\n4\r\n3")  # the last line has no newline
    (root / "split/test.txt").write_text("5\n")
    (root / "split/ignore_list.txt").write_text("4")
    return root


def test_the_split_is_read_to_its_last_line_and_the_ignore_list_kept(dataset):
    clips = InterHuman(dataset, "train")
    assert [clips.clip(i).name for i in range(len(clips))] == ["1", "2", "3"]
    assert len(InterHuman(dataset, "test")) == 1
    assert [InterHuman(dataset, None).clip(i).name for i in range(4)] == ["1", "2", "3", "5"]


def test_lists_in_the_root_count_too_and_first(dataset):
    (dataset / "split/train.txt").rename(dataset / "train.txt")
    (dataset / "split/ignore_list.txt").rename(dataset / "ignore_list.txt")
    assert len(InterHuman(dataset, "train")) == 3
    (dataset / "split/train.txt").write_text("1\n")
    assert len(InterHuman(dataset, "train")) == 3


def test_a_clip_has_the_sentences_and_the_release_s_features(dataset):
    clip = InterHuman(dataset, "train").clip(2)
    assert clip.texts == ("two people meet 3", "they raise the left hand 3", "they part 3")
    assert clip.fps == 30
    assert "BY-NC-SA" in clip.licence
    files = [np.load(dataset / f"motions_processed/person{p}/3.npy") for p in "12"]
    expected = np.stack(release_features(files[0], files[1]), axis=1)
    features = pair_features(clip.poses, clip.fps, release_compat=True)
    np.testing.assert_allclose(features, expected, atol=1e-9)


def test_the_dataset_goes_through_cache_and_batches_as_the_release_reads_it(dataset, tmp_path):
    cache = cached(InterHuman(dataset, "train"), tmp_path / "cache")
    assert cache.licences == ("CC BY-NC-SA 4.0 (InterHuman; redistribution prohibited)",)
    config = BatchConfig(size=3, frames=40, mirror=False, swap=False, release_compat=True)
    batch = BatchStream(cache, config).batch(0)
    assert sorted(batch.names) == ["1", "2", "3"]
    for x, n, name in zip(batch.x_raw, batch.lengths, batch.names, strict=True):
        files = [np.load(dataset / f"motions_processed/person{p}/{name}.npy") for p in "12"]
        expected = np.concatenate(release_features(files[0], files[1]), axis=1)
        np.testing.assert_allclose(x[:n], expected, atol=1e-5)


def test_a_file_cut_short_is_named(dataset):
    path = dataset / "motions_processed/person2/2.npy"
    path.write_bytes(path.read_bytes()[:-100])
    clips = InterHuman(dataset, "train")
    clips.clip(0)
    with pytest.raises(MotionFileError, match=r"person2/2\.npy"):
        clips.clip(1)
    with pytest.raises(MotionFileError, match=r"person2/2\.npy"):
        cached(clips, dataset.parent / "cache")
    assert list((dataset.parent / "cache").iterdir()) == []


@pytest.mark.parametrize("size", [0, 5, 40, 127, 128, 2000])
def test_any_cut_is_an_error_of_ours(dataset, size):
    path = dataset / "motions_processed/person1/1.npy"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(MotionFileError, match=r"person1/1\.npy"):
        InterHuman(dataset, "train").clip(0)


def test_numbers_that_are_not_finite_are_named(dataset):
    path = dataset / "motions_processed/person1/1.npy"
    array = np.load(path)
    array[3, 200] = np.nan
    np.save(path, array)
    with pytest.raises(MotionFileError, match=r"person1/1\.npy.*finite"):
        InterHuman(dataset, "train").clip(0)


def test_files_of_another_shape_or_length_are_named(dataset):
    path = dataset / "motions_processed/person1/1.npy"
    array = np.load(path)
    np.save(path, array[:-5])
    with pytest.raises(MotionFileError, match="16 frames, person b 21"):
        InterHuman(dataset, "train").clip(0)
    np.save(path, array[:, :491])
    with pytest.raises(MotionFileError, match="491"):
        InterHuman(dataset, "train").clip(0)


def test_listed_clips_without_files_are_left_out_with_a_warning(dataset, caplog):
    (dataset / "split/train.txt").write_text("1\n77\n2")
    with caplog.at_level(logging.WARNING):
        assert len(InterHuman(dataset, "train")) == 2
    assert "1 of 3" in caplog.text
    assert "77" in caplog.text


def test_what_is_missing_is_named(dataset, tmp_path):
    with pytest.raises(MotionFileError, match=r"split 'val'.*split/val\.txt"):
        InterHuman(dataset, "val")
    with pytest.raises(MotionFileError, match="person1"):
        InterHuman(tmp_path / "nowhere")
    (dataset / "split/train.txt").write_text("../../etc/passwd\n")
    with pytest.raises(MotionFileError, match=r"train\.txt, line 1"):
        InterHuman(dataset, "train")
    (dataset / "split/train.txt").write_text("99")
    with pytest.raises(MotionFileError, match="none of the 1"):
        InterHuman(dataset, "train")


def test_a_clip_without_a_sentence_still_trains(dataset, caplog):
    (dataset / "annots/1.txt").unlink()
    with caplog.at_level(logging.WARNING):
        assert InterHuman(dataset, "train").clip(0).texts == ("",)
    assert "1.txt" in caplog.text


def test_raw_pickles_are_refused_and_not_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (tmp_path.joinpath("boom").touch, ())

    (tmp_path / "motions").mkdir()
    (tmp_path / "motions/1.pkl").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(MotionFileError, match=r"pickles.*motions_processed"):
        InterHuman(tmp_path)
    assert not (tmp_path / "boom").exists()


def test_motion_files_are_found_in_subfolders(make_duet, tmp_path):
    duets = [make_duet(frames=16, seed=i) for i in range(2)]
    write_motion(duets[0], tmp_path / "b.npz")
    write_motion(duets[1], tmp_path / "a/x.npz")
    folder = DuetFolder(tmp_path)
    assert [folder.clip(i).name for i in range(len(folder))] == ["a/x.npz", "b.npz"]
    clip = folder.clip(1)
    assert (clip.texts, clip.licence) == ((duets[0].text,), "CC0")
    np.testing.assert_allclose(pair_features(clip.poses, 30), encode(duets[0]), atol=1e-9)
    (tmp_path / "b.npz").write_bytes(b"PK junk")
    with pytest.raises(MotionFileError, match=r"b\.npz"):
        folder.clip(1)
    with pytest.raises(MotionFileError, match=r"no motion"):
        DuetFolder(tmp_path / "empty")


def test_rollouts_and_trajectories_beside_a_motion_are_left_out(make_duet, tmp_path):
    write_motion(make_duet(frames=16), tmp_path / "run/motion.npz")
    write_archive(tmp_path / "run/rollout.npz", {"schema": "pasdedeux.rollout/1"}, {})
    assert len(DuetFolder(tmp_path)) == 1
    (tmp_path / "run/motion.npz").unlink()
    with pytest.raises(MotionFileError, match="no motion"):
        DuetFolder(tmp_path)


def test_fingerprints_change_with_the_content(dataset, make_duet, tmp_path):
    before = InterHuman(dataset, "train").fingerprint
    assert before != InterHuman(dataset, "test").fingerprint
    (dataset / "annots/1.txt").write_text("other words")
    assert InterHuman(dataset, "train").fingerprint != before
    write_motion(make_duet(frames=16), tmp_path / "m/x.npz")
    before = DuetFolder(tmp_path / "m").fingerprint
    write_motion(make_duet(frames=17), tmp_path / "m/x.npz")
    assert DuetFolder(tmp_path / "m").fingerprint != before
    ten, other = Choreographed(10, seed=0), Choreographed(10, seed=1)
    assert ten.fingerprint != other.fingerprint
    assert ten.fingerprint == Choreographed(10, seed=0).fingerprint
    assert ten.fingerprint != Choreographed(10, seed=0, split="test").fingerprint


def test_the_choreographer_s_clips_are_functions_of_seed_and_number():
    clips = Choreographed(4, seed=3, interactions=("wave", "bow"))
    first, again = clips.clip(2), Choreographed(9, seed=3, interactions=("wave", "bow")).clip(2)
    np.testing.assert_array_equal(first.poses[1].positions, again.poses[1].positions)
    assert first.texts == again.texts != ("",)
    assert first.poses[0].contacts is not None
    assert clips.clip(0).poses[0].frames != clips.clip(2).poses[0].frames or not np.array_equal(
        clips.clip(0).poses[0].positions, first.poses[0].positions
    )
    assert [clips.motion(i).interaction for i in range(4)] == ["wave", "bow", "wave", "bow"]
    with pytest.raises(IndexError):
        clips.clip(4)


@pytest.mark.parametrize("name", ["hug", "waltz", "push"])
def test_what_is_held_out_is_not_trained_on(name):
    known, unseen = (set(clauses_of(name, unseen=held)) for held in (False, True))
    assert known
    assert unseen
    assert not known & unseen
    assert known | unseen == set(entry_of(name).clauses)
    for clauses in (known, unseen):
        assert {clause.voice for clause in clauses} - {"together"}, "nobody can be said to lead"


@given(st.integers(0, 2**32), st.sampled_from(SPLITS))
@settings(max_examples=60, deadline=None)
def test_a_combination_that_is_held_out_is_never_drawn_for_training(seed, split):
    manner = unseen_manner("hug")
    style = drawn_style("hug", split, np.random.default_rng(seed))
    away = getattr(style, manner.field) - ORDINARY[manner.field]
    there = abs(away) >= NOTABLE[manner.field] and (away < 0) == (manner.direction == "low")
    assert there == (split == "combinations")
    remarkable = [n for n in ORDINARY if abs(getattr(style, n) - ORDINARY[n]) >= NOTABLE[n]]
    assert len(remarkable) <= 2, "more than a sentence says"


def test_every_symmetry_of_a_clip_has_sentences_of_its_own():
    clips = Choreographed(6, seed=4, interactions=("wave",))
    heard = {"left": [0, 0], "leads": [0, 0]}
    for index in range(6):
        clip = clips.clip(index)
        _, style, _ = clips._performed(index)
        assert clip.symmetric is not None
        for texts, turned in zip((clip.texts, *clip.symmetric), symmetries(style), strict=True):
            assert len(texts) == TOLD
            for text in texts:
                read = manner_of(text)
                heard["leads"][read.swap == turned.swap] += 1
                heard["left"][("left" in text.lower()) <= (turned.handedness == "left")] += 1
    assert heard["left"][0] == 0, "a left hand is said that the motion does not have"
    assert heard["leads"][1] > 0.95 * sum(heard["leads"])


def test_sentences_follow_the_wording_of_their_split():
    for split in ("train", "sentences"):
        clips = Choreographed(4, seed=1, split=split, interactions=("wave",))
        wordings = [c.words for c in clauses_of("wave", unseen=split == "sentences")]
        parts = [re.split(r"\{\w+\}", words) for words in wordings]
        for index in range(4):
            text = clips.clip(index).texts[0]
            assert any(all(part.strip() in text for part in words) for words in parts), text


def test_spoilt_performances_are_thrown_away(monkeypatch):
    import generator.choreographer as choreographer

    seen = []

    def examine(motion):
        seen.append(motion)
        return SimpleNamespace(faults=("reach",) if len(seen) < 3 else ())

    monkeypatch.setattr(choreographer, "examine", examine)
    motion = Choreographed(1, interactions=("bow",)).motion(0)
    assert len(seen) == 3
    np.testing.assert_array_equal(motion.keypoints, seen[2].keypoints)
    seen.clear()
    monkeypatch.setattr(choreographer, "examine", lambda _: SimpleNamespace(faults=("reach",)))
    with pytest.raises(MotionError, match="bow"):
        Choreographed(1, interactions=("bow",)).clip(0)


def test_unknown_interactions_and_empty_sets_are_refused():
    with pytest.raises(PromptError, match="handshak"):
        Choreographed(3, interactions=("handshak",))
    with pytest.raises(SpecError, match="count"):
        Choreographed(0)
    with pytest.raises(SpecError, match="split"):
        Choreographed(1, split="trian")  # type: ignore[arg-type]


def test_halving_the_frame_rate_picks_frames(make_duet):
    clip = clip_of(make_duet(frames=21, fps=30))
    half = resampled(clip, 15)
    assert (half.fps, half.frames) == (15, 11)
    np.testing.assert_allclose(half.poses[0].positions, clip.poses[0].positions[::2], atol=1e-12)
    np.testing.assert_allclose(half.poses[0].rotations, clip.poses[0].rotations[::2], atol=1e-12)
    assert resampled(clip, 30) is clip


def test_raising_the_frame_rate_interpolates(make_duet):
    motion = make_duet(frames=11, fps=30)
    labels = np.arange(44).reshape(11, 4) % 3 == 0
    clip = clip_of(replace(motion, a=replace(motion.a, foot_contacts=labels)))
    double = resampled(clip, 60)
    assert double.frames == 21
    positions = clip.poses[1].positions
    np.testing.assert_allclose(double.poses[1].positions[::2], positions, atol=1e-12)
    middle = (positions[1:] + positions[:-1]) / 2
    np.testing.assert_allclose(double.poses[1].positions[1::2], middle, atol=1e-12)
    columns = double.poses[0].rotations.reshape(-1, 3, 2)
    np.testing.assert_allclose(np.linalg.norm(columns, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose((columns[..., 0] * columns[..., 1]).sum(1), 0, atol=1e-12)
    contacts = double.poses[0].contacts
    assert contacts is not None
    np.testing.assert_array_equal(contacts[::2], labels)
    assert set(np.unique(contacts)) <= {0, 1}
    again = resampled(double, 30)
    np.testing.assert_allclose(again.poses[1].positions, positions, atol=1e-12)


def test_clips_that_cannot_be_are_refused(make_duet):
    clip = clip_of(make_duet(frames=10))
    a, b = clip.poses
    with pytest.raises(MotionError, match="10 and 9"):
        replace(clip, poses=(a, b.cut(0, 9)))
    with pytest.raises(DuetError, match="sentence"):
        replace(clip, texts=())
    with pytest.raises(DuetError, match="per second"):
        replace(clip, fps=np.nan)
    with pytest.raises(MotionError, match="too few"):
        resampled(clip, 1)
