"""Metrics: against the release's vectors, against closed forms, at their edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from generator.metrics import (
    RELEASE,
    confidence_interval,
    distances,
    diversity,
    fid,
    mm_dist,
    multimodality,
    r_precision,
)


@pytest.fixture(scope="module")
def arrays(golden):
    with np.load(golden / "metrics.npz", allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def test_parity_of_retrieval(arrays):
    text, motion = arrays["text_emb"], arrays["motion_emb"]
    np.testing.assert_allclose(distances(text, motion), arrays["dist_mat"], rtol=1e-6)
    for k in range(3):  # the release keeps a table of hits per text
        for i in range(0, 96, 7):
            rank = (distances(text[i : i + 1], motion)[0] < arrays["dist_mat"][i, i] - 1e-5).sum()
            assert (rank <= k) == arrays["top_k_mat"][i, k]
    precision = r_precision(text, motion, pool=RELEASE.pool)
    np.testing.assert_allclose(precision, arrays["r_precision"], atol=1e-6)
    assert mm_dist(text, motion) == pytest.approx(float(arrays["mm_dist"]), rel=1e-6)


def test_parity_of_fid(arrays):
    value = fid(arrays["gt_act"], arrays["gen_act"], scale=RELEASE.fid_scale)
    assert value == pytest.approx(float(arrays["fid"]), rel=1e-6)


def test_parity_of_the_random_pairs(arrays):
    value = diversity(arrays["gt_act"], rng=np.random.RandomState(5), scale=RELEASE.diversity_scale)
    assert value == pytest.approx(float(arrays["diversity_seed5"]), rel=1e-6)
    value = multimodality(arrays["mm_act"], rng=np.random.RandomState(6))
    assert value == pytest.approx(float(arrays["multimodality_seed6"]), rel=1e-6)


def test_parity_of_the_interval(arrays):
    mean, half = confidence_interval(arrays["rep"])
    assert mean == pytest.approx(float(arrays["rep_mean"]), rel=1e-6)
    assert half == pytest.approx(float(arrays["rep_ci"]), rel=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_fid_is_that_of_the_matrix_root(seed):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(60, 4)) @ rng.normal(size=(4, 4))
    b = rng.normal(size=(50, 4)) @ rng.normal(size=(4, 4)) + rng.normal(size=4)
    root = np.real(linalg.sqrtm(np.cov(a.T) @ np.cov(b.T)))
    gap = a.mean(0) - b.mean(0)
    expected = gap @ gap + np.trace(np.cov(a.T) + np.cov(b.T) - 2 * root)
    assert fid(a, b) == pytest.approx(expected, rel=1e-6, abs=1e-8)
    assert fid(a, b) == pytest.approx(fid(b, a), rel=1e-6, abs=1e-8)
    assert fid(a, b, scale=6) == pytest.approx(36 * fid(a, b), rel=1e-6)


def test_fid_is_zero_for_the_same_set_and_the_squared_shift_for_a_moved_one():
    x = np.random.default_rng(0).normal(size=(10, 30))  # fewer samples than dimensions
    assert abs(fid(x, x)) < 1e-5
    assert fid(x, x + 2) == pytest.approx(4 * 30, abs=1e-4)


def test_a_perfect_embedding_scores_1_and_a_random_one_k_in_pool():
    rng = np.random.default_rng(1)
    text = rng.normal(size=(3200, 8))
    np.testing.assert_array_equal(r_precision(text, text), 1)
    chance = r_precision(text, rng.normal(size=(3200, 8)), pool=32)
    np.testing.assert_allclose(chance, np.arange(1, 4) / 32, atol=0.015)


def test_equal_motions_do_not_count_as_found():
    constant = np.zeros((32, 4))
    np.testing.assert_array_equal(r_precision(constant, constant), 0)


def test_the_pool_changes_the_number_and_the_rest_is_left_out():
    rng = np.random.default_rng(2)
    text = rng.normal(size=(100, 8))
    motion = text + rng.normal(size=(100, 8))
    assert r_precision(text, motion, pool=10)[0] > r_precision(text, motion, pool=100)[0]
    np.testing.assert_array_equal(
        r_precision(text, motion, pool=32), r_precision(text[:96], motion[:96], pool=32)
    )


def test_diversity_and_multimodality_of_known_sets():
    x = np.zeros((300, 2))
    assert diversity(x, rng=np.random.default_rng(0)) == 0
    clusters = np.repeat(np.eye(5)[:, None], 20, axis=1)
    assert multimodality(clusters, rng=np.random.default_rng(0)) == 0
    wide = np.random.default_rng(0).normal(size=(2000, 50))
    assert diversity(wide, rng=np.random.default_rng(0)) == pytest.approx(10, rel=0.02)


@pytest.mark.parametrize(
    "call",
    [
        lambda: r_precision(np.zeros((10, 2)), np.zeros((10, 2))),
        lambda: mm_dist(np.zeros((10, 2)), np.zeros((9, 2))),
        lambda: fid(np.zeros((1, 2)), np.zeros((5, 2))),
        lambda: fid(np.zeros((5, 2)), np.zeros((5, 3))),
        lambda: diversity(np.zeros((10, 2)), rng=np.random.default_rng(0)),
        lambda: multimodality(np.zeros((3, 5, 2)), rng=np.random.default_rng(0)),
        lambda: confidence_interval([]),
    ],
)
def test_too_little_is_refused(call):
    with pytest.raises(ValueError):
        call()
