"""Trains what is compared at a small scale, run by run, with exact resume.

These are the ablations of Tables 3 and 4, and runs on other data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from generator.model_folder import HEADER, read_header
from generator.training.config import RunConfig, load_config, parse
from generator.training.toml import build, read_toml
from generator.training.train import STATE, Report, Watch, train
from robots.errors import SpecError

FILE = Path(__file__).with_name("ablations.toml")
_TABLES = ("model", "objective")
"""What an ablation changes lies in these."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One model of the comparison."""

    name: str
    """Of its folder."""
    changes: str = ""
    """Configuration of the paper's size that changes the same; the base changes nothing."""
    config: str = ""
    """Configuration at this scale that is trained instead of the base."""
    cycles: int | None = None
    """Of the learning rate, instead of as many as the configuration has."""
    real: float = 0.0
    """Share of real clips among the samples."""

    def __post_init__(self) -> None:
        """Validate.

        Raises:
            SpecError: The share is out of range.
        """
        if not 0 <= self.real < 1:
            raise SpecError(f"{self.real}", where=f"{self.name}, real", allowed="0 to less than 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ablations:
    """All of them."""

    base: str
    """Configuration at this scale."""
    paper: str
    """The paper's configuration, which each variant's is compared with."""
    folder: str
    """Where the runs lie, each in a folder of its own."""
    real: str
    """Where the real clips lie that are learnt from (:mod:`benchmarks.results.real`)."""
    variant: tuple[Variant, ...]
    """In the order of training."""

    def run(self, variant: Variant) -> RunConfig:
        """Return the configuration of a variant.

        Raises:
            SpecError: A file cannot be read, or its variant changes nothing.
        """
        tables = load_config(variant.config or self.base).tables()
        tables["name"] = variant.name if variant.config else f"{tables['name']}-{variant.name}"
        if variant.cycles is not None:
            tables["training"]["cycles"] = variant.cycles
        if variant.changes:
            changes = _changes(load_config(self.paper), load_config(variant.changes))
            if not any(changes.values()):
                raise SpecError("it changes nothing", where=variant.changes)
            for name, table in changes.items():
                tables[name] |= table
        if variant.real:
            invented = tables["data"]["source"]
            weight = variant.real / (1 - variant.real) * sum(s["weight"] for s in invented)
            real = {"kind": "duets", "root": self.real, "weight": weight}
            tables["data"]["source"] = [*invented, real]
        return parse(tables, where=variant.name)


def load_ablations(path: Path = FILE) -> Ablations:
    """Return the ablations that a file describes.

    Raises:
        SpecError: It cannot be read, or a key is unknown.
    """
    return build(Ablations, read_toml(path), where=path.name)


def _changes(paper: RunConfig, other: RunConfig) -> dict[str, dict[str, Any]]:
    old, new = paper.tables(), other.tables()
    return {
        name: {key: value for key, value in new[name].items() if old[name].get(key) != value}
        for name in _TABLES
    }


def train_all(
    ablations: Ablations,
    *,
    only: list[str] | None = None,
    say: Callable[[str], None] = lambda _: None,
    stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Train what is not trained yet; return whether all of it is now that there are clips for.

    Args:
        ablations: Which.
        only: Names of variants; all by default.
        say: Told how it goes.
        stop: Asked after every step whether to save and end.

    Raises:
        DuetError: Clips or a state cannot be read, or a loss is no longer finite.
    """
    for variant in ablations.variant:
        if only is not None and variant.name not in only:
            continue
        run, out = ablations.run(variant), Path(ablations.folder) / variant.name
        if trained_steps(out) >= run.total_steps(steps_per_epoch=1):
            continue
        lacking = [
            f for s in run.data.source if (f := s.root or s.repaired) and not Path(f).is_dir()
        ]
        if lacking:
            say(f"{variant.name}: there is no {', '.join(lacking)} yet, left out")
            continue
        if stop():
            return False
        say(f"training {variant.name}")

        def report(now: Report, name: str = variant.name) -> None:
            loss = now.losses.get("total", float("nan"))
            say(f"{name} {now.step}/{now.total}  loss {loss:.3f}  {now.rate:.2f} steps/s")

        outcome = train(run, out, resume=True, watch=Watch(announce=say, report=report, stop=stop))
        if not outcome.finished:
            return False
    return True


def trained_steps(out: Path) -> int:
    """Return how many steps the run in a folder has done; 0 if there is none."""
    state = out / STATE
    return int(read_header(state).get("step", 0)) if (state / HEADER).is_file() else 0
