"""Learning: steps, resuming, freezing, several processes' shares."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from generator import checkpoint
from generator.data import BatchConfig, BatchStream, DuetFolder
from generator.given import TRAJECTORY
from generator.training.config import RunConfig, load_config
from generator.training.draws import draw
from generator.training.freezing import frozen
from generator.training.learner import Learner, TrainingDiverged
from generator.training.prepare import prepare
from generator.training.processes import Processes
from generator.training.record import read_record
from generator.training.train import LOG, STATE, Watch, train
from generator.weights import load_weights
from robots.errors import CheckpointError, MotionFileError
from tests.generator.small_run import small

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def state_of(out: Path) -> dict[str, torch.Tensor]:
    return load_weights(out / STATE)[1]


def stop_after(steps: int) -> Watch:
    """A watcher that asks to stop after so many steps."""
    asked = []

    def stop() -> bool:
        asked.append(None)
        return len(asked) >= steps

    return Watch(stop=stop)


def test_a_run_leaves_a_model_that_loads_and_samples(folder: Path, tmp_path: Path) -> None:
    outcome = train(small(folder), tmp_path)
    assert outcome.finished
    assert outcome.steps == 6
    model = checkpoint.load(tmp_path)
    assert model.provenance.training["steps"] == 6
    assert model.has_statistics
    assert model.generate("two people wave", 8, steps=2).frames == 8
    assert load_config(tmp_path / "config.toml") == small(folder)


def test_the_loss_falls(folder: Path, tmp_path: Path) -> None:
    run = small(folder, training={"steps": 80, "learning_rate": 1e-2}, model={"dropout": 0.0})
    train(run, tmp_path)
    losses = [entry["simple"] for entry in read_record(tmp_path / LOG)]
    assert np.mean(losses[-8:]) < 0.7 * np.mean(losses[:8])


def test_a_resumed_run_ends_with_the_same_bits(folder: Path, tmp_path: Path) -> None:
    run = small(folder)
    train(run, tmp_path / "whole")
    first = train(run, tmp_path / "parts", watch=stop_after(3))
    assert (first.steps, first.finished) == (3, False)
    # Whatever other code draws in between must not matter.
    torch.manual_seed(12345)
    second = train(run, tmp_path / "parts", resume=True)
    assert (second.resumed_from, second.steps) == (3, 6)
    whole, parts = state_of(tmp_path / "whole"), state_of(tmp_path / "parts")
    assert whole.keys() == parts.keys()
    for name, value in whole.items():
        assert torch.equal(value, parts[name]), name


def test_a_run_that_has_ended_goes_on_when_it_is_given_more_cycles(
    folder: Path, tmp_path: Path
) -> None:
    twice = small(folder, training={"cycles": 2})
    assert train(twice, tmp_path / "whole").steps == 12
    assert train(small(folder), tmp_path / "parts").finished
    outcome = train(twice, tmp_path / "parts", resume=True)
    assert (outcome.resumed_from, outcome.steps, outcome.finished) == (6, 12, True)
    whole, parts = state_of(tmp_path / "whole"), state_of(tmp_path / "parts")
    assert all(torch.equal(value, parts[name]) for name, value in whole.items())


def test_the_log_goes_on_where_the_state_is(folder: Path, tmp_path: Path) -> None:
    run = small(folder, training={"steps": 8}, checkpoint={"steps": 2})
    train(run, tmp_path, watch=stop_after(4))
    with open(tmp_path / LOG, "a", encoding="utf-8") as file:
        file.write(json.dumps({"step": 6, "total": 9.0}) + '\n{"step": 7, "tot')
    train(run, tmp_path, resume=True)
    entries = read_record(tmp_path / LOG)
    assert [entry["step"] for entry in entries] == [2, 4, 6, 8]
    assert all(entry["total"] < 9 for entry in entries)


def test_a_folder_with_a_run_is_not_overwritten(folder: Path, tmp_path: Path) -> None:
    train(small(folder), tmp_path, watch=stop_after(1))
    with pytest.raises(CheckpointError, match="--resume"):
        train(small(folder), tmp_path)


def test_resuming_with_other_settings_names_them(folder: Path, tmp_path: Path) -> None:
    train(small(folder), tmp_path, watch=stop_after(1))
    other = small(folder, training={"learning_rate": 2e-3})
    with pytest.raises(CheckpointError, match=r"training\.learning_rate"):
        train(other, tmp_path, resume=True)


def test_resuming_without_a_state_begins(folder: Path, tmp_path: Path) -> None:
    outcome = train(small(folder), tmp_path, resume=True)
    assert (outcome.resumed_from, outcome.finished) == (0, True)


def test_a_damaged_state_is_refused(folder: Path, tmp_path: Path) -> None:
    train(small(folder), tmp_path, watch=stop_after(1))
    (weights,) = (tmp_path / STATE).glob("weights-*")
    data = bytearray(weights.read_bytes())
    data[-1] ^= 1
    weights.write_bytes(data)
    with pytest.raises(CheckpointError, match="damaged"):
        train(small(folder), tmp_path, resume=True)


def learner_of(run: RunConfig, out: Path, processes: Processes | None = None) -> Learner:
    prepared = prepare(run, out, processes or Processes())
    assert run.training.steps is not None
    return Learner(
        run,
        prepared.model,
        prepared.texts,
        cycle=run.training.steps,
        warmup=run.warmup_steps(1),
        processes=processes or Processes(),
    )


def test_a_state_without_one_of_its_tensors_is_refused(folder: Path, tmp_path: Path) -> None:
    run = small(folder)
    learner = learner_of(run, tmp_path)
    learner.step(0, prepare(run, tmp_path, Processes()).stream.batch(0))
    state = learner.tensors()
    key = "optimizer.exp_avg.networks.0.out.weight"
    with pytest.raises(CheckpointError, match=key):
        learner.restore({k: v for k, v in state.items() if k != key}, where="x")
    with pytest.raises(CheckpointError, match="shape"):
        learner.restore({**state, key: torch.zeros(1)}, where="x")
    with pytest.raises(CheckpointError, match="stranger"):
        learner.restore({**state, "stranger": torch.zeros(1)}, where="x")


def test_a_gradient_that_is_not_finite_ends_the_run(folder: Path, tmp_path: Path) -> None:
    run = small(folder)
    learner = learner_of(run, tmp_path)
    batch = prepare(run, tmp_path, Processes()).stream.batch(0)
    broken = replace(batch, x_raw=np.full_like(batch.x_raw, np.nan))
    with pytest.raises(TrainingDiverged, match="learning_rate"):
        learner.step(0, broken)


def test_two_halves_of_a_batch_have_the_gradient_of_the_whole(folder: Path, tmp_path: Path) -> None:
    """What DistributedDataParallel averages: the mean over processes is the whole batch's."""
    run = small(folder, model={"dropout": 0.0})
    gradients = {}
    for world in (1, 2):
        total: dict[str, torch.Tensor] = {}
        for rank in range(world):
            learner = learner_of(run, tmp_path)
            learner._processes = Processes(rank, world)
            with torch.no_grad():
                for value in learner._names.values():
                    value.add_(0.01)  # weights that are zero at first would hide what is behind
            batch = prepare(run, tmp_path, Processes()).stream.batch(5, rank=rank, world=world)
            shape = batch.x_raw.shape
            first = 5 * 4 + rank * len(batch)
            draws = draw(run.training, first, batch.lengths.tolist(), shape[1], shape[2])
            learner._losses(batch, draws, torch.device("cpu"))["total"].backward()
            for name, value in learner._names.items():
                assert value.grad is not None
                total[name] = total.get(name, 0) + value.grad / world
        gradients[world] = total
    for name, value in gradients[1].items():
        torch.testing.assert_close(gradients[2][name], value, rtol=1e-4, atol=1e-6)


