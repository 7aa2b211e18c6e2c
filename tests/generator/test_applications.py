"""Person-to-person, trajectories, in-betweening: what is given is kept exactly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from generator.applications import FREEZE, Draw, Keep, generate_around, kind_of, sample_around
from generator.architecture import DenoiserConfig
from generator.diffusion import SamplerConfig
from generator.features import POSITIONS, VELOCITIES, encode
from generator.given import (
    Given,
    Track,
    cut_motion,
    given_ends,
    given_person,
    given_tracks,
    track_of,
)
from generator.intergen import IntergenRequest, frames_of, generate, given_of, sampler_of
from generator.io import write_motion
from generator.model import InterGen
from generator.motion import DuetMotion
from generator.paths import read_part, read_track
from generator.provenance import Provenance
from robots.errors import CheckpointError, MotionError, MotionFileError, PromptError, SpecError

FPS = 30.0
EXACT = 1e-6
"""What was asked to be frozen is that exact, m."""


class Words:
    """A sentence encoder whose vectors depend on the sentence."""

    def encode(self, sentences: Any) -> np.ndarray:
        rows = [np.random.default_rng(len(s)).standard_normal(8) for s in sentences]
        return np.array(rows, np.float32)


@pytest.fixture(scope="module")
def model(make_duet: Any) -> InterGen:
    """A small model with random weights everywhere (a fresh one predicts zeros) and statistics."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    config = DenoiserConfig(width=16, layers=2, heads=2, feedforward=16, text_width=8)
    features = encode(make_duet(frames=60, seed=9)).reshape(-1, 262)
    made = InterGen(
        config,
        mean=features.mean(axis=0),
        std=features.std(axis=0) + 0.05,
        text=Words(),
        provenance=Provenance("test", "CC0", FPS),
    )
    for parameter in made.parameters():
        parameter.data.normal_(0, 0.1)
    return made.eval()


@pytest.fixture
def duet(make_duet: Any) -> DuetMotion:
    """Somewhere in the world, not at its origin, turned, and not on the floor."""
    return make_duet(frames=24, seed=3)


FEW = Draw(sampler=SamplerConfig(steps=4))


def around(model: InterGen, given: Given, text: str = "hug", **draw: Any) -> DuetMotion:
    return generate_around(model, [text], given, seed=1, draw=replace(FEW, **draw))


@pytest.mark.parametrize("person", ["a", "b"])
@pytest.mark.parametrize("smoothing", [0.0, 1.0])
def test_a_given_person_comes_out_where_and_as_it_was(
    model: InterGen, duet: DuetMotion, person: Any, smoothing: float
) -> None:
    motion = around(model, given_person(duet, person, FPS), smoothing=smoothing)
    at = "ab".index(person)
    assert motion.frames == duet.frames
    assert np.abs(motion.people[at].keypoints - duet.people[at].keypoints).max() < EXACT
    other = motion.people[1 - at].keypoints - duet.people[1 - at].keypoints
    assert np.abs(other).max() > 0.01


def test_the_last_frame_goes_on_as_it_moved(duet: DuetMotion) -> None:
    """Features hold a step to the next frame; the last frame has none, but is kept."""
    given = given_person(duet, "a", FPS)
    steps = given.values[:, 0, VELOCITIES]
    assert given.frames == duet.frames
    assert np.allclose(steps[-1], steps[-2])
    assert np.abs(steps[-1]).max() > 1e-4


def test_the_partner_depends_on_who_is_given(model: InterGen, make_duet: Any) -> None:
    given = [given_person(make_duet(frames=24, seed=s), "a", FPS) for s in (3, 4)]
    given[1] = replace(given[1], placement=given[0].placement)
    first, second = (around(model, one).b.keypoints for one in given)
    assert np.abs(first - second).max() > 1e-3


def test_the_sentence_still_matters(model: InterGen, duet: DuetMotion) -> None:
    given = given_person(duet, "a", FPS)
    texts = [around(model, given, text).b.keypoints for text in ("hug", "they bow", "")]
    assert np.abs(texts[0] - texts[1]).max() > 1e-3
    assert np.abs(texts[0] - texts[2]).max() > 1e-3


def test_the_same_seed_gives_the_same_duet(model: InterGen, duet: DuetMotion) -> None:
    given = given_person(duet, "a", FPS)
    first, second = (around(model, given).keypoints for _ in range(2))
    assert np.array_equal(first, second)
    other = generate_around(model, ["hug"], given, seed=2, draw=FEW)
    assert np.abs(other.b.keypoints - first[:, 1]).max() > 1e-3


