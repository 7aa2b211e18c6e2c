"""The training loop: steps, a log, and checkpoints that a crash cannot break.

A run is a folder:

    config.toml        what was asked for, complete
    statistics.json    mean and deviation of the features
    model.json, weights-*.safetensors    the averaged model, as ``generate --weights`` takes it
    state/             everything that training goes on from
    log.jsonl          the curves

A state is written to a new file first, and one rename makes it the state: a process that is killed
at any moment leaves the last one whole. Going on from it gives bit for bit the weights that an
uninterrupted run has, on the same machine with the same number of threads and processes: what is
drawn at random depends on the number of the step alone (:mod:`generator.training.draws`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from generator import checkpoint
from generator.data import Batch, BatchStream
from generator.model_folder import HEADER
from generator.training.ahead import ahead
from generator.training.config import RunConfig, changed_keys, parse
from generator.training.learner import Learner
from generator.training.prepare import Prepared, prepare
from generator.training.processes import Processes
from generator.training.record import Record
from generator.weights import load_weights, save_weights
from robots.errors import CheckpointError, DuetError
from robots.files import whole_file

FORMAT = "pasdedeux-training"
VERSION = 1
CONFIG, LOG, STATE = "config.toml", "log.jsonl", "state"


@dataclass(frozen=True, slots=True)
class Report:
    """How training stands."""

    step: int
    """Steps done."""
    total: int
    """Steps of the whole run."""
    losses: dict[str, float]
    """Weighted losses, mean over the steps since the last report."""
    rate: float
    """Steps per second since the last report."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run, or a part of it, ended."""

    steps: int
    """Steps done in all."""
    total: int
    """Steps asked for."""
    seconds: float
    """Time spent learning, over all parts, s."""
    resumed_from: int
    """Step at which this part began."""
    losses: dict[str, float]
    """The last ones that were reported."""

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self.steps >= self.total


@dataclass(slots=True)
class Watch:
    """What a caller hears and says while training runs."""

    announce: Callable[[str], None] = lambda _: None
    """Told what is being prepared."""
    preparing: Callable[[int, int], None] | None = None
    """Told clips done and their total."""
    report: Callable[[Report], None] = lambda _: None
    """Told how training stands."""
    stop: Callable[[], bool] = field(default=lambda: False)
    """Asked after every step whether to save and end."""


def train(
    run: RunConfig,
    out: str | Path,
    *,
    resume: bool = False,
    processes: Processes | None = None,
    watch: Watch | None = None,
) -> Outcome:
    """Train a model and leave it in a folder; return how that went.

    Args:
        run: Settings.
        out: Folder of the run.
        resume: Go on from the folder's state; begin if there is none.
        processes: Who learns together; alone by default.
        watch: Who looks on.

    Raises:
        CheckpointError: There is a state already and ``resume`` is off, or it is damaged.
        SpecError: The state is of another configuration.
        DuetError: Something that is needed cannot be read, or the loss is no longer finite.
    """
    out, processes, watch = Path(out), processes or Processes(), watch or Watch()
    state = out / STATE
    found = (state / HEADER).is_file()
    if found and not resume:
        raise CheckpointError(
            "there is a training run in this folder",
            where=str(out),
            hint="go on with --resume, or choose another folder with -o",
        )
    header, tensors = load_weights(state) if found else ({}, {})
    if found:
        _require_same_run(header, run, state)
    if processes.leads:
        with whole_file(out / CONFIG) as file:
            file.write(run.toml().encode())
        for lost in (*out.glob(".weights-*"), *state.glob(".weights-*")):
            lost.unlink(missing_ok=True)  # a save that a crash cut off
    prepared = prepare(run, out, processes, announce=watch.announce, progress=watch.preparing)
    learner = _learner(run, prepared, processes)
    start, before = int(header.get("step", 0)), float(header.get("seconds", 0.0))
    if found:
        learner.restore(tensors, where=str(state))
    loop = _Loop(run, out, prepared.stream, learner, processes, watch)
    return loop.run(start, before)


