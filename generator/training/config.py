"""A training run as data: what ``configs/*.toml`` hold. Torch-free."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from generator.architecture import DenoiserConfig
from generator.data.choreographed import SPLITS
from generator.data.curated import KeptPoses, Unjudged
from generator.data.statistics import WIDTHS
from generator.objective import ObjectiveConfig
from generator.training.toml import build, read_toml, write_toml
from robots.errors import SpecError

Freeze = Literal["none", "person", "trajectory", "ends", "mixed"]

_DERIVED = {
    "model": ("features", "text_width", "text_tokens", "text_names"),
    "objective": ("representation", "steps"),
}
"""What follows from other settings: the representation, the text encoder, the diffusion."""

_ADJUSTABLE = {"name", "checkpoint", "log"}
"""Tables that may change between two parts of one run."""


INVENTED = ("choreographed", "exchanged")
"""Kinds of clips that the choreographer invents."""
_SPLITS = {"interhuman": ("train", "val", "test"), **dict.fromkeys(INVENTED, SPLITS)}


def _require(where: str, value: float, low: float, high: float = math.inf) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        allowed = f"{low:g} or more" if high == math.inf else f"{low:g} to {high:g}"
        raise SpecError(f"{value}", where=where, allowed=allowed)


@dataclass(frozen=True, slots=True)
class TextConfig:
    """What turns sentences into condition vectors; always frozen."""

    encoder: Literal["minilm", "minilm-tokens", "minilm-names", "clip", "causal", "initial"] = (
        "minilm"
    )
    """``minilm`` ships with the project, and so do ``minilm-tokens``, which gives every token for
    the network to read (``model.text_layers``), and ``minilm-names``, in which each token also says
    which of the two people it names (for ``model.told_apart``); ``clip`` is CLIP's text tower and
    ``causal`` a language model (the LLaMA row of Table 3), both from a local folder; ``initial`` is
    the one of the model that training starts from."""
    folder: str = ""
    """Where the weights of ``clip`` or ``causal`` lie."""
    lessons: int = 0
    """Steps for which the layers that read the tokens first learn, on sentences of the grammar
    alone, what is done in them, by whom and how; from then on they are frozen too. 0: they learn
    with the rest."""

    def __post_init__(self) -> None:
        """Validate."""
        if (self.encoder in ("clip", "causal")) != bool(self.folder):
            needs = "no folder" if self.folder else "a folder"
            raise SpecError(f"'{self.encoder}' takes {needs}", where="folder")
        _require("lessons", self.lessons, 0)
        if self.lessons and self.encoder not in ("minilm-tokens", "minilm-names"):
            raise SpecError(
                f"lessons for '{self.encoder}', which has no layers that read",
                where="lessons",
                allowed="with minilm-tokens or minilm-names",
            )


@dataclass(frozen=True, slots=True)
class SourceConfig:
    """One source of clips.

    Raises:
        SpecError: A setting does not belong to the kind, or is missing.
    """

    kind: Literal["interhuman", "duets", "choreographed", "exchanged"]
    """The dataset on the user's disk, a folder of motion files, or what the choreographer invents:
    interactions of its repertoire, or exchanges in which each person has a gesture of their own."""
    root: str = ""
    """Folder of ``interhuman`` or ``duets``."""
    split: Literal["train", "val", "test", "sentences", "combinations"] = "train"
    """Which part of ``interhuman``, or of what is invented
    (:data:`generator.data.choreographed.SPLITS`)."""
    count: int = 2000
    """Clips of what is invented."""
    seed: int = 0
    """Seed of what is invented."""
    repaired: str = ""
    """Folder of ``pasdedeux curate``: of ``choreographed`` clips, take those that physics let pass,
    as it repaired them."""
    poses: KeptPoses = "repaired"
    """``raw`` takes the same clips as they were invented."""
    unjudged: Unjudged = "drop"
    """Whether clips without a verdict are left out or kept as they were invented."""
    weight: float = 1.0
    """Share of the samples, relative to the other sources."""

    def __post_init__(self) -> None:
        """Validate."""
        if (self.kind in INVENTED) == bool(self.root):
            raise SpecError(
                f"'{self.kind}' takes {'no' if self.root else 'a'} folder", where="root"
            )
        allowed = _SPLITS.get(self.kind, ("train",))
        if self.split not in allowed:
            raise SpecError(
                f"'{self.kind}' has no '{self.split}'", where="split", allowed=", ".join(allowed)
            )
        if self.repaired and self.kind != "choreographed":
            raise SpecError(f"'{self.kind}' is not repaired", where="repaired")
        for name, default in (("poses", "repaired"), ("unjudged", "drop")):
            if not self.repaired and getattr(self, name) != default:
                raise SpecError(
                    f"'{getattr(self, name)}' of no verdicts",
                    where=name,
                    hint="set 'repaired' to the folder of 'pasdedeux curate'",
                )
        _require("count", self.count, 1)
        _require("seed", self.seed, 0)
        if not (self.weight > 0 and math.isfinite(self.weight)):
            raise SpecError(f"{self.weight}", where="weight", allowed="more than 0")


@dataclass(frozen=True, slots=True)
class DataConfig:
    """What is learnt from.

    Raises:
        SpecError: There is no source.
    """

    source: tuple[SourceConfig, ...] = ()
    """Where the clips come from."""
    cache: str = "runs/cache"
    """Folder in which clips are prepared once."""
    fps: float = 30.0
    """Frames per second to which every clip is brought."""
    frames: int = 300
    """Longest sample, in frames."""
    shortest: int = 15
    """Frames below which a clip is left out."""
    mirror: bool = True
    """Mirror half of the samples."""
    swap: bool = True
    """Exchange the two people in half of the samples."""
    frame: Literal["either", "first"] = "either"
    """On whom the frame is put if people are exchanged: on either at random, or on the first, as
    the motions that are drawn afterwards have it."""
    pad: Literal["full", "longest"] = "longest"
    """Pad batches to ``frames``, or to their longest clip."""
    bucket: int = 1
    """Batches among which samples are dealt out by length, so that less is padded."""
    release_compat: bool = False
    """Prepare samples as the public release does."""
    workers: int = 0
    """Processes that prepare batches; the batches are the same for any number."""

    def __post_init__(self) -> None:
        """Validate."""
        if not self.source:
            raise SpecError(
                "there is no source of clips", where="source", hint="add a [[data.source]]"
            )
        _require("fps", self.fps, 1, 1000)
        _require("frames", self.frames, 2)
        _require("shortest", self.shortest, 2)
        _require("bucket", self.bucket, 1, 1000)
        _require("workers", self.workers, 0, 256)


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """How it is learnt; the defaults are those of Sec. 5.1.

    Raises:
        SpecError: A number is out of range.
    """

    seed: int = 0
    """Decides initial weights and everything that is drawn."""
    batch: int = 64
    """Clips per step, over all processes."""
    epochs: float = 2000.0
    """Length of a cycle: a fall of the learning rate from its highest to zero."""
    steps: int | None = None
    """Length of a cycle in steps, instead of ``epochs``."""
    cycles: int = 1
    """Cycles of the run (warm restarts, https://arxiv.org/abs/1608.03983). More may be added
    later: a run that has ended then goes on."""
    warmup_epochs: float = 10.0
    """Epochs over which the learning rate rises."""
    warmup_steps: int | None = None
    """The same in steps, instead of ``warmup_epochs``."""
    learning_rate: float = 1e-4
    """Highest learning rate."""
    betas: tuple[float, float] = (0.9, 0.999)
    """Of AdamW."""
    weight_decay: float = 2e-5
    """Of AdamW."""
    clip: float = 0.5
    """Largest norm of the gradient; larger ones are scaled down. 0: no limit."""
    ema: float = 0.9999
    """Decay of the moving average of the weights, which is what is used afterwards; it rises to
    this value over the first steps. 0: the weights themselves."""
    unconditional: float = 0.1
    """Share of samples whose text is dropped, for classifier-free guidance."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Of the network's products; weights, losses and the optimiser stay in float32."""
    loss: Literal["paper", "release"] = "paper"
    """Form of the losses; ``release`` is for fine-tuning published weights."""
    freeze: Freeze = "none"
    """Fine-tuning of Sec. 5.4: what is given without noise. ``person``: one of the two;
    ``trajectory``: where a pelvis goes; ``ends``: the first and last frames; ``mixed``: any."""
    freeze_share: float = 0.8
    """Share of samples in which something is given."""
    initial: str = ""
    """Model to start from: a folder of this project, or a published ``.ckpt``."""

    def __post_init__(self) -> None:
        """Validate."""
        _require("seed", self.seed, 0)
        _require("batch", self.batch, 1)
        _require("steps", 1 if self.steps is None else self.steps, 1)
        _require("cycles", self.cycles, 1)
        _require("warmup_steps", self.warmup_steps or 0, 0)
        for name in ("epochs", "learning_rate"):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise SpecError(f"{value}", where=name, allowed="more than 0")
        for name in ("warmup_epochs", "weight_decay", "clip"):
            _require(name, getattr(self, name), 0)
        for name in ("ema", "unconditional", "freeze_share"):
            _require(name, getattr(self, name), 0, 1)
        for value in (*self.betas, self.ema):
            if not 0 <= value < 1:
                raise SpecError(f"{value}", where="betas or ema", allowed="0 up to below 1")


@dataclass(frozen=True, slots=True)
class CheckpointConfig:
    """When the state of training is saved: whichever comes first.

    Raises:
        SpecError: A number is out of range.
    """

    steps: int = 5000
    """After so many steps."""
    minutes: float = 15.0
    """After so many minutes."""

    def __post_init__(self) -> None:
        """Validate."""
        _require("steps", self.steps, 1)
        _require("minutes", self.minutes, 0)


@dataclass(frozen=True, slots=True)
class LogConfig:
    """When figures are written.

    Raises:
        SpecError: A number is out of range.
    """

    steps: int = 50
    """Steps that a line of the log is the mean of."""
    tensorboard: bool = True
    """Also write TensorBoard events, if it is installed."""

    def __post_init__(self) -> None:
        """Validate."""
        _require("steps", self.steps, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Everything that decides a training run."""

    name: str = "intergen"
    """Name of the model, which its motions carry."""
    model: DenoiserConfig = field(default_factory=DenoiserConfig)
    """Architecture; its representation is that of the data and the losses too."""
    text: TextConfig = field(default_factory=TextConfig)
    """Text encoder."""
    objective: ObjectiveConfig = field(default_factory=ObjectiveConfig)
    """Losses."""
    data: DataConfig
    """Clips."""
    training: TrainingConfig = field(default_factory=TrainingConfig)
    """Optimisation."""
    checkpoint: CheckpointConfig = field(default_factory=CheckpointConfig)
    """Saving."""
    log: LogConfig = field(default_factory=LogConfig)
    """Reporting."""

    def __post_init__(self) -> None:
        """Let the representation decide what follows from it, and check what goes together.

        Raises:
            SpecError: Settings contradict each other.
        """
        kind = self.model.representation
        model = replace(self.model, features=WIDTHS[kind])
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "objective", replace(self.objective, representation=kind))
        if self.text.encoder == "initial" and not self.training.initial:
            raise SpecError(
                "there is no initial model to take the encoder from", where="text.encoder"
            )
        if kind == "canonical" and self.training.loss == "release":
            raise SpecError("the release's losses need world positions", where="training.loss")
        if kind == "canonical" and self.training.freeze != "none":
            raise SpecError(
                "the canonical representation holds no place to freeze", where="training.freeze"
            )

    def total_steps(self, steps_per_epoch: int) -> int:
        """Return the length of the run, in steps."""
        return self.training.cycles * self.cycle_steps(steps_per_epoch)

    def cycle_steps(self, steps_per_epoch: int) -> int:
        """Return the length of a cycle of the learning rate, in steps."""
        if self.training.steps is not None:
            return self.training.steps
        return max(1, round(self.training.epochs * steps_per_epoch))

    def warmup_steps(self, steps_per_epoch: int) -> float:
        """Return the length of the warm-up, in steps."""
        if self.training.warmup_steps is not None:
            return self.training.warmup_steps
        return self.training.warmup_epochs * steps_per_epoch

    def tables(self) -> dict[str, Any]:
        """Return everything as plain tables, as a TOML file would have them.

        What follows from other settings is left out, and so is what is not set.
        """
        tables = asdict(self)
        for name, derived in _DERIVED.items():
            for key in derived:
                del tables[name][key]
        training = tables["training"]
        tables["training"] = {k: v for k, v in training.items() if v is not None}
        return tables

    def toml(self) -> str:
        """Return the text of a TOML file that gives this run."""
        return write_toml(self.tables())


def parse(tables: dict[str, Any], *, where: str = "configuration") -> RunConfig:
    """Return the run that tables describe.

    Raises:
        SpecError: A key is unknown (the nearest is named), of another type, or out of range.
    """
    known = {"model": DenoiserConfig, "objective": ObjectiveConfig}
    parts = {
        name: build(kind, tables[name], where=f"{where}: {name}", derived=_DERIVED[name])
        for name, kind in known.items()
        if name in tables
    }
    rest = {key: value for key, value in tables.items() if key not in parts}
    run = build(RunConfig, {"data": {}, **rest}, where=where)
    return replace(run, **parts)


def load_config(path: str | Path) -> RunConfig:
    """Return the run that a TOML file describes.

    Raises:
        SpecError: As :func:`parse`; or the file cannot be read.
    """
    return parse(read_toml(path), where=str(path))


def changed_keys(old: RunConfig, new: RunConfig) -> list[str]:
    """Return the settings in which two runs differ, except those that may change on the way."""
    before, after = old.tables(), new.tables()
    changed = []
    for table in before.keys() - _ADJUSTABLE:
        for key in before[table].keys() | after[table].keys():
            same = before[table].get(key) == after[table].get(key)
            if not same and (table, key) not in _HARMLESS:
                changed.append(f"{table}.{key}")
    return sorted(changed)


_HARMLESS = {("data", "cache"), ("data", "workers"), ("training", "cycles")}
"""Settings that change nothing of what has been learnt so far."""