CIRCLE = Track(
    np.linspace(0, 2, 20),
    np.stack([3 + np.cos(np.linspace(0, 3, 20)), -2 + np.sin(np.linspace(0, 3, 20))], axis=1),
)
LINE = Track(np.array([0.0, 2.0]), np.array([[1.0, 1.0], [2.0, 1.5]]))


@pytest.mark.parametrize("tracks", [(CIRCLE, None), (None, LINE), (CIRCLE, LINE)])
@pytest.mark.parametrize("smoothing", [0.0, 1.0])
def test_the_pelvis_follows_a_given_path(model: InterGen, tracks: tuple, smoothing: float) -> None:
    motion = around(model, given_tracks(tracks, 40, FPS), smoothing=smoothing)
    for track, person in zip(tracks, motion.people, strict=True):
        if track is not None:
            error = person.keypoints[:, 0, :2] - track.at(40, FPS)
            assert np.abs(error).max() < EXACT


def test_the_body_moves_along_with_its_pelvis(model: InterGen, duet: DuetMotion) -> None:
    """A path put in for the pelvis alone would tear it out of the body."""
    features = encode(duet)
    frames = len(features)
    given = given_tracks((LINE, None), frames, FPS)
    clean = model.normalise(torch.tensor(features, dtype=torch.float32).flatten(1)[None])
    moved = model.denormalise(Keep(model, given)(clean, 0)).unflatten(-1, (2, 262)).numpy()[0]
    before, after = (x[:, 0, POSITIONS].reshape(-1, 22, 3) for x in (features, moved))
    assert np.abs(after[:, 0, ::2] - given.values[:, 0, [0, 2]]).max() < 1e-5
    assert np.abs(after[:, 0, ::2] - before[:, 0, ::2]).max() > 0.3
    assert np.abs((after - after[:, :1]) - (before - before[:, :1]))[..., ::2].max() < 1e-5
    assert np.abs(after[..., 1] - before[..., 1]).max() < 1e-5
    assert np.abs(moved[:, 1] - features[:, 1]).max() < 1e-5
    # What moves with the path also has its speed.
    steps = (moved - features)[:-1, 0, VELOCITIES].reshape(-1, 22, 3)
    assert np.abs(steps - np.diff(after - before, axis=0)).max() < 1e-5


def test_steps_of_a_moved_body_are_those_of_its_path(model: InterGen) -> None:
    given = given_tracks((CIRCLE, None), 30, FPS)
    drawn = sample_around(model, None, given, seed=0, draw=FEW)
    raw = model.denormalise(drawn[0]).unflatten(-1, (2, 262)).numpy()[:, 0]
    pelvis, steps = raw[:, POSITIONS][:, [0, 2]], raw[:, VELOCITIES][:, [0, 2]]
    assert np.abs(np.diff(pelvis, axis=0) - steps[:-1]).max() < 1e-5


def test_a_path_faces_where_it_leads_or_as_it_says() -> None:
    for angle in (0.0, 1.0, -2.5):
        points = np.array([[1.0, 2.0], [1 + np.cos(angle), 2 + np.sin(angle)]])
        for track in (
            Track(np.array([0.0, 0.5]), points),
            Track(np.array([0.0, 0.5]), points[::-1].copy(), facing=angle),
        ):
            given = given_tracks((track, None), 16, FPS)
            ahead = given.placement.turn(np.array([np.sin(angle), 0.0, np.cos(angle)]))
            assert np.allclose(ahead, [0, 0, 1], atol=1e-12)
    still = Track(np.array([0.0, 1.0]), np.zeros((2, 2)))
    there = Track(np.array([0.0, 1.0]), np.array([[0.0, 3.0], [0.0, 3.0]]))
    given = given_tracks((still, there), 8, FPS)
    assert np.allclose(given.values[0, 1, [0, 2]], [0, 3])


def test_the_path_of_a_motion_has_its_points_and_facing(duet: DuetMotion) -> None:
    for person in ("a", "b"):
        track = track_of(duet, person)
        points = duet.people["ab".index(person)].keypoints
        assert np.allclose(track.at(duet.frames, FPS), points[:, 0, :2])
        given = given_tracks((track, None), duet.frames, FPS)
        whole = given_person(duet, person, FPS)
        assert given.placement.yaw == pytest.approx(whole.placement.yaw)
        at = "ab".index(person)
        assert np.allclose(given.values[:, 0, [0, 2]], whole.values[:, at, [0, 2]])


