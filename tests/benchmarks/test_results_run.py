"""The comparison: nothing is done twice, and nothing is lost."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.results import classifier, takes
from benchmarks.results import judges as judging
from benchmarks.results.chunks import Chunk, keep_chunk, kept_chunk
from benchmarks.results.classifier import (
    classified,
    interaction_of,
    load_classifier,
    save_classifier,
    train_classifier,
)
from benchmarks.results.clips import HeldOut
from benchmarks.results.models import Models
from benchmarks.results.performed import NAMES
from benchmarks.results.rows import EvaluatorSettings, Plan, Protocol, Row, SplitSize
from benchmarks.results.run import Bench, Clock, OutOfTime, open_results
from benchmarks.results.table import latest
from benchmarks.results.takes import Makers, Order
from generator import checkpoint
from generator.architecture import DenoiserConfig
from generator.choreographer import repertoire
from generator.data import BatchConfig, BatchStream, Choreographed, cached, measure
from generator.evaluator import EvaluatorConfig
from generator.model import InterGen
from generator.provenance import Provenance
from generator.text.encoder import default_encoder
from generator.text.manner import second_leads
from generator.training import fit as fitting
from generator.training.fit import Fit
from generator.training.portable import write_portable
from robots.errors import CheckpointError, SpecError

PROTOCOL = Protocol(chunk=3, reference=1, spread_texts=1, spread_motions=6)
DATA = Row(name="data", kind="data")
LOW = Row(name="low", kind="data", decoded=True)
FINISHED = Row(name="finished", kind="data", decoded=True, finish=True)
READ = Row(name="read", kind="choreographer", splits=("test",), spread=True)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


@dataclass
class Witness:
    """Judges that know the clips they were shown as real ones, and count what they look at."""

    hash: str = "witness"
    seen: int = 0
    answers: dict[bytes, tuple[int, bool]] = field(default_factory=dict)

    def read(self, texts: Sequence[str]) -> np.ndarray:
        rows = [hashlib.sha256(t.encode()).digest()[:4] for t in texts]
        return np.array([list(row) for row in rows], np.float32) / 255

    def watch(self, features: Sequence[np.ndarray]) -> np.ndarray:
        self.seen += len(features)
        return np.array([x.mean(axis=0).reshape(4, -1).sum(axis=1) for x in features], np.float32)

    def classify(self, features: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        found = [self.answers.get(x.tobytes(), (0, False)) for x in features]
        return np.array([w for w, _ in found]), np.array([s for _, s in found])

    def led(self, asked: Sequence[Any], features: Sequence[np.ndarray]) -> frozenset[str]:
        return frozenset({"beckon"})


def plan_of(*rows: Row, repetitions: int = 2, chunks: int = 1) -> Plan:
    splits = ("test", "sentences", "combinations")
    sizes = tuple(SplitSize(name=s, chunks=chunks, repetitions=repetitions) for s in splits)
    return Plan(protocol=PROTOCOL, split=sizes, row=rows)


def bench(root: Path, plan: Plan, **changes: Any) -> Bench:
    makers = Makers(root / "takes", plan.protocol, Models(plan.protocol.fps))
    return Bench(plan, root, Witness(), makers, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the clips are made once for all tests of this file."""
    folder = tmp_path_factory.mktemp("results")
    for split, seed in (("test", 1_000_003), ("test", 1_000_004), ("sentences", 1_000_003)):
        HeldOut(split, 7.5, 75, folder / "clips", 3, seed).chunk(0)  # type: ignore[arg-type]
    return folder


@pytest.fixture
def out(root: Path, tmp_path: Path) -> Path:
    """A fresh folder of results with those clips."""
    (tmp_path / "clips").symlink_to(root / "clips")
    return tmp_path


def test_clips_come_with_what_tells_whether_they_were_done(root: Path):
    one = HeldOut("test", 7.5, 75, root / "clips", 3)
    asked, chunk = one.chunk(0)
    source = Choreographed(3, seed=one.seed, split="test")
    for number, (ask, features) in enumerate(zip(asked, chunk.features, strict=True)):
        done = source.performance(number)
        assert (ask.texts, ask.style) == (done.texts, done.style)
        assert ask.interaction == repertoire()[number]
        assert second_leads(ask.text(0)) == ask.second_leads
        assert ask.text(2) == ask.text(0) != ask.text(1)
        assert features.shape == (ask.frames, 524)
        assert abs(ask.frames - done.motion.duration * 7.5) <= 1


