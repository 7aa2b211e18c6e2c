"""Cache, statistics and batches: whole or absent, exact to resume, fair in its draws."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.augment import mirror_poses
from generator.canonical import to_canonical
from generator.data import (
    BatchConfig,
    BatchStream,
    ClipCache,
    FeatureStatistics,
    cached,
    clip_of,
    measure,
)
from generator.data.batches import _shares
from generator.data.statistics import STD_FLOOR, RunningStatistics
from generator.features import POSITIONS, encode, lowest, pair_features
from robots.errors import MotionFileError, SpecError

SENTENCES = ("the first person raises the left hand", "two people wave")


class Made:
    """Synthetic clips of given lengths."""

    name = "made"

    def __init__(self, make_duet, lengths=(20, 31, 16, 45, 12), seed=0):
        self.calls = 0
        self.fingerprint = f"made {lengths} {seed}"
        self.motions = [make_duet(frames=n, seed=seed + n) for n in lengths]

    def __len__(self):
        return len(self.motions)

    def clip(self, index):
        self.calls += 1
        clip = clip_of(self.motions[index], f"clip {index}")
        return replace(clip, texts=SENTENCES, licence="CC0")


@pytest.fixture
def made(make_duet):
    return Made(make_duet)


def test_a_cache_gives_back_what_the_source_gave(made, tmp_path):
    cache = cached(made, tmp_path)
    assert (len(cache), cache.lengths, cache.fps) == (5, [20, 31, 16, 45, 12], 30)
    for i in range(5):
        clip, original = cache.clip(i), made.clip(i)
        assert (clip.name, clip.texts, clip.licence) == (f"clip {i}", SENTENCES, "CC0")
        for person, other in zip(clip.poses, original.poses, strict=True):
            np.testing.assert_allclose(person.positions, other.positions, atol=1e-6)
            np.testing.assert_allclose(person.rotations, other.rotations, atol=1e-6)
            assert person.contacts is None


def test_labels_are_cached(make_duet, tmp_path):
    source = Made(make_duet, lengths=(20,))
    labels = np.random.default_rng(0).random((20, 4)) < 0.5
    people = [replace(person, foot_contacts=labels) for person in source.motions[0].people]
    source.motions = [replace(source.motions[0], a=people[0], b=people[1])]
    contacts = cached(source, tmp_path).clip(0).poses[1].contacts
    assert contacts is not None
    np.testing.assert_array_equal(contacts, labels)


def test_a_cache_is_made_once_and_again_when_something_changes(made, make_duet, tmp_path):
    seen = []
    cached(made, tmp_path, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i, 5) for i in range(1, 6)]
    calls = made.calls
    cached(made, tmp_path)
    assert made.calls == calls
    slow = cached(made, tmp_path, fps=15)
    assert (slow.fps, slow.lengths) == (15, [10, 16, 8, 23, 6])
    cached(Made(make_duet, seed=1), tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def test_a_source_that_fails_leaves_nothing_behind(made, tmp_path):
    made.motions[3] = None
    with pytest.raises(AttributeError):
        cached(made, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_killed_build_is_not_taken_for_a_cache(make_duet, tmp_path):
    """Killed hard in the middle of writing; the next run builds the whole cache."""
    script = f"""
import os
from generator.data import Choreographed, cached
cached(Choreographed(3, interactions=("bow",)), {str(tmp_path)!r},
       progress=lambda done, total: os._exit(9) if done == 2 else None)
