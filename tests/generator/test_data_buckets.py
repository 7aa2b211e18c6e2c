"""Batches of like length, sentences of turned clips, and on whom the frame is put."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from generator.data import BatchConfig, BatchStream, Clip, Symmetric, cached, clip_of
from generator.features import POSITIONS, Poses
from robots.errors import MotionError, SpecError

TURNED = Symmetric(("mirrored",), ("swapped",), ("both",))


class Still:
    """Clips that stand still, of any lengths: cheap, and only their lengths differ."""

    def __init__(self, lengths):
        self._lengths = lengths

    def __len__(self):
        return len(self._lengths)

    def clip(self, index):
        frames = self._lengths[index]
        points = np.zeros((frames, 22, 3))
        points[:, 1, 0], points[:, 2, 0], points[..., 1] = 0.1, -0.1, 1.0
        poses = Poses(points, np.tile([1.0, 0, 0, 1, 0, 0], (frames, 21, 1)))
        return Clip(f"still {index}", (poses, poses), 30.0)


def stream(lengths, **changes):
    settings = {"size": 4, "frames": 100, "shortest": 2, "pad": "longest", **changes}
    return BatchStream(Still(lengths), BatchConfig(**settings))


@given(st.lists(st.integers(5, 60), min_size=3, max_size=40), st.integers(1, 5), st.integers(0, 9))
@settings(max_examples=25, deadline=None)
def test_buckets_deal_out_every_sample_of_their_window_once(lengths, bucket, seed):
    dealt = stream(lengths, bucket=bucket, seed=seed)
    numbers = [dealt._numbers(step) for step in range(2 * bucket)]
    assert sorted(n for batch in numbers[:bucket] for n in batch) == list(range(4 * bucket))
    assert sorted(n for batch in numbers for n in batch) == list(range(8 * bucket))
    spans = [[dealt._length(n) for n in batch] for batch in numbers[:bucket]]
    spans.sort(key=lambda span: (span[0], span[-1]))
    assert all(one[-1] <= other[0] for one, other in pairwise(spans))


def test_buckets_leave_less_to_pad():
    lengths = np.random.default_rng(0).integers(50, 150, 200).tolist()
    padded = {}
    for bucket in (1, 8):
        dealt = stream(lengths, bucket=bucket, frames=150)
        batches = [[dealt._length(n) for n in dealt._numbers(step)] for step in range(48)]
        padded[bucket] = 1 - np.sum(batches) / sum(len(b) * max(b) for b in batches)
    assert padded[1] > 0.15
    assert padded[8] < 0.05


def test_buckets_are_the_same_from_anywhere_and_for_any_number_of_processes(make_duet, tmp_path):
    class Source:
        name = fingerprint = "duets"

        def __len__(self):
            return 7

        def clip(self, index):
            return clip_of(make_duet(frames=12 + 5 * index, seed=index), f"{index}")

    cache = cached(Source(), tmp_path)
    config = BatchConfig(size=4, frames=40, shortest=2, pad="longest", bucket=3)
    whole = BatchStream(cache, config).batch(4)
    again = BatchStream(cache, config)
    parts = [again.batch(4, rank=rank, world=2) for rank in (0, 1)]
    assert whole.names == parts[0].names + parts[1].names
    for row, (part, i) in enumerate([(p, i) for p in parts for i in range(2)]):
        length = whole.lengths[row]
        assert length == part.lengths[i]
        np.testing.assert_array_equal(whole.x_raw[row, :length], part.x_raw[i, :length])


def test_turned_clips_have_the_sentences_that_the_source_gave_them(make_duet, tmp_path):
    clip = replace(clip_of(make_duet(frames=20)), texts=("plain",), symmetric=TURNED)

    class Source:
        name = fingerprint = "one"

        def __len__(self):
            return 1

        def clip(self, index):
            return clip

    cache = cached(Source(), tmp_path)
    assert cache.clip(0).symmetric == TURNED
    drawn = BatchStream(cache, BatchConfig(size=2, frames=12, frame="first"), epoch=64)
    said = {}
    for number in range(64):
        features, text, _ = drawn.sample(number)
        first = features[:, POSITIONS].reshape(-1, 22, 3)[0, 0]
        assert abs(first[[0, 2]]).max() < 1e-6, "the frame is not on the first person"
        said.setdefault(text, features[0].sum())
    assert set(said) == {"plain", "mirrored", "swapped", "both"}
    assert len({round(total, 6) for total in said.values()}) == 4, "a sentence of another motion"


def test_a_clip_without_a_sentence_for_a_symmetry_is_refused(make_duet):
    with pytest.raises(MotionError, match="no sentence"):
        replace(clip_of(make_duet()), texts=("a",), symmetric=Symmetric(("b",), (), ("c",)))


@pytest.mark.parametrize("change", [{"bucket": 0}, {"frame": "second"}])
def test_settings_that_make_no_batches_are_refused(change):
    with pytest.raises(SpecError, match=next(iter(change))):
        BatchConfig(**change)