def test_each_way_of_freezing_gives_away_what_it_says() -> None:
    rng = np.random.default_rng(0)
    seen = set()
    for _ in range(60):
        person = frozen("person", 1.0, 12, 9, rng).reshape(12, 2, 262)
        assert not person[9:].any()
        assert int(np.sum(person[:9].all(axis=(0, 2)))) == 1
        path = frozen("trajectory", 1.0, 12, 9, rng).reshape(12, 2, 262)
        seen.add(tuple(path[0].any(axis=1).tolist()))
        rows, columns = path[:9].any(axis=(0, 1)), path.any(axis=(0, 2))
        assert np.flatnonzero(rows).tolist() == list(TRAJECTORY)
        assert columns.any()
        ends = frozen("ends", 1.0, 12, 9, rng).reshape(12, -1)
        assert (ends.all(axis=1) == ends.any(axis=1)).all()
        free = np.flatnonzero(~ends[:9, 0])
        assert 0 < len(free) < 9
        assert (np.diff(free) == 1).all()
    assert seen == {(True, False), (False, True), (True, True)}
    assert not any(frozen("mixed", 0.0, 4, 4, rng).any() for _ in range(20))


def test_frozen_numbers_reach_the_network_without_noise(folder: Path, tmp_path: Path) -> None:
    run = small(folder, training={"freeze": "person", "freeze_share": 1.0})
    learner = learner_of(run, tmp_path)
    batch = prepare(run, tmp_path, Processes()).stream.batch(0)
    shape = batch.x_raw.shape
    draws = draw(run.training, 0, batch.lengths.tolist(), shape[1], shape[2])
    seen = []
    network = learner.model.denoiser.forward
    learner._network = lambda x, *rest: seen.append(x) or network(x, *rest)  # type: ignore[assignment]
    learner._losses(batch, draws, torch.device("cpu"))
    clean = learner.model.normalise(torch.from_numpy(batch.x_raw))
    known = draws.frozen
    assert known is not None
    torch.testing.assert_close(seen[0][known], clean[known], rtol=0, atol=0)
    far = (seen[0] - clean)[~known].abs().median()
    assert float(far) > 0.1


