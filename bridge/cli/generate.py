"""``pasdedeux generate``: a sentence to a motion file."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.options import (
    add_generator,
    add_intergen,
    add_seed,
    diffusion_request,
    in_folder,
    intergen_request,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the sentence and where its motion goes."""
    parser.add_argument("text", help='what the two do, for example "two people shake hands"')
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(stages.MOTION), help="file or folder"
    )
    add_seed(parser)
    add_generator(parser)
    add_intergen(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Generate and say what was understood."""
    out = in_folder(args.out, stages.MOTION)
    intergen, diffusion = intergen_request(args), diffusion_request(args)
    with console.stage("generate") as progress:
        facts = stages.generate(
            args.text,
            out,
            seed=args.seed,
            nearest_known=args.nearest,
            generator=args.generator,
            intergen=intergen,
            diffusion=diffusion,
            progress=progress,
        )
    if intergen is None and diffusion is None:
        how = f"{facts['interaction']} ({facts['confidence']:.0%} sure)"
    else:
        how = f"{facts['model']}, {facts['steps']} steps"
    console.show(f"{out}: {how}, {facts['frames']} frames at {facts['fps']:g} Hz")
    console.result({"file": str(out), **facts})
    return 0