"""
    done = subprocess.run([sys.executable, "-c", script], check=False, env=dict(os.environ))
    assert done.returncode == 9
    from generator.data import Choreographed

    names = [path.name for path in tmp_path.iterdir()]
    assert len(names) == 1
    assert names[0].endswith(".partial")
    assert len(cached(Choreographed(3, interactions=("bow",)), tmp_path)) == 3


@pytest.mark.parametrize("damage", ["short", "index", "shape", "format", "lengths", "gone"])
def test_a_damaged_cache_is_named_and_never_used(made, tmp_path, damage):
    folder = cached(made, tmp_path).folder
    data, index = folder / "poses.npy", folder / "index.json"
    content = json.loads(index.read_text())
    if damage == "short":
        data.write_bytes(data.read_bytes()[:-1])
    elif damage == "index":
        index.write_text(index.read_text()[:-20])
    elif damage == "shape":
        np.save(data, np.zeros((124, 2, 7), np.float32))
    elif damage == "format":
        index.write_text(json.dumps({**content, "format": "pasdedeux.clips/0"}))
    elif damage == "lengths":
        content["clips"][-1]["frames"] += 1
        index.write_text(json.dumps(content))
    else:
        data.unlink()
    with pytest.raises(MotionFileError, match=folder.name):
        cached(made, tmp_path)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 20), min_size=1, max_size=6))
def test_running_statistics_are_those_of_all_rows(seed, sizes):
    rng = np.random.default_rng(seed)
    blocks = [rng.normal(3, 2, (size, 262)) + 1e3 for size in [*sizes, 2]]
    running = RunningStatistics(262)
    for block in blocks:
        running.add(block)
    rows = np.concatenate(blocks)
    result = running.result("non_canonical")
    np.testing.assert_allclose(result.mean, rows.mean(0), rtol=1e-12)
    np.testing.assert_allclose(result.std, np.maximum(rows.std(0), STD_FLOOR), rtol=1e-6)
    assert result.count == len(rows)


def test_statistics_are_symmetric_and_normalise_what_they_measured(made, tmp_path):
    statistics = measure(made, frames=300)
    assert statistics.count == 2 * 2 * 2 * sum(n - 1 for n in (20, 31, 16, 45, 12))
    x = POSITIONS.start + 3 * np.array([1, 2])  # left and right hip, lateral
    assert statistics.mean[x[0]] == pytest.approx(-statistics.mean[x[1]], abs=1e-9)
    assert statistics.std[x[0]] == pytest.approx(statistics.std[x[1]], rel=1e-9)
    features = encode(made.motions[3]).reshape(-1, 524)
    norm = statistics.normalise(features)
    assert np.abs(norm).mean() < 2
    np.testing.assert_allclose(statistics.denormalise(norm), features, atol=1e-12)
    np.testing.assert_allclose(
        norm[:, 262:], (features[:, 262:] - statistics.mean) / statistics.std, atol=1e-12
    )
    statistics.save(tmp_path / "s.json")
    loaded = FeatureStatistics.load(tmp_path / "s.json")
    np.testing.assert_array_equal(loaded.mean, statistics.mean)
    np.testing.assert_array_equal(loaded.std, statistics.std)
    assert (loaded.count, loaded.representation) == (statistics.count, "non_canonical")


def test_statistics_of_several_sets_and_of_the_canonical_features(made):
    both = measure([made, made])
    assert both.count == 2 * measure(made).count
    np.testing.assert_allclose(both.mean, measure(made).mean, atol=1e-12)
    assert measure(made, representation="canonical").mean.shape == (267,)


@pytest.mark.parametrize(
    "content",
    ["", "[]", '{"mean": [1]}', '{"mean": [1], "std": [1], "count": 1, "representation": "x"}',
     json.dumps({"mean": [0] * 262, "std": [0] * 262, "count": 1,
                 "representation": "non_canonical"})],
)  # fmt: skip
def test_files_that_are_no_statistics_are_named(tmp_path, content):
    (tmp_path / "s.json").write_text(content)
    with pytest.raises(MotionFileError, match=r"s\.json"):
        FeatureStatistics.load(tmp_path / "s.json")
    with pytest.raises(MotionFileError, match=r"none\.json"):
        FeatureStatistics.load(tmp_path / "none.json")


def plain(**changes):
    settings = {"size": 2, "frames": 24, "mirror": False, "swap": False}
    return BatchConfig(**{**settings, **changes})


def test_a_batch_has_features_masks_lengths_and_sentences(made, tmp_path):
    stream = BatchStream(cached(made, tmp_path), plain(size=4))
    batch = stream.batch(0)
    assert batch.x_raw.shape == (4, 24, 524)
    assert (batch.x_raw.dtype, batch.mask.dtype, batch.lengths.dtype) == (
        np.float32, np.float32, np.int64,
    )  # fmt: skip
    np.testing.assert_array_equal(batch.mask.sum(1), batch.lengths)
    assert sorted(batch.lengths) == [15, 19, 24, 24]
    assert set(batch.texts) <= set(SENTENCES)
    for i, name in enumerate(batch.names):
        n = batch.lengths[i]
        assert not batch.x_raw[i, n:].any()
        original = encode(made.motions[int(name.split()[1])]).reshape(-1, 524)
        if len(original) <= 24:
            np.testing.assert_allclose(batch.x_raw[i, :n], original, atol=1e-5)


def test_crops_are_put_into_place_by_themselves_on_the_floor_of_the_clip(made):
    stream = BatchStream([(made, 1.0)], plain(frames=10, shortest=2))
    starts = set()
    for g in range(60):
        features, _, name = stream.sample(g)
        clip = made.clip(int(name.split()[1]))
        assert len(features) == 10
        matches = [
            s
            for s in range(clip.frames - 10)
            if np.allclose(
                pair_features(
                    [p.cut(s, s + 11) for p in clip.poses], 30, floor=lowest(*clip.poses)
                ).reshape(10, 524),
                features,
                atol=1e-9,
            )
        ]
        assert len(matches) == 1
        starts.add((name, matches[0]))
    assert len(starts) > 20


def test_the_release_s_crops_have_a_frame_less_and_a_floor_each(make_duet):
    source = Made(make_duet, lengths=(20, 31))
    raised = source.motions[1].b
    raised = replace(raised, keypoints=raised.keypoints + np.array([0, 0, 0.4]))
    source.motions[1] = replace(source.motions[1], b=raised)
    config = replace(plain(frames=16, release_compat=True), swap=True)
    stream = BatchStream([(source, 1.0)], config)
    assert stream.batch(0).x_raw.shape[1] == 16
    assert stream.batch(0).lengths.tolist() == [15, 15]
    for g in range(10):
        features, text, name = stream.sample(g)
        assert text in SENTENCES  # the release exchanges people, not words
        poses = source.clip(int(name.split()[1])).poses
        candidates = [
            pair_features(
                [p.cut(s, s + 16) for p in pair], 30, canonical=canonical, release_compat=True
            )
            for s in range(poses[0].frames - 15)
            for pair in (poses, poses[::-1])
            for canonical in (0, 1)
        ]
        assert sum(np.allclose(c.reshape(15, 524), features, atol=1e-9) for c in candidates) == 1


def test_clips_that_are_too_short_are_left_out(made, tmp_path):
    stream = BatchStream(cached(made, tmp_path), plain())
    assert stream.epoch == 4
    assert {stream.sample(g)[2] for g in range(8)} == {"clip 0", "clip 1", "clip 2", "clip 3"}
    with pytest.raises(SpecError, match="none of 5"):
        BatchStream(cached(made, tmp_path), plain(shortest=100))


def test_every_clip_comes_once_per_epoch_in_another_order(made, tmp_path):
    stream = BatchStream(cached(made, tmp_path), plain(shortest=2))
    orders = [tuple(stream.sample(e * 5 + i)[2] for i in range(5)) for e in range(8)]
    assert all(len(set(order)) == 5 for order in orders)
    assert len(set(orders)) > 4
    other = BatchStream(cached(made, tmp_path), plain(shortest=2, seed=1))
    assert [tuple(other.sample(e * 5 + i)[2] for i in range(5)) for e in range(8)] != orders


def test_a_stream_resumes_exactly_and_in_any_order(made, tmp_path):
    cache = cached(made, tmp_path)
    config = BatchConfig(size=3, frames=12, seed=5)
    whole = [b for b, _ in zip(BatchStream(cache, config).batches(), range(9), strict=False)]
    resumed = next(BatchStream(cache, config).batches(start=7))
    np.testing.assert_array_equal(resumed.x_raw, whole[7].x_raw)
    assert (resumed.texts, resumed.names) == (whole[7].texts, whole[7].names)
    fresh = BatchStream(ClipCache(cache.folder), config)
    for step in (8, 2, 5):
        np.testing.assert_array_equal(fresh.batch(step).x_raw, whole[step].x_raw)


def test_processes_share_a_batch_without_changing_it(made, tmp_path):
    stream = BatchStream(cached(made, tmp_path), BatchConfig(size=4, frames=12))
    whole = stream.batch(3)
    parts = [stream.batch(3, rank=r, world=2) for r in range(2)]
    np.testing.assert_array_equal(np.concatenate([p.x_raw for p in parts]), whole.x_raw)
    assert parts[0].texts + parts[1].texts == whole.texts
    with pytest.raises(SpecError, match="world"):
        stream.batch(0, rank=0, world=3)


def test_a_mixture_keeps_its_weights_and_visits_evenly(make_duet, tmp_path):
    small = cached(Made(make_duet, lengths=(20, 21), seed=0), tmp_path)
    large = cached(Made(make_duet, lengths=tuple(range(22, 32)), seed=9), tmp_path)
    stream = BatchStream([(small, 1.0), (large, 3.0)], plain(), epoch=16)
    counts = Counter(len(stream.sample(g)[0]) + 1 for g in range(16 * 5))
    # 20 draws of the 2 small clips; 60 of the 10 large ones, of which those of 25 frames and more
    # are cut to 25: each clip as often as any other of its set.
    assert (counts[20], counts[21]) == (10, 10)
    assert (counts[22], counts[23], counts[24], counts[25]) == (6, 6, 6, 42)
    for epoch in range(3):
        part = [stream.sample(epoch * 16 + i) for i in range(16)]
        assert sum(len(features) + 1 in small.lengths for features, _, _ in part) == 4


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.01, 100), min_size=1, max_size=6), st.integers(1, 1000))
def test_shares_add_up_and_are_next_to_the_weights(weights, total):
    shares = _shares(weights, total)
    assert sum(shares) == total
    ideal = np.array(weights) / sum(weights) * total
    assert np.abs(shares - ideal).max() < 1 + 1e-9


def test_mixtures_that_cannot_be_are_refused(made, tmp_path):
    cache = cached(made, tmp_path)
    with pytest.raises(SpecError, match="weights"):
        BatchStream([(cache, 0.0)])
    with pytest.raises(SpecError, match="weights"):
        BatchStream([])
    with pytest.raises(SpecError, match="15 and 30"):
        BatchStream([(cache, 1.0), (cached(made, tmp_path, fps=15), 1.0)], plain(shortest=2))


def test_augmentation_draws_all_symmetries_with_their_sentences(make_duet):
    source = Made(make_duet, lengths=(20,))
    stream = BatchStream([(source, 1.0)], BatchConfig(size=1, frames=30))
    poses = source.clip(0).poses
    seen = Counter()
    for g in range(200):
        features, text, _ = stream.sample(g)
        if "hand" not in text:
            continue
        mirror, swap = "right" in text, "second" in text
        assert text == (
            f"the {'second' if swap else 'first'} person raises the"
            f" {'right' if mirror else 'left'} hand"
        )
        pair = [mirror_poses(person) if mirror else person for person in poses]
        pair = pair[::-1] if swap else pair
        fits = [
            np.allclose(pair_features(pair, 30, canonical=c).reshape(19, 524), features, atol=1e-9)
            for c in (0, 1)
        ]
        assert sum(fits) == 1
        seen[mirror, swap, fits[1]] += 1
    assert len(seen) == 8
    assert min(seen.values()) > 4


def test_canonical_features_come_in_their_width(made):
    stream = BatchStream([(made, 1.0)], plain(representation="canonical", shortest=2, frames=50))
    batch = stream.batch(0)
    assert batch.x_raw.shape == (2, 50, 534)
    features, _, name = stream.sample(0)
    expected = to_canonical(encode(made.motions[int(name.split()[1])]))
    np.testing.assert_allclose(features.reshape(-1, 2, 267), expected, atol=1e-9)


def test_padding_to_the_longest_saves_frames(made):
    stream = BatchStream([(made, 1.0)], plain(pad="longest", frames=300, shortest=2))
    for step in range(4):
        batch = stream.batch(step)
        assert batch.x_raw.shape[1] == batch.lengths.max() == batch.mask.shape[1]


def test_a_short_clip_in_a_set_of_unknown_lengths_is_named(made):
    stream = BatchStream([(made, 1.0)], plain(size=5))
    with pytest.raises(Exception, match=r"clip 4.*12 frames.*cache"):
        stream.batch(0)


@pytest.mark.parametrize(
    "change",
    [{"size": 0}, {"frames": 1}, {"shortest": 0}, {"seed": -1}, {"pad": "none"},
     {"representation": "polar"}],
)  # fmt: skip
def test_absurd_configurations_are_refused(change):
    with pytest.raises(SpecError, match=next(iter(change))):
        BatchConfig(**change)


def test_the_data_needs_no_torch():
    script = "import generator.data, sys; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True, env=dict(os.environ))
