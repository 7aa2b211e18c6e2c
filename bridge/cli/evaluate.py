"""``pasdedeux evaluate``: a model to a table of figures, ground truth first."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.cli.console import Console
from bridge.cli.train import require_torch

if TYPE_CHECKING:
    from generator.evaluation import EvaluationConfig

FIGURES = {
    "r_precision_top1": ("R-precision top 1", 3),
    "r_precision_top2": ("R-precision top 2", 3),
    "r_precision_top3": ("R-precision top 3", 3),
    "fid": ("FID", 3),
    "mm_dist": ("MM Dist", 3),
    "diversity": ("Diversity", 3),
    "multimodality": ("MModality", 3),
}
"""Name in the report to title and decimals."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the model, the clips and how much is measured."""
    parser.add_argument("model", type=Path, help="folder of a model, or a published .ckpt")
    parser.add_argument(
        "--data",
        metavar="KIND[:ROOT]",
        help="clips to compare with: interhuman:FOLDER (its test split), duets:FOLDER, or"
        " choreographed:COUNT (default: what fits the model's own config.toml)",
    )
    parser.add_argument(
        "--evaluator",
        type=Path,
        metavar="DIR",
        help="contrastive evaluator: a folder, or a published .ckpt (default: evaluator/ beside"
        " the model, trained now on the model's training clips if it is not there)",
    )
    parser.add_argument(
        "--evaluator-steps", type=int, default=1000, help="training steps of an evaluator"
    )
    parser.add_argument("-o", "--out", type=Path, help="folder (default: evaluation/ in the model)")
    parser.add_argument("--repetitions", type=int, default=20, help="(default 20)")
    parser.add_argument(
        "--multimodality", type=int, default=5, metavar="N", help="repetitions of MModality (5)"
    )
    parser.add_argument(
        "--multimodality-texts", type=int, default=100, metavar="N", help="sentences of it (100)"
    )
    parser.add_argument("--clips", type=int, help="take so many clips at most")
    parser.add_argument("--steps", type=int, default=50, help="sampling steps (default 50)")
    parser.add_argument("--guidance", type=float, default=3.5, help="weight of the text (3.5)")
    parser.add_argument(
        "--length-step",
        type=int,
        default=1,
        metavar="FRAMES",
        help="round lengths to multiples of this, so that batches fill (default 1)",
    )
    parser.add_argument("--batch", type=int, default=16, help="motions at a time (default 16)")
    parser.add_argument("--cache", type=Path, help="folder of prepared clips")
    parser.add_argument("--threads", type=int, help="(default: all cores but one)")
    parser.add_argument("--seed", type=int, default=0)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Measure and show the table."""
    require_torch()
    from generator.assessment import Assessment, assess
    from generator.evaluation import Watch
    from generator.threads import thread_limit

    with thread_limit(args.threads), console.stage("evaluate") as progress:
        report = assess(
            Assessment(
                model=args.model,
                out=args.out,
                data=args.data or "",
                evaluator=args.evaluator,
                evaluator_steps=args.evaluator_steps,
                clips=args.clips,
                cache=args.cache,
                config=_config(args),
            ),
            watch=Watch(announce=console.say, progress=progress),
        )
    show_figures(console, report)
    console.result(report)
    return 0


def _config(args: argparse.Namespace) -> EvaluationConfig:
    from generator.evaluation import EvaluationConfig
    from generator.intergen import IntergenRequest, sampler_of

    request = IntergenRequest(steps=args.steps, guidance=args.guidance)
    return EvaluationConfig(
        repetitions=args.repetitions,
        multimodality_repetitions=args.multimodality,
        multimodality_texts=args.multimodality_texts,
        length_step=args.length_step,
        batch=args.batch,
        seed=args.seed,
        sampler=sampler_of(request),
    )


def show_figures(console: Console, report: dict[str, Any]) -> None:
    """Print one table per scale: every figure of real and of generated motions."""
    rows = report["rows"]
    for scale, numbers in report["scales"].items():
        lines = []
        for key, (title, digits) in FIGURES.items():
            cells = [_cell(rows[row][scale].get(key), digits) for row in rows]
            if any(cells):
                lines.append([title, *cells])
        title = (
            f"{scale} scale: {report['clips']} clips, {report['settings']['repetitions']}"
            f" repetitions, pools of {numbers['pool']}"
        )
        console.table(title, ["", *rows], lines)


def _cell(figure: dict[str, float] | None, digits: int) -> str:
    if figure is None:
        return ""
    return f"{figure['mean']:.{digits}f} ±{figure['interval']:.{digits}f}"
