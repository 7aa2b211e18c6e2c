"""Measures every row that is not measured yet, a line on disk after each repetition."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.results.chunks import Chunk, key_of
from benchmarks.results.clips import SEED, Asked, HeldOut
from benchmarks.results.judges import Judges
from benchmarks.results.measure import Standard, Taken, mean_of, measured_row, spread_of
from benchmarks.results.performed import NAMES, made_with
from benchmarks.results.rows import Plan, Row, SplitSize
from benchmarks.results.takes import Makers, Order
from benchmarks.tracking.results import Key, Record, Results
from benchmarks.tracking.run import note
from generator.data.choreographed import SPLITS, Split
from generator.model_folder import HEADER
from robots.errors import DuetError

RESULTS = "results.jsonl"
KEPT = Path(__file__).with_name("kept")
"""What docs/results.md is made of: the file of results, and the judges."""
_SPREAD = 11
"""Told apart from repetitions in the seeds of MModality."""


class OutOfTime(DuetError):
    """The time that a run was given is over; running again goes on."""


@dataclass(slots=True)
class Clock:
    """How long a run may take."""

    minutes: float | None = None
    """Wall time; no limit by default."""
    began: float = field(default_factory=time.monotonic)
    """When it began, s."""

    @property
    def over(self) -> bool:
        """Whether there is no time left."""
        return self.minutes is not None and time.monotonic() - self.began > 60 * self.minutes

    def check(self) -> None:
        """Do nothing while there is time.

        Raises:
            OutOfTime: There is none left.
        """
        if self.over:
            raise OutOfTime(f"{self.minutes:g} minutes are over", hint="run again to go on")


def key_of_record(record: Record) -> Key:
    """Return what a record is a result of."""
    return (record["row"], record["split"], str(record["repetition"]), record["digest"])


def open_results(root: Path) -> Results:
    """Return the file of results in a folder."""
    return Results(root / RESULTS, key_of_record)


@dataclass(frozen=True)
class Bench:
    """Everything that a run needs."""

    plan: Plan
    """What is compared."""
    root: Path
    """Folder of everything that is kept."""
    judges: Judges
    """Who judges."""
    makers: Makers
    """Who makes motions."""
    clock: Clock = field(default_factory=Clock)
    """How long it may take."""
    limit: int | None = None
    """Most clips of a split; for trying things out."""
    kept: Path | None = None
    """Folder of the file of results, if it is another one."""

    def run(self, rows: Sequence[Row]) -> int:
        """Measure what is not measured yet; return how many records that made.

        All rows get their first repetition before any gets its second.

        Raises:
            OutOfTime: There was not enough time for all.
            DuetError: Something cannot be made or written.
        """
        there = [row for row in rows if self._there(row)]
        results = open_results(self.kept or self.root)
        done = results.read()
        standard = self._standard()
        count = 0
        for row, size, repetition in self._turns(there):
            key = self._key(row, size, repetition)
            if key in done:
                continue
            record = self._record(row, size, repetition, standard) | {
                **dict(zip(("row", "split"), key, strict=False)),
                "repetition": repetition,
                "digest": key[-1],
            }
            results.append(record)
            count += 1
            print(_line(record), flush=True)
        return count

    def _there(self, row: Row) -> bool:
        there = not row.drawn or (Path(row.folder) / HEADER).is_file()
        if not there:
            note(f"{row.name}: there is no model in {row.folder} yet, left out")
        return there

    def _turns(self, rows: Sequence[Row]) -> Iterator[tuple[Row, SplitSize, int]]:
        most = max(size.repetitions for size in self.plan.split)
        for repetition in range(most):
            for row in rows:
                for split in row.splits:
                    size = self.plan.size(split)
                    if repetition < min(size.repetitions, row.repetitions or most):
                        yield row, size, repetition

    def _key(self, row: Row, size: SplitSize, repetition: int) -> Key:
        chunks, part = self._amount(size.chunks)
        protocol = asdict(self.plan.protocol) | {"chunks": chunks, "part": part}
        if row.performed:
            protocol["performed"] = made_with()
        digest = key_of("record/1", self.judges.hash, self.makers.identity(row), protocol)
        return (row.name, size.name, str(repetition), digest)

    def _amount(self, chunks: int) -> tuple[int, int]:
        """Return how many chunks are used, and how many clips of the last one."""
        size = self.plan.protocol.chunk
        if self.limit is None or self.limit >= chunks * size:
            return chunks, size
        return -(-self.limit // size), self.limit - size * ((self.limit - 1) // size)

    def _set(self, split: Split, seed: int) -> HeldOut:
        protocol = self.plan.protocol
        root = self.root / "clips"
        return HeldOut(split, protocol.fps, protocol.frames, root, protocol.chunk, seed)

    def _standard(self) -> Standard:
        """Return the reference: real performances that nobody is asked for."""
        asked: list[Asked] = []
        features = []
        for number in range(self._amount(self.plan.protocol.reference)[0]):
            self.clock.check()
            said, chunk = self._set("test", SEED + 1).chunk(number)
            asked += said
            features += chunk.features
        led = self.judges.led(asked, features)
        return Standard(self.judges, self.judges.watch(features), led)

    def _record(
        self, row: Row, size: SplitSize, repetition: int, standard: Standard
    ) -> dict[str, Any]:
        seed = [self.plan.protocol.seed, SPLITS.index(size.name), repetition]
        asked: list[Asked] = []
        texts: list[str] = []
        chunks = []
        for order in self._orders(size, repetition):
            self.clock.check()
            chunks.append(self.makers.take(row, order))
            asked += order.asked
            texts += order.texts
        record = measured_row(Taken(asked, texts, chunks), standard, seed)
        if row.spread and size.name == "test" and repetition == 0:
            made = []
            for order in self._spread_orders():
                self.clock.check()
                made.append(self.makers.take(row, order))
            record["figures"]["multimodality"] = spread_of(made, self.judges, seed)
        if row.performed and size.name == "test" and repetition == 0:
            chunk = self.makers.performed(row, next(iter(self._orders(size, repetition))))
            record["figures"] |= {n: mean_of([f[n] for f in chunk.figures]) for n in NAMES}
        record["leaders"] = len(standard.led)
        if row.drawn:
            loaded = self.makers.models.load(row)
            record |= {
                "weights": loaded.hash[:12],
                "trained_steps": loaded.model.provenance.training.get("steps"),
            }
        return record

    def _orders(self, size: SplitSize, repetition: int) -> Iterator[Order]:
        chunks, part = self._amount(size.chunks)
        for number in range(chunks):
            asked, performed = self._set(size.name, SEED).chunk(number)
            count = part if number == chunks - 1 else len(asked)
            if count < len(asked):
                asked, performed = asked[:count], _first(performed, count)
            head = [self.plan.protocol.seed, SPLITS.index(size.name), repetition]
            yield Order(
                f"{size.name}-{repetition:02d}-{number:03d}-{count}",
                asked,
                [one.text(repetition) for one in asked],
                [[*head, one.number] for one in asked],
                performed,
            )

    def _spread_orders(self) -> Iterator[Order]:
        """Yield one order per sentence, for many motions of it."""
        protocol = self.plan.protocol
        asked, _ = self._set("test", SEED).chunk(0)
        every = max(1, len(asked) // protocol.spread_texts)
        limit = None if self.limit is None else max(2, self.limit // len(asked))
        for one in asked[::every][: limit or protocol.spread_texts]:
            count = protocol.spread_motions
            yield Order(
                f"spread-{one.number:03d}",
                [one] * count,
                [one.text(0)] * count,
                [[protocol.seed, _SPREAD, one.number, i] for i in range(count)],
            )


def _first(chunk: Chunk, count: int) -> Chunk:
    return replace(
        chunk,
        features=chunk.features[:count],
        figures=chunk.figures[:count],
        spectra=chunk.spectra[:count],
    )


def _line(record: Record) -> str:
    """Return one result for the terminal."""
    found = record["figures"]
    shown = ("r_precision_top3", "fid", "class", "role", "met")
    cells = [f"{k} {found[k]:.3f}" for k in shown if found.get(k) is not None]
    name = f"{record['row']}, {record['split']} {record['repetition']}"
    return f"{name}: {record['clips']} clips, {', '.join(cells)}"