def test_clips_are_made_once(root: Path, monkeypatch: pytest.MonkeyPatch):
    def fail(*_: Any) -> Any:
        raise AssertionError("made again")

    monkeypatch.setattr(Choreographed, "performance", fail)
    HeldOut("test", 7.5, 75, root / "clips", 3).chunk(0)
    with pytest.raises(AssertionError, match="made again"):
        HeldOut("test", 7.5, 60, root / "clips", 3).chunk(0)


def test_nothing_is_measured_twice_and_more_repetitions_go_on(out: Path):
    assert bench(out, plan_of(DATA, LOW, repetitions=1)).run((DATA, LOW)) == 6
    again = bench(out, plan_of(DATA, LOW, repetitions=1))
    assert again.run((DATA, LOW)) == 0
    assert bench(out, plan_of(DATA, LOW, repetitions=2)).run((DATA,)) == 3
    assert len(open_results(out).read()) == 9


def test_simulated_people_perform_the_first_chunk_of_the_first_repetition(
    out: Path, monkeypatch: pytest.MonkeyPatch
):
    figures = dict.fromkeys(NAMES, 1.0)
    monkeypatch.setattr(takes, "performed", lambda motion: figures)
    row = replace(LOW, performed=True)
    assert bench(out, plan_of(LOW)).run((LOW,)) == 6
    assert bench(out, plan_of(row)).run((row,)) == 6, "no result of a row without performances"
    records = latest(open_results(out).read().values())
    have = [(r["split"], r["repetition"]) for r in records if "passed" in r["figures"]]
    assert have == [("test", 0)]


def test_results_are_found_where_they_are_kept(out: Path, tmp_path: Path):
    kept = tmp_path / "kept"
    assert bench(out, plan_of(DATA), kept=kept).run((DATA,)) == 6
    assert bench(tmp_path / "another", plan_of(DATA), kept=kept).run((DATA,)) == 0
    assert len(open_results(kept).read()) == 6


def test_other_judges_measure_anew(out: Path):
    plan = plan_of(replace(DATA, splits=("test",)), repetitions=1)
    assert bench(out, plan).run(plan.row) == 1
    other = bench(out, plan)
    other.judges.hash = "others"  # type: ignore[misc]
    assert other.run(plan.row) == 1
    records = list(open_results(out).read().values())
    assert len(records) == 2
    assert [r["digest"] for r in latest(records)] == [records[1]["digest"]]


def test_what_is_right_is_counted_where_it_can_be_told(out: Path):
    plan = plan_of(replace(DATA, splits=("test",)), repetitions=1)
    made = bench(out, plan)
    asked, chunk = made._set("test", 1_000_003).chunk(0)
    for ask, x in zip(asked, chunk.features, strict=True):
        made.judges.answers[x.tobytes()] = (  # type: ignore[attr-defined]
            repertoire().index(ask.interaction) if ask.number else 7,
            ask.second_leads,
        )
    made.run(plan.row)
    (record,) = open_results(out).read().values()
    found = record["figures"]
    assert found["class"] == pytest.approx(2 / 3)
    assert found["role"] == 1.0
    assert record["by_interaction"]["beckon"] == {"class": 1.0, "role": 1.0, "met": None}
    assert record["by_interaction"]["applaud"]["role"] is None, "nobody leads there"
    assert found["met"] is None, "none of the three meets"
    assert found["r_precision_top1"] is None, "three clips fill no pool"


def test_time_that_is_over_loses_nothing(out: Path):
    plan = plan_of(DATA, repetitions=1)
    with pytest.raises(OutOfTime, match="go on"):
        bench(out, plan, clock=Clock(minutes=-1.0)).run(plan.row)
    assert bench(out, plan).run(plan.row) == 3


