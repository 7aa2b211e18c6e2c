"""``pasdedeux generate``: a sentence to a motion file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.generator_options import (
    add_generator,
    add_people,
    diffusion_request,
    intergen_request,
    style_request,
)
from bridge.cli.options import add_seed, in_folder
from bridge.cli.tables import understood

if TYPE_CHECKING:
    from generator.runtime.request import DiffusionRequest


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sentence and where its motion goes."""
    parser.add_argument("text", help='what the two do, for example "two people shake hands"')
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(stages.MOTION), help="file or folder"
    )
    add_seed(parser)
    add_generator(parser, speed=("--speed",))
    add_people(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Generate and say what was understood."""
    out = in_folder(args.out, stages.MOTION)
    intergen, diffusion = intergen_request(args), diffusion_request(args)
    if diffusion is not None and diffusion.people > 2:
        return _group(args, diffusion, out, console)
    with console.stage("generate") as progress:
        facts = stages.generate(
            args.text,
            out,
            seed=args.seed,
            nearest_known=args.nearest,
            generator=args.generator,
            intergen=intergen,
            diffusion=diffusion,
            style=style_request(args),
            raw=args.raw,
            progress=progress,
        )
    how = [f"{facts['interaction'] or facts['model']} by {facts['generator']}", *understood(facts)]
    how += [f"{facts['steps']} steps"] if "steps" in facts else []
    how += ["finished"] if "finishing" in facts else []
    console.show(f"{out}: {', '.join(how)}, {facts['frames']} frames at {facts['fps']:g} Hz")
    console.result({"file": str(out), **facts})
    return 0


def _group(args: argparse.Namespace, request: DiffusionRequest, out: Path, console: Console) -> int:
    """Generate more than two people: one file a pair."""
    with console.stage("generate") as progress:
        facts = stages.generate_group(
            args.text, out, request, seed=args.seed, raw=args.raw, progress=progress
        )
    for file in facts["files"]:
        console.show(f"{file}: {facts['frames']} frames at {facts['fps']:g} Hz")
    console.result(facts)
    return 0
