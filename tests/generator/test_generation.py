"""Sequences, manner and takes, on a model whose motions are known: a Gaussian process in time.

Its network is the exact denoiser of smooth random motions around a mean that the text decides, so
what a draw should be is known without training anything.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from generator.architecture import DenoiserConfig
from generator.diffusion import cosine_alphas
from generator.features import POSITIONS, ROTATIONS, encode, from_sixd
from generator.io import write_motion
from generator.motion import DuetMotion
from generator.provenance import Provenance
from generator.runtime import (
    DiffusionRequest,
    Portable,
    Sampling,
    Steering,
    draw,
    generate,
    generate_group,
)
from generator.runtime.accents import accents_of
from generator.runtime.group import ROOM, nearest_strangers
from generator.runtime.network import Accent, GuidedNetwork, halves
from generator.runtime.takes import features_at, stretched
from robots.errors import SpecError

FPS, LONGEST, SMOOTH, SPREAD = 15.0, 40, 5.0, 0.03
WORDS = 8


@cache
def kernel(frames: int) -> np.ndarray:
    """Covariance of a smooth process and its eigenvectors: a Gaussian of time."""
    t = np.arange(frames)
    covariance = np.exp(-((t[:, None] - t) ** 2) / (2 * SMOOTH**2)) + 1e-6 * np.eye(frames)
    values, vectors = np.linalg.eigh(covariance)
    return np.concatenate([values[None], vectors])


class SmoothMotions:
    """E[x0 | x_t] of ``mean(cond)`` plus a smooth process, the same for every feature."""

    def __call__(self, x, t, cond):
        values, vectors = kernel(x.shape[1])[0], kernel(x.shape[1])[1:]
        abar = cosine_alphas()[t][:, None, None]
        mean = cond.sum(axis=1)[:, None, None]
        seen = np.einsum("ij,bjf->bif", vectors.T, x - np.sqrt(abar) * mean)
        gain = np.sqrt(abar) * values[:, None] / (abar * values[:, None] + 1 - abar)
        return (mean + np.einsum("ij,bjf->bif", vectors, gain * seen)).astype(np.float32)


class Encoder:
    """A vector that knows of one word alone: how vigorous a sentence is."""

    def encode(self, sentences):
        out = np.zeros((len(sentences), WORDS), np.float32)
        for row, sentence in zip(out, sentences, strict=True):
            row[0] = ("vigorously" in sentence) - ("gently" in sentence)
        return out


@pytest.fixture
def model(make_duet, monkeypatch) -> Portable:
    """A model of smooth motions around a standing pair."""
    features = encode(make_duet(60, fps=FPS))
    heights = features[:, 0].mean(axis=0)[1:66:3]
    features[..., 1:66:3] -= heights.min() - 2 * SPREAD  # so low that the feet get to the floor
    portable = Portable(
        DenoiserConfig(width=8, layers=1, heads=1, feedforward=8, text_width=WORDS),
        SmoothMotions(),  # type: ignore[arg-type]
        features[:, 0].mean(axis=0).astype(np.float32),  # both stand where a canonical person does
        np.full(262, SPREAD, np.float32),
        Provenance("smooth", "CC0", FPS, {}),
        Sampling(frames=LONGEST, guidance=1.0),
        "none",
    )
    monkeypatch.setattr(Portable, "load", lambda *args, **kwargs: portable)
    return portable


def made(text: str = "they sway", seed: int = 0, **wishes) -> tuple[DuetMotion, dict]:
    request = DiffusionRequest(weights="x", **wishes)
    return generate(text, request, seed=seed, encoder=Encoder())


def discontinuity(motion: DuetMotion) -> np.ndarray:
    velocity = np.diff(motion.keypoints, axis=0) * motion.fps
    return np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max(axis=(1, 2))


def test_a_choreography_has_no_jump_where_parts_meet(model) -> None:
    motion, facts = made(then=("they sway",) * 4, frames=27)
    assert motion.frames == 135
    assert facts["windows"] == 5
    assert [part["end"] for part in facts["parts"]] == [1.8, 3.6, 5.4, 7.2, 9]
    alone = np.concatenate([discontinuity(made(seed=s, frames=LONGEST)[0]) for s in range(12)])
    overlap = 13
    ends = np.array([27, 54, 81, 108])
    edges = np.concatenate([ends - overlap, ends])
    at = discontinuity(motion)[(edges[:, None] + np.arange(-2, 1)).ravel()]
    assert at.max() < np.percentile(alone, 99), "a jump at a seam"


def test_limbs_are_turned_as_they_were_drawn(model) -> None:
    """Positions do not tell the spin of a bone, nor where a head looks."""
    motion, _ = made(frames=20)
    drawn = draw(model, Encoder().encode(["they sway"]), 20, model.sampling.sampler(), seed=0)[0]
    kept, true = (
        from_sixd(features[..., ROTATIONS].reshape(-1, 6))
        for features in (encode(motion), drawn[:-1])
    )
    np.testing.assert_allclose(kept, true, atol=1e-6)


def test_what_was_drawn_before_is_what_the_next_part_goes_on_from(model) -> None:
    """Without the held beginning the parts know nothing of each other."""
    whole, _ = made(then=("they sway",), frames=27)
    first, _ = made(frames=27)
    np.testing.assert_allclose(whole.keypoints[:14], first.keypoints[:14], atol=1e-9)
    away = np.linalg.norm(whole.keypoints - first.keypoints[-1], axis=-1).mean(axis=(1, 2))
    assert away[26] < 0.4 * away[45:].mean()


def test_a_sequence_has_no_longest_length_and_repeats_exactly(model) -> None:
    motion, facts = made(seconds=60, seed=2)
    assert motion.frames == 900
    assert facts["windows"] == 33
    again, _ = made(seconds=60, seed=2)
    np.testing.assert_array_equal(motion.keypoints, again.keypoints)
    assert motion.text == "they sway"
    heights = motion.keypoints[..., 2].mean(axis=(1, 2))
    assert abs(heights[-100:].mean() - heights[:100].mean()) < 0.05, "the floor drifts"


def test_what_no_motion_file_holds_is_refused_before_it_is_drawn(model) -> None:
    with pytest.raises(SpecError, match="up to 100000"):
        made(seconds=3400)
    with pytest.raises(SpecError, match="--seed"):
        made(seed=-1)


def test_parts_that_are_shorter_than_a_seam_are_refused(model) -> None:
    with pytest.raises(SpecError, match=r"more than the 0\.87 s"):
        made(then=("they sway",), seconds=0.8)
    assert made(then=("they sway",), seconds=1)[0].frames == 30


def test_each_part_is_of_its_own_sentence(model) -> None:
    motion, _ = made("they sway gently.", then=("they sway vigorously.",), frames=39)
    assert motion.text == "they sway gently, then they sway vigorously"
    height = (motion.keypoints[..., 2].mean(axis=(1, 2)) - model.mean[1:66:3].mean()) / SPREAD
    assert height[:20].mean() < -0.5
    assert height[60:].mean() > 0.5


def test_the_tempo_is_how_fast_it_is_played(model) -> None:
    plain, _ = made(seconds=2)
    fast, facts = made(seconds=2, tempo=1.3)
    assert fast.fps == pytest.approx(FPS * 1.3)
    assert fast.duration == pytest.approx(plain.duration, abs=0.1), "not as long as asked for"
    assert facts["tempo"] == 1.3
    unasked, slow = made()[0], made(tempo=0.7)[0]
    assert slow.duration == pytest.approx(unasked.duration / 0.7)
    np.testing.assert_array_equal(slow.keypoints, unasked.keypoints)
    for name, value in (("tempo", 3.0), ("energy", 0.1), ("amplitude", 2.0)):
        with pytest.raises(SpecError, match=rf"--{name}: .*allowed"):
            replace(DiffusionRequest(), **{name: value})


def test_energy_is_as_much_as_its_adverb_says(model) -> None:
    """1.35 is the middle of the range in which training said *vigorously*."""

    def level(**wishes) -> float:
        features = draw_for(model, DiffusionRequest(weights="x", **wishes))
        return float(features.mean())

    plain, middle = level(), level(energy=1.35)
    assert middle - plain == pytest.approx(1, abs=0.01)
    assert level(energy=1.175) - plain == pytest.approx(0.5, abs=0.01)
    assert level(energy=0.65) - plain == pytest.approx(-1, abs=0.01)
    assert level(guidance=2.0, energy=1.35) - plain == pytest.approx(2, abs=0.02)
    assert level(amplitude=1.35) - plain == pytest.approx(0, abs=0.01), "no such word here"


def draw_for(model: Portable, request: DiffusionRequest) -> np.ndarray:
    accents = accents_of("they sway", request, Encoder())
    sampler = model.sampling.sampler(guidance=request.guidance)
    cond = Encoder().encode(["they sway."])
    drawn = draw(model, cond, 30, sampler, seed=1, steering=Steering(accents=accents))
    return (drawn - model.mean) / model.std


def test_branches_of_guidance_are_weighed_as_they_should(model) -> None:
    config = replace(model.sampling.sampler(), guidance=3.0, guidance_interval=(100, 900))
    x = np.random.default_rng(0).standard_normal((1, 5, 524)).astype(np.float32)
    text, word = np.full((1, WORDS), 0.1, np.float32), np.full((1, WORDS), 0.3, np.float32)
    one = SmoothMotions()
    outcomes = [one(x, np.array([500]), c) for c in (np.zeros_like(text), text, word)]
    guided = GuidedNetwork(one, text, config, (Accent(word, 0.5),))  # type: ignore[arg-type]
    expected = outcomes[0] + 3 * (outcomes[1] - outcomes[0]) + 1.5 * (outcomes[2] - outcomes[1])
    np.testing.assert_allclose(guided(x, 500), expected, atol=1e-5)
    np.testing.assert_allclose(guided(x, 950), one(x, np.array([950]), text), atol=1e-6)


def test_each_person_is_drawn_for_a_text_of_their_own(model) -> None:
    config = replace(model.sampling.sampler(), guidance=3.0, guidance_interval=(100, 900))
    x = np.random.default_rng(0).standard_normal((1, 5, 524)).astype(np.float32)
    text, other = np.full((1, WORDS), 0.1, np.float32), np.full((1, WORDS), 0.3, np.float32)
    first, second = halves(524)
    accents = (Accent(other, 0.2 * first), Accent(text, 0.2 * second))
    one: Any = SmoothMotions()
    for step in (500, 950):
        for more in ((), accents):
            found = GuidedNetwork(one, text, config, more, other)(x, step)
            louder = [(Accent(cond, 0.2),) if more else () for cond in (other, text)]
            of_a = GuidedNetwork(one, text, config, louder[0])
            of_b = GuidedNetwork(one, other, config, louder[1])
            np.testing.assert_allclose(found[..., :262], of_a(x, step)[..., :262], atol=1e-5)
            np.testing.assert_allclose(found[..., 262:], of_b(x, step)[..., 262:], atol=1e-5)
            assert np.abs(of_a(x, step) - of_b(x, step)).max() > 0.01


def apart(one: DuetMotion, other: DuetMotion) -> float:
    """Return the mean distance of keypoints, each seen from where its motion begins, m."""
    points = [features_at(motion, FPS)[..., POSITIONS].reshape(-1, 3) for motion in (one, other)]
    return float(np.linalg.norm(points[0] - points[1], axis=-1).mean())


@pytest.mark.parametrize("by_file", [False, True])
def test_a_liked_take_comes_nearer_and_an_unliked_one_goes_away(model, tmp_path, by_file) -> None:
    take, _ = made(seed=7, frames=30)
    name = "7"
    if by_file:
        name = str(tmp_path / "take.npz")
        write_motion(take, name)
    for seed in range(4):
        free, _ = made(seed=seed, frames=30)
        like, facts = made(seed=seed, frames=30, like=(name,))
        unlike, _ = made(seed=seed, frames=30, unlike=(name,))
        assert 0.002 < apart(like, take) < 0.75 * apart(free, take) < 0.75 * apart(unlike, take)
        assert facts["like"] == [name]
        again, _ = made(seed=seed, frames=30, like=(name,))
        np.testing.assert_array_equal(like.keypoints, again.keypoints)
    several, _ = made(seed=1, frames=30, like=("9", name))
    assert apart(several, take) < 0.75 * apart(made(seed=1, frames=30)[0], take)


def test_a_variation_is_as_long_as_its_take(model, tmp_path) -> None:
    take, _ = made(seed=7, frames=25)
    write_motion(take, tmp_path / "take.npz")
    like, _ = made(seed=1, like=(str(tmp_path / "take.npz"),))
    assert abs(like.frames - take.frames) <= 1
    with pytest.raises(SpecError, match="seed"):
        made(like=("nowhere.npz",))
    with pytest.raises(SpecError, match=re.escape("--like with --then")):
        made(like=("1",), then=("they bow",))
    with pytest.raises(SpecError, match="2 to 40"):
        made(like=("1",), frames=100)


def test_a_stretched_take_takes_all_of_the_time(make_duet) -> None:
    duet = make_duet(41, fps=30.0)
    features = features_at(duet, FPS)
    assert len(features) == 20
    longer = stretched(features, 39)
    np.testing.assert_allclose(longer[[0, -1]][..., POSITIONS], features[[0, -1]][..., POSITIONS])
    steps = np.diff(longer[..., POSITIONS], axis=0)
    moves = longer[:-1, ..., 66:132]
    assert np.abs(steps - moves).max() < 0.02
    np.testing.assert_array_equal(stretched(features, 20), features)


def test_a_group_is_pairs_that_share_their_people_and_keep_away_from_others(model) -> None:
    request = DiffusionRequest(weights="x", people=4, frames=30)
    duets, facts = generate_group("they sway", request, seed=3, encoder=Encoder())
    assert list(duets) == ["ab", "bc", "cd"]
    assert facts["people"] == 4
    for one, next_one in (("ab", "bc"), ("bc", "cd")):
        np.testing.assert_array_equal(duets[one].b.keypoints, duets[next_one].a.keypoints)
    for motion in duets.values():
        assert discontinuity(motion).max() < 3
    assert nearest_strangers(list(duets.values())) > ROOM - 1e-6
    alone, _ = made(seed=3, frames=30)
    np.testing.assert_allclose(duets["ab"].keypoints, alone.keypoints, atol=1e-9)
    # Left to itself, the model puts c before b, where a is.
    free = duets["bc"].b.keypoints[:, 0, :2] - duets["ab"].a.keypoints[:, 0, :2]
    assert np.linalg.norm(free, axis=-1).min() < 3
    with pytest.raises(SpecError, match="up to 40 frames"):
        generate_group("they sway", replace(request, frames=41), encoder=Encoder())
    with pytest.raises(SpecError, match="2 to 8"):
        DiffusionRequest(people=9)