@pytest.mark.parametrize("which", ["start", "end", "both"])
def test_given_ends_come_out_where_they_were(model: InterGen, duet: DuetMotion, which: str) -> None:
    start = cut_motion(duet, None, 0.3) if which != "end" else None
    end = cut_motion(duet, 0.4, None) if which != "start" else None
    motion = around(model, given_ends(start, end, 50, FPS))
    assert motion.frames == 50
    if start is not None:
        kept = motion.keypoints[: start.frames]
        assert np.abs(kept - start.keypoints).max() < EXACT
    if end is not None:
        kept = motion.keypoints[-end.frames :]
        assert np.abs(kept - end.keypoints).max() < EXACT


def test_no_body_jumps_where_an_end_meets_the_middle(model: InterGen, duet: DuetMotion) -> None:
    """A prediction that stands elsewhere than the given ends is led over from one to the other."""
    start, end = cut_motion(duet, None, 0.3), cut_motion(duet, 0.4, None)
    given = given_ends(start, end, 60, FPS)
    away = torch.zeros(1, 60, 524) + model.normalise(torch.full((524,), 2.0))
    raw = model.denormalise(Keep(model, given)(away, 0))[0].unflatten(-1, (2, 262)).numpy()
    places = raw[..., POSITIONS]
    gap = np.abs(places[[start.frames - 1, -end.frames]] - 2).max()
    jumps = np.abs(np.diff(places, axis=0)).max(axis=(1, 2))
    for edge in (start.frames - 1, 60 - end.frames - 1):
        assert jumps[edge] < 0.1 * gap
    middle = places[start.frames + 12 : -end.frames - 12]
    assert np.abs(middle - 2).max() < 1e-4


def test_rounds_change_the_middle_and_keep_the_ends(model: InterGen, duet: DuetMotion) -> None:
    start, end = cut_motion(duet, None, 0.3), cut_motion(duet, 0.4, None)
    given = given_ends(start, end, 50, FPS)
    draw = replace(FEW, sampler=SamplerConfig(steps=10))
    one = generate_around(model, ["hug"], given, seed=1, draw=draw)
    differences = {}
    for strength in (0.05, 0.5, 1.0):
        two = generate_around(
            model, ["hug", "they bow"], given, seed=1, draw=replace(draw, strength=strength)
        )
        assert two.text == "they bow"
        assert np.abs(two.keypoints[: start.frames] - start.keypoints).max() < EXACT
        assert np.abs(two.keypoints[-end.frames :] - end.keypoints).max() < EXACT
        differences[strength] = np.abs(two.keypoints - one.keypoints).mean()
    assert differences[0.05] < differences[0.5] < differences[1.0]


def test_a_round_starts_from_the_one_before(model: InterGen, duet: DuetMotion) -> None:
    """At the first step that is undone, the sampler holds the last motion with the step's noise."""
    given = given_ends(cut_motion(duet, None, 0.3), None, 30, FPS)
    previous = sample_around(model, None, given, seed=0, draw=FEW)
    # 5 steps: t = 800, 600, 400, 200, 0. Up to 0.1 nothing but step 0 is left to the network.
    draw = Draw(sampler=SamplerConfig(steps=5), strength=0.1)
    seen = []
    original = model.denoiser.denoise
    model.denoiser.denoise = lambda x, *rest: seen.append(x.clone()) or original(x, *rest)  # type: ignore[method-assign]
    try:
        sample_around(model, None, given, seed=1, draw=draw, previous=previous)
    finally:
        del model.denoiser.denoise
    assert len(seen) == 1
    assert float((seen[0] - previous).abs().max()) < 0.1


def test_a_fine_tuned_model_reads_what_is_given_without_noise(
    model: InterGen, duet: DuetMotion
) -> None:
    given = given_person(duet, "a", FPS)
    seen = []
    original = model.denoiser.denoise
    model.denoiser.denoise = lambda x, *rest: seen.append(x[0].clone()) or original(x, *rest)  # type: ignore[method-assign]
    provenance = model.provenance
    try:
        for freeze in ("none", "ends", "person", "mixed"):
            seen.clear()
            model.provenance = replace(provenance, training={FREEZE: freeze})
            sample_around(model, None, given, seed=0, draw=FEW)
            clean = model.normalise(torch.tensor(given.values, dtype=torch.float32).flatten(1))
            error = max(float((x[:, :262] - clean[:, :262]).abs().max()) for x in seen[:3])
            assert (error < 1e-6) == (freeze in ("person", "mixed")), freeze
    finally:
        model.provenance = provenance
        del model.denoiser.denoise


def test_applications_are_told_apart(duet: DuetMotion) -> None:
    assert kind_of(given_person(duet, "b", FPS)) == "person"
    assert kind_of(given_tracks((None, LINE), 9, FPS)) == "trajectory"
    assert kind_of(given_ends(duet, None, 30, FPS)) == "ends"