class _Loop:
    """The steps of one part of a run."""

    def __init__(
        self,
        run: RunConfig,
        out: Path,
        stream: BatchStream,
        learner: Learner,
        processes: Processes,
        watch: Watch,
    ) -> None:
        self._run, self._out, self._stream = run, out, stream
        self._learner, self._processes, self._watch = learner, processes, watch
        self._total = run.total_steps(stream.steps_per_epoch)
        self._losses: dict[str, float] = {}

    def run(self, start: int, before: float) -> Outcome:
        run, processes = self._run, self._processes
        record = None
        if processes.leads:
            record = Record(self._out / LOG, after=start, tensorboard=run.log.tensorboard)
        began = saved = reported = time.monotonic()
        sums: dict[str, Tensor] = {}
        done = last_report = start
        seconds = before
        batches = _batches(self._stream, start, self._total, processes, run.data.workers)
        if not run.data.workers:  # worker processes must be forked by the main thread
            batches = ahead(batches, self._learner.texts.vectors)
        for batch in batches:
            for name, value in self._learner.step(done, batch).items():
                sums[name] = sums.get(name, 0) + value
            done += 1
            now = time.monotonic()
            seconds = before + now - began
            if done % run.log.steps == 0 or done == self._total:
                self._report(record, done, done - last_report, sums, now - reported, seconds)
                sums, last_report, reported = {}, done, now
            stop = processes.any(self._watch.stop())
            due = done % run.checkpoint.steps == 0 or processes.any(
                now - saved >= 60 * run.checkpoint.minutes
            )
            if (due or stop) and done < self._total:
                self._save(done, seconds)
                saved = time.monotonic()
            if stop:
                break
        if done >= self._total:
            self._save(done, seconds)
        if record is not None:
            record.close()
        return Outcome(done, self._total, seconds, start, self._losses)

    def _report(
        self,
        record: Record | None,
        done: int,
        count: int,
        sums: dict[str, Tensor],
        elapsed: float,
        seconds: float,
    ) -> None:
        names = sorted(sums)
        values = self._processes.mean(torch.stack([sums[name] / count for name in names]))
        self._losses = dict(zip(names, values.tolist(), strict=True))
        rate = count / max(elapsed, 1e-9)
        if record is not None:
            figures = {
                **self._losses,
                "learning_rate": self._learner.learning_rate(done - 1),
                "steps_per_second": round(rate, 4),
                "seconds": round(seconds, 3),
            }
            record.write(done, figures)
        if self._processes.leads:
            self._watch.report(Report(done, self._total, self._losses, rate))

    def _save(self, done: int, seconds: float) -> None:
        """Write the state, then the model that is used: only the first is needed to go on."""
        if self._processes.leads:
            header = {
                "format": FORMAT,
                "version": VERSION,
                "step": done,
                "seconds": round(seconds, 3),
                "seed": self._run.training.seed,
                "config": self._run.tables(),
                "torch": torch.__version__,
            }
            save_weights(self._out / STATE, header, self._learner.tensors())
            model = self._learner.averaged()
            model.provenance.training.update(
                {"steps": done, "of": self._total, "losses": self._losses}
            )
            checkpoint.save(model, self._out)
        self._processes.wait()


def _learner(run: RunConfig, prepared: Prepared, processes: Processes) -> Learner:
    per_epoch = prepared.stream.steps_per_epoch
    return Learner(
        run,
        prepared.model,
        prepared.texts,
        cycle=run.cycle_steps(per_epoch),
        warmup=run.warmup_steps(per_epoch),
        processes=processes,
    )


def _require_same_run(header: dict[str, object], run: RunConfig, state: Path) -> None:
    if header.get("format") != FORMAT or header.get("version") != VERSION:
        raise CheckpointError(
            f"the format is {header.get('format')!r} version {header.get('version')!r}",
            where=str(state),
            allowed=f"{FORMAT} version {VERSION}",
        )
    config = header.get("config")
    try:
        step = header["step"]
        if not isinstance(config, dict) or not isinstance(step, int) or step < 0:
            raise ValueError("no configuration or step")
        old = parse(config)
    except (DuetError, KeyError, ValueError) as error:
        raise CheckpointError(f"the header is wrong: {error}", where=str(state)) from error
    changed = changed_keys(old, run)
    if changed:
        raise CheckpointError(
            f"it was trained with other settings: {', '.join(changed)}",
            where=str(state),
            hint="resume with the run's own config.toml, or choose another folder with -o",
        )


class _Numbered(Dataset[Batch]):
    """Batches by number, for worker processes."""

    def __init__(self, stream: BatchStream, processes: Processes) -> None:
        self._stream, self._processes = stream, processes

    def __getitem__(self, index: int) -> Batch:
        return self._stream.batch(index, rank=self._processes.rank, world=self._processes.world)


def _batches(
    stream: BatchStream, start: int, total: int, processes: Processes, workers: int
) -> Iterator[Batch]:
    """Yield this process' share of batches ``start`` up to before ``total``."""
    numbered = _Numbered(stream, processes)
    if not workers:
        for number in range(start, total):
            yield numbered[number]
        return
    numbers = range(start, total)
    yield from DataLoader(numbered, batch_size=None, sampler=numbers, num_workers=workers)
