"""What is compared, from ``rows.toml``."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from generator.data.choreographed import Split
from generator.diffusion import STEPS, SamplerConfig
from generator.training.toml import build, read_toml
from robots.errors import SpecError, nearest

FILE = Path(__file__).with_name("rows.toml")


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """Something that makes motions of sentences.

    Raises:
        SpecError: Settings do not belong to the kind.
    """

    name: str
    """As the table calls it."""
    tables: tuple[Literal["main", "table3", "table4", "data"], ...] = ("main",)
    """Where it stands."""
    kind: Literal["data", "choreographer", "model", "portable"]
    """The performances themselves, the choreographer that reads the sentence, a network that is
    drawn from as the row says, or one without torch that is drawn from as its folder says."""
    folder: str = ""
    """Of the model."""
    steps: int = 10
    """Sampling steps."""
    solver: Literal["ddim", "dpm2m"] = "dpm2m"
    """Sampler."""
    spacing: Literal["leading", "trailing"] = "trailing"
    """Of its steps."""
    guidance: float = 2.0
    """Weight of the sentence."""
    guided: tuple[int, int] = (0, STEPS - 1)
    """First and last diffusion step at which it is weighted."""
    decoded: bool = False
    """Whether performances are measured as the network's features hold them, not as they were."""
    finish: bool = False
    """Whether post-processing follows (:mod:`generator.finishing`)."""
    splits: tuple[Split, ...] = ("test", "sentences", "combinations")
    """What is asked for."""
    repetitions: int | None = None
    """At most so many."""
    spread: bool = False
    """Whether MModality is measured."""
    performed: bool = False
    """Whether two simulated people perform the first chunk of ``test``."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.drawn != bool(self.folder):
            raise SpecError(f"'{self.kind}' with folder '{self.folder}'", where=self.name)
        if self.decoded and self.kind != "data":
            raise SpecError("only data is decoded", where=self.name)
        if self.finish and self.kind == "data" and not self.decoded:
            raise SpecError("data is finished as decoded", where=self.name)

    @property
    def drawn(self) -> bool:
        """Whether a network draws."""
        return self.kind in ("model", "portable")

    @property
    def sampler(self) -> SamplerConfig:
        """How its motions are drawn, if it is a model."""
        return SamplerConfig(
            self.solver,
            self.steps,
            self.spacing,
            guidance=self.guidance,
            guidance_interval=self.guided,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitSize:
    """How much of a split is asked for."""

    name: Split
    """Which."""
    chunks: int = 8
    """Of :attr:`Protocol.chunk` clips."""
    repetitions: int = 5
    """Times; noise and wording differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """Numbers that all rows share."""

    fps: float = 7.5
    """Rate of the features."""
    frames: int = 75
    """Longest clip, in feature frames."""
    length_step: int = 5
    """Lengths to generate are rounded to multiples of this."""
    chunk: int = 50
    """Clips in a chunk: one of each interaction."""
    reference: int = 12
    """Chunks of real motions that FID compares with."""
    spread_texts: int = 25
    """Sentences of MModality."""
    spread_motions: int = 20
    """Motions of each."""
    seed: int = 0
    """Decides everything that is drawn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluatorSettings:
    """How the judges are trained."""

    config: str = "configs/shipped.toml"
    """Configuration whose training clips they learn from."""
    sources: int = 4
    """So many of its sources."""
    batch: int = 64
    """Clips in a batch."""
    steps: int = 900
    """Of the contrastive evaluator."""
    classifier_steps: int = 500
    """Of the classifier."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """The whole comparison.

    Raises:
        SpecError: Two rows have one name.
    """

    protocol: Protocol = field(default_factory=Protocol)
    """What all share."""
    split: tuple[SplitSize, ...]
    """What is asked for."""
    evaluator: EvaluatorSettings = field(default_factory=EvaluatorSettings)
    """The judges."""
    row: tuple[Row, ...]
    """What is compared, in the order of the tables."""

    def __post_init__(self) -> None:
        """Validate."""
        names = [row.name for row in self.row]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise SpecError(f"two rows are called {', '.join(sorted(twice))}", where="row")

    def chosen(self, names: list[str] | None) -> tuple[Row, ...]:
        """Return the rows of these names; all by default.

        Raises:
            SpecError: There is no such row.
        """
        known = [row.name for row in self.row]
        for name in names or ():
            if name not in known:
                raise SpecError(
                    f"no row '{name}'", allowed="; ".join(known), hint=nearest(name, known)
                )
        return tuple(row for row in self.row if names is None or row.name in names)

    def size(self, split: Split) -> SplitSize:
        """Return how much of a split is asked for.

        Raises:
            SpecError: Nothing of it is.
        """
        for size in self.split:
            if size.name == split:
                return size
        raise SpecError(f"no [[split]] is called '{split}'")


def load_plan(path: Path = FILE) -> Plan:
    """Return the comparison that a file describes.

    Raises:
        SpecError: It cannot be read, or a key is unknown.
    """
    return build(Plan, read_toml(path), where=path.name)