def test_ends_that_leave_no_room_and_empty_requests_are_refused(duet: DuetMotion) -> None:
    with pytest.raises(MotionError, match="48 of 48"):
        given_ends(duet, duet, 48, FPS)
    with pytest.raises(MotionError, match="start or an end"):
        given_ends(None, None, 48, FPS)
    with pytest.raises(MotionError, match="path"):
        given_tracks((None, None), 48, FPS)
    with pytest.raises(MotionError, match="increase"):
        Track(np.array([0.0, 0.0]), np.zeros((2, 2)))
    with pytest.raises(MotionError, match="finite"):
        Track(np.array([0.0, 1.0]), np.array([[0.0, 0.0], [np.nan, 0.0]]))
    with pytest.raises(SpecError, match="strength"):
        Draw(strength=0)


def test_models_that_hold_no_places_are_refused(duet: DuetMotion) -> None:
    config = DenoiserConfig(
        width=8, layers=1, heads=2, feedforward=8, features=267, representation="canonical"
    )
    given = given_person(duet, "a", FPS)
    with pytest.raises(CheckpointError, match="canonical"):
        generate_around(InterGen(config), [""], given)
    plain = DenoiserConfig(width=8, layers=1, heads=2, feedforward=8)
    with pytest.raises(CheckpointError, match="statistics"):
        generate_around(InterGen(plain), [""], given)


def test_a_part_of_a_motion_is_named_by_its_times(duet: DuetMotion, tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    write_motion(duet, path)
    for name, first, last in (
        (f"{path}@0.1:0.3", 3, 9),
        (f"{path}@:0.3", 0, 9),
        (f"{path}@0.5:", 15, 23),
        (str(path), 0, 23),
    ):
        part = read_part(name)
        assert np.allclose(part.keypoints, duet.keypoints[first : last + 1])
    with pytest.raises(MotionFileError, match="two frames"):
        read_part(f"{path}@9:10")
    with pytest.raises(MotionFileError, match="no such file"):
        read_part(f"{tmp_path}/none.npz@0:1")


def test_a_path_is_read_from_csv(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("time,x,y\n0, 1, 2\n1.5; 2; 3\n\n3 4 5\n")
    track = read_track(str(path), "a")
    assert track.times.tolist() == [0, 1.5, 3]
    assert track.points.tolist() == [[1, 2], [2, 3], [4, 5]]
    for content, words in (
        ("0,1,2\n1,x,3\n", "line 2"),
        ("0,1\n1,2\n", "2 columns"),
        ("0,1,2\n", "N >= 2"),
        ("0,1,2\n0,1,2\n", "increase"),
        ("0,1,2\n1,nan,2\n", "finite"),
    ):
        path.write_text(content)
        with pytest.raises(MotionFileError, match=words):
            read_track(str(path), "a")


def test_requests_that_exclude_each_other_are_refused() -> None:
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"given": "a", "start": "b"}, "--given with --start"),
        ({"path_b": "a", "end": "b"}, "--path-a and --path-b with"),
        ({"rounds": ("x",)}, "--round"),
        ({"frames": 3, "seconds": 1.0}, "frames and seconds"),
        ({"frames": 1}, "--frames"),
        ({"seconds": float("nan")}, "--seconds"),
        ({"threads": 0}, "--threads"),
    )
    for settings, words in wrong:
        with pytest.raises(SpecError, match=words):
            IntergenRequest(**settings)
    with pytest.raises(SpecError, match="--weights"):
        generate("hug", IntergenRequest())
    with pytest.raises(PromptError, match="empty"):
        generate(" ", IntergenRequest(weights="x"))


def test_lengths_and_samplers_follow_from_a_request(duet: DuetMotion, tmp_path: Path) -> None:
    assert frames_of(IntergenRequest(), FPS) == 210
    assert frames_of(IntergenRequest(seconds=2), 20.0) == 40
    assert (sampler_of(IntergenRequest()).solver, sampler_of(IntergenRequest()).steps) == (
        "ddim",
        50,
    )
    few = sampler_of(IntergenRequest(steps=10))
    assert (few.solver, few.spacing) == ("dpm2m", "trailing")
    path = tmp_path / "m.npz"
    write_motion(duet, path)
    assert given_of(IntergenRequest(given=str(path)), FPS).frames == duet.frames
    assert given_of(IntergenRequest(given=str(path), frames=10), FPS).frames == 10
    with pytest.raises(SpecError, match="up to the 24"):
        given_of(IntergenRequest(given=str(path), frames=25), FPS)
    assert given_of(IntergenRequest(path_a=str(path)), FPS).frames == duet.frames
    assert given_of(IntergenRequest(start=str(path)), FPS).frames == 210
