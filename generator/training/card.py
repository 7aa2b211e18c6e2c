"""The model card: what somebody who finds a folder of weights has to know."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from generator.model import InterGen
from generator.runtime.portable import Precision, Sampling
from robots.errors import SpecError
from robots.files import MAX_HEADER_BYTES

CARD = "MODEL_CARD.md"
UNMEASURED = (
    "Not measured. `pasdedeux evaluate` does it for any model, `make results` for those of the\n"
    "project; figures of different evaluators cannot be compared."
)

_TEXT = """\
# {name}

Text to the motion of two people by diffusion, after InterGen (Liang et al., IJCV 2024); own code
and own weights. Draw from it with `pasdedeux generate "..." --generator diffusion --weights
FOLDER`, or with torch by `--generator intergen`. The model that comes with the package needs no
`--weights`.

| | |
|---|---|
| licence of the weights and of what is drawn from them | {licence} |
| numbers | {count:.2f} million, {sizes} |
| sentences | {text}, frozen |
| motion | {fps:g} frames per second, up to {seconds:.1f} s |
| network without torch | {precision} |
| drawn by default with | {sampling} |

## Data and training

{data}

{steps}; losses at the end, weighted: {losses}.

## Figures

{figures}

## Limits

{knows}

Longer motions than it has learnt are drawn in windows that overlap. As drawn, bones are as long as
their keypoints lie apart, which varies over a motion, and feet may slide; the package finishes what
it draws (`--raw` leaves that out). Bodies have 22 keypoints: no fingers, no faces. What is drawn is
not safe to perform on robots before physics and the report's gate have judged it.
"""
_REPERTOIRE = """\
It has seen what the choreographer of this project invents, {count} kinds of interactions, and
nothing else; no person was recorded. Sentences outside that repertoire are refused, and with
`--nearest` taken for the nearest that is in it. Which sentence is which is guessed from its vector
of meaning, so some are refused or taken wrongly."""
_ANYTHING = """\
It knows what its data show and nothing else: sentences about other things give a motion, but not
of them."""


@dataclass(frozen=True, slots=True)
class Figures:
    """What was measured of a model, as its card shows it."""

    about: str
    """What was measured, how, by whom."""
    columns: Mapping[str, Mapping[str, str]]
    """Title of each column, and its cells by the names of the lines."""

    @classmethod
    def load(cls, path: str | Path) -> Figures:
        """Read ``{"about": TEXT, "columns": {TITLE: {NAME: NUMBER OR TEXT}}}``.

        Raises:
            SpecError: The file is missing or holds something else.
        """
        try:
            with open(path, "rb") as file:
                content = json.loads(file.read(MAX_HEADER_BYTES))
            columns = {
                str(title): {str(name): str(value) for name, value in cells.items()}
                for title, cells in content["columns"].items()
            }
            return cls(str(content["about"]), columns)
        except OSError as error:
            raise SpecError(f"cannot be read: {error}", where=str(path)) from error
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise SpecError(
                "holds no figures of a model",
                where=str(path),
                allowed='{"about": "...", "columns": {"title": {"name": "value"}}}',
            ) from error

    def markdown(self) -> str:
        """Return the figures as a table: a line each, a column per title."""
        names = dict.fromkeys(name for cells in self.columns.values() for name in cells)
        lines = [["", *self.columns], ["---"] * (1 + len(self.columns))]
        lines += [
            [name, *(cells.get(name, "") for cells in self.columns.values())] for name in names
        ]
        table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
        return f"{self.about}\n\n{table}"


def model_card(
    model: InterGen,
    sampling: Sampling,
    precision: Precision,
    repertoire: bool = False,
    figures: Figures | None = None,
) -> str:
    """Return the card of a model, from what it knows of itself and what was measured of it.

    Args:
        model: The model.
        sampling: How it is drawn from.
        precision: Of its network.
        repertoire: Whether it has seen the choreographer's repertoire and nothing else.
        figures: What was measured.
    """
    facts, config = model.provenance.training, model.config
    losses = facts.get("losses") or {}
    chosen = asdict(sampling)
    frames = chosen.pop("frames")
    return _TEXT.format(
        name=model.provenance.source or "A model",
        licence=model.provenance.licence or "unknown",
        count=sum(p.numel() for p in model.denoiser.parameters()) / 1e6,
        sizes=f"{config.layers} layers of {config.width}, {config.heads} heads",
        text=facts.get("text", "unknown"),
        fps=model.provenance.fps,
        seconds=frames / model.provenance.fps,
        precision=precision,
        sampling=_listed(chosen),
        data=_data(facts.get("data", [])),
        steps=_steps(facts),
        losses=_listed({k: f"{v:.4f}" for k, v in losses.items() if k != "norm"}) or "unknown",
        knows=_known(repertoire),
        figures=UNMEASURED if figures is None else figures.markdown(),
    )


def _steps(facts: Mapping[str, Any]) -> str:
    """Return how long a model has learnt, and what came before."""
    steps, of = facts.get("steps", "unknown"), facts.get("of")
    learnt = f"{steps} steps" if of in (None, steps) else f"{steps} of {of} steps"
    earlier, lessons = facts.get("earlier_steps"), facts.get("lessons")
    if earlier:
        learnt += f", going on from a model of {earlier} steps"
    if lessons:
        learnt += f"; {lessons} steps of lessons in reading"
    return learnt


def _data(names: list[Any]) -> str:
    """Return the sources of data, those of one kind together."""
    kinds = Counter(str(name).partition(", seed ")[0] for name in names)
    listed = (kind if count == 1 else f"{count} times {kind}" for kind, count in kinds.items())
    return f"Data: {', '.join(listed) or 'unknown'}."


def _known(repertoire: bool) -> str:
    if not repertoire:
        return _ANYTHING
    from generator.choreographer import repertoire as interactions

    return _REPERTOIRE.format(count=len(interactions()))


def _listed(values: dict[str, Any]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in values.items())