def test_being_killed_costs_the_chunk_at_hand_alone(root: Path, out: Path):
    """The process is killed for real while the second chunk is made."""
    script = f"""
import os, signal
from pathlib import Path
from benchmarks.results import clips
made = clips.measured
def measured(*args):
    if clips.COUNT == 4:
        os.kill(os.getpid(), signal.SIGKILL)
    clips.COUNT += 1
    return made(*args)
clips.COUNT, clips.measured = 0, measured
one = clips.HeldOut("combinations", 7.5, 75, Path({str(out)!r}) / "own", 3)
one.chunk(0)
one.chunk(1)
"""
    where = Path(__file__).parents[2]
    path = os.pathsep.join([str(where), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=where, env={**os.environ, "PYTHONPATH": path}
    )
    assert done.returncode == -signal.SIGKILL
    kept = [p.name for p in (out / "own" / "combinations-1000003").iterdir() if p.suffix == ".npz"]
    assert kept == ["3-000.npz"]


def test_a_damaged_chunk_is_made_again(tmp_path: Path):
    path, chunk = tmp_path / "c.npz", Chunk([np.zeros((2, 524), np.float32)], [{}], [np.zeros(3)])
    keep_chunk(path, "key", chunk)
    assert kept_chunk(path, "key") is not None
    assert kept_chunk(path, "other key") is None
    path.write_bytes(path.read_bytes()[:-40])
    assert kept_chunk(path, "key") is None


def test_decoded_and_finished_data_stay_near_the_performances(out: Path):
    plan = plan_of(DATA, LOW, FINISHED, repetitions=1)
    made = bench(out, plan)
    (order,) = made._orders(plan.size("test"), 0)
    plain, low, done = (made.makers.take(row, order) for row in plan.row)
    for exact, decoded, finished in zip(plain.features, low.features, done.features, strict=True):
        assert np.array_equal(exact, decoded)
        count = len(finished)
        assert len(exact) - count in (0, 1)
        positions = (finished - exact[:count]).reshape(count, 2, 262)[..., :66]
        assert np.abs(positions).mean() < 0.01
    jerks = [
        (row["jerk"], other["jerk"]) for row, other in zip(low.figures, plain.figures, strict=True)
    ]
    assert all(slow and fast and slow < fast for slow, fast in jerks)


def test_a_choreographer_that_reads_well_does_what_is_asked(out: Path):
    plan = plan_of(READ, repetitions=1)
    made = bench(out, plan)
    made.run(plan.row)
    (record,) = open_results(out).read().values()
    assert record["figures"]["multimodality"] > 0
    assert record["figures"]["sampling_s"] > 0
    (order,) = made._orders(plan.size("test"), 0)
    first = made.makers.take(READ, order)
    other = Makers(out / "elsewhere", PROTOCOL, Models(7.5)).take(READ, order)
    assert all(map(np.array_equal, first.features, other.features)), "same seeds, same motions"


def small_model(folder: Path, fps: float = 7.5) -> None:
    torch.manual_seed(0)
    config = DenoiserConfig(width=8, layers=1, heads=2, feedforward=8, text_width=384)
    clips = Choreographed(1, seed=5)
    found = measure(clips, frames=75)
    model = InterGen(
        config,
        mean=found.mean.copy(),
        std=found.std.copy(),
        text=default_encoder(),
        provenance=Provenance("test", "CC0", fps),
    )
    for parameter in model.parameters():
        parameter.data.normal_(0, 0.05)
    checkpoint.save(model, folder)


def test_a_model_is_measured_raw_and_finished_from_one_drawing(
    out: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = out / "model"
    raw = Row(name="raw", kind="model", folder=str(folder), steps=1, splits=("test",))
    plan = plan_of(raw, replace(raw, name="clean", finish=True), repetitions=1)
    assert bench(out, plan).run(plan.row) == 0, "a model that is not there is left out"
    small_model(folder)
    drawn = []
    sample = InterGen.sample

    def counted(self: InterGen, *args: Any, **more: Any) -> Any:
        drawn.append(1)
        return sample(self, *args, **more)

    monkeypatch.setattr(InterGen, "sample", counted)
    assert bench(out, plan).run(plan.row[:1]) == 1
    count = len(drawn)
    assert bench(out, plan).run(plan.row) == 1
    assert len(drawn) == count > 0
    first, second = open_results(out).read().values()
    assert second["figures"]["bones"] < 1e-6 < first["figures"]["bones"]
    assert second["figures"]["finishing_s"] > 0
    assert first["figures"]["finishing_s"] is None


def test_what_ships_draws_what_was_trained_as_its_folder_says(out: Path):
    small_model(out / "model")
    folder, said = out / "portable", {"steps": 2, "guidance": 1.5}
    model = checkpoint.load(out / "model")
    write_portable(model, folder, frames=75, precision="float32", sampling=said)
    trained = Row(
        name="trained", kind="model", folder=str(folder), splits=("test",), steps=2, guidance=1.5
    )
    ships = Row(name="ships", kind="portable", folder=str(folder), splits=("test",))
    made = bench(out, plan_of(trained, ships))
    (order,) = made._orders(made.plan.size("test"), 0)
    takes = [made.makers.take(row, order) for row in (trained, ships)]
    for ours, theirs in zip(takes[0].features, takes[1].features, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-3)
    assert made.makers.identity(trained) != made.makers.identity(ships)


def test_a_model_of_another_rate_is_refused(out: Path):
    small_model(out / "model", fps=30.0)
    row = Row(name="raw", kind="model", folder=str(out / "model"), splits=("test",))
    with pytest.raises(SpecError, match="30 frames"):
        bench(out, plan_of(row)).run((row,))


def test_one_sentence_is_asked_for_many_times_with_other_seeds(out: Path):
    (order,) = bench(out, plan_of(READ))._spread_orders()
    assert isinstance(order, Order)
    assert len(set(order.texts)) == 1
    assert len({tuple(seed) for seed in order.seeds}) == PROTOCOL.spread_motions


def test_the_classifier_learns_what_is_done_and_who_leads(tmp_path: Path):
    clips = cached(Choreographed(6, seed=3), tmp_path / "cache", fps=7.5)
    stream = BatchStream(clips, BatchConfig(size=12, frames=75, frame="first", pad="longest"))
    statistics = measure(clips, frames=75)
    size = EvaluatorConfig(width=32, layers=1, heads=2, feedforward=32, embedding=32, dropout=0.0)
    made = train_classifier(stream, statistics, Fit(steps=90, learning_rate=3e-3), size=size)
    save_classifier(made, tmp_path / "classifier")
    model = load_classifier(tmp_path / "classifier")
    samples = [stream.sample(i) for i in range(1200, 1230)]
    what, second = classified(model, [x.astype(np.float32) for x, _, _ in samples])
    right = np.mean([w == interaction_of(n) for w, (_, _, n) in zip(what, samples, strict=True)])
    led = np.mean([s == second_leads(t) for s, (_, t, _) in zip(second, samples, strict=True)])
    assert right > 0.8
    assert led > 0.6
    header = json.loads((tmp_path / "classifier" / "model.json").read_text())
    header["interactions"] = ["something else"]
    (tmp_path / "classifier" / "model.json").write_text(json.dumps(header))
    with pytest.raises(CheckpointError, match="repertoire"):
        load_classifier(tmp_path / "classifier")


def test_judges_are_trained_once_and_a_stop_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    config = tmp_path / "small.toml"
    config.write_text(
        f'[data]\ncache = "{tmp_path / "cache"}"\nfps = 7.5\nframes = 20\n'
        '[[data.source]]\nkind = "choreographed"\ncount = 2\n'
    )
    size = replace(judging.SIZE, width=16, layers=1, heads=2, feedforward=16, embedding=8)
    few = 6
    monkeypatch.setattr(fitting, "REPORT", few)
    monkeypatch.setattr(judging, "SIZE", size)
    monkeypatch.setattr(classifier, "SIZE", size)
    settings = EvaluatorSettings(config=str(config), batch=2, steps=2 * few, classifier_steps=few)
    said: list[str] = []
    with pytest.raises(OutOfTime):
        judging.judges(tmp_path / "judges", settings, said.append, Clock(minutes=-1.0).check)
    assert next(line for line in said if "step" in line).startswith(f"evaluator step {few}/")
    said.clear()
    made = judging.judges(tmp_path / "judges", settings, said.append, Clock().check)
    steps = [line.split("  ")[0] for line in said if "step" in line]
    assert steps == [
        f"evaluator step {2 * few}/{2 * few}",
        f"classifier step {few}/{few}",
    ]
    said.clear()
    again = judging.judges(tmp_path / "judges", settings, said.append, Clock(minutes=-1.0).check)
    assert not said
    assert again.hash == made.hash
    never, kept = Clock(minutes=-1.0).check, tmp_path / "judges"
    assert judging.judges(tmp_path / "new", settings, said.append, never, kept).hash == made.hash
    assert not (tmp_path / "new").exists(), "judges that are kept are not trained again"
    clips = [np.random.default_rng(i).standard_normal((20, 524), np.float32) for i in range(3)]
    assert np.array_equal(again.watch(clips), made.watch(clips))
    assert np.array_equal(made.read(["they hug", "they hug"])[0], again.read(["they hug"])[0])