def test_a_dropped_text_is_a_zero_vector_for_the_network(folder: Path, tmp_path: Path) -> None:
    for share in (0.0, 1.0):
        run = small(folder, training={"unconditional": share})
        learner = learner_of(run, tmp_path)
        batch = prepare(run, tmp_path, Processes()).stream.batch(0)
        shape = batch.x_raw.shape
        draws = draw(run.training, 0, batch.lengths.tolist(), shape[1], shape[2])
        seen = []
        network = learner.model.denoiser.forward
        learner._network = lambda x, t, cond, mask, seen=seen, network=network: (  # type: ignore[assignment]
            seen.append(cond) or network(x, t, cond, mask)
        )
        learner._losses(batch, draws, torch.device("cpu"))
        norms = seen[0].norm(dim=1)
        assert torch.allclose(norms, torch.full_like(norms, 1 - share), atol=1e-5)


def test_the_release_s_losses_can_be_trained_on(folder: Path, tmp_path: Path) -> None:
    outcome = train(small(folder, training={"loss": "release"}), tmp_path)
    assert {"VEL_A", "FC_B", "DM", "JA", "RO", "simple", "total"} <= set(outcome.losses)
    assert np.isfinite(outcome.losses["total"])


def test_the_average_follows_the_weights_with_its_decay(folder: Path, tmp_path: Path) -> None:
    learner = learner_of(small(folder, training={"ema": 0.5, "steps": 40}), tmp_path)
    batch = prepare(small(folder), tmp_path, Processes()).stream.batch(0)
    name = "networks.0.out.bias"
    for step in (0, 30):
        before = learner.average[name].clone()
        learner.step(step, batch)
        decay = 0.1 if step == 0 else 0.5
        expected = decay * before + (1 - decay) * learner._names[name].detach()
        torch.testing.assert_close(learner.average[name], expected)
    used = learner.averaged().denoiser.state_dict()[name]
    assert torch.equal(used, learner.average[name])


def test_the_learning_rate_warms_up_and_falls(folder: Path, tmp_path: Path) -> None:
    learner = learner_of(small(folder, training={"steps": 100, "warmup_steps": 10}), tmp_path)
    rates = [learner.learning_rate(step) for step in range(100)]
    assert rates[0] == pytest.approx(1e-4, rel=0.01)
    assert int(np.argmax(rates)) == 9
    assert rates[-1] < 1e-6


def test_every_cycle_begins_at_the_highest_rate_and_only_the_first_warms_up(
    folder: Path, tmp_path: Path
) -> None:
    training = {"steps": 50, "cycles": 2, "warmup_steps": 10}
    learner = learner_of(small(folder, training=training), tmp_path)
    rates = [learner.learning_rate(step) for step in range(100)]
    assert rates[49] < 1e-5
    assert rates[50] == 1e-3
    assert rates[60:] == rates[10:50]


def test_bfloat16_learns_what_float32_learns(folder: Path, tmp_path: Path) -> None:
    ends = {}
    for precision in ("float32", "bfloat16"):
        run = small(folder, training={"precision": precision, "steps": 40}, model={"dropout": 0.0})
        out = tmp_path / precision
        ends[precision] = train(run, out).losses["simple"]
        assert all(value.dtype == torch.float32 for value in state_of(out).values())
    assert ends["bfloat16"] == pytest.approx(ends["float32"], rel=0.1)
    assert ends["bfloat16"] != ends["float32"]


def test_worker_processes_change_nothing(folder: Path, tmp_path: Path) -> None:
    train(small(folder), tmp_path / "none")
    train(small(folder, data={"workers": 2}), tmp_path / "two")
    none, two = state_of(tmp_path / "none"), state_of(tmp_path / "two")
    assert all(torch.equal(value, two[name]) for name, value in none.items())


def test_curves_go_to_tensorboard_where_it_is_installed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys
    import types

    written = []

    class Writer:
        def __init__(self, folder: str, purge_step: int) -> None:
            written.append((Path(folder).name, purge_step))

        def add_scalar(self, name: str, value: float, step: int) -> None:
            written.append((name, step))

        def close(self) -> None:
            written.append("closed")

    module = types.ModuleType("torch.utils.tensorboard")
    module.SummaryWriter = Writer  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", module)
    train(small(folder, log={"tensorboard": True}), tmp_path)
    assert written[0] == ("tensorboard", 1)
    assert ("total", 6) in written
    assert written[-1] == "closed"


def test_a_source_that_is_not_there_is_named(folder: Path, tmp_path: Path) -> None:
    for kind in ("interhuman", "duets"):
        run = small(folder, data={"source": [{"kind": kind, "root": str(tmp_path / "none")}]})
        with pytest.raises(MotionFileError, match="none"):
            train(run, tmp_path / kind)


def test_a_source_of_duets_is_cached_once(folder: Path, tmp_path: Path) -> None:
    run = small(folder)
    prepare(run, tmp_path, Processes())
    before = sorted(path.stat().st_mtime_ns for path in (folder / "cache").rglob("*"))
    prepare(run, tmp_path, Processes())
    assert sorted(path.stat().st_mtime_ns for path in (folder / "cache").rglob("*")) == before
    stream = BatchStream(DuetFolder(folder / "duets"), BatchConfig(size=2, frames=16))
    assert prepare(run, tmp_path, Processes()).stream.epoch == stream.epoch
