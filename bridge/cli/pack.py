"""``pasdedeux pack``: a trained model to a folder that runs without torch."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bridge.cli.console import Console
from bridge.cli.train import PRECISIONS, require_torch

_SAMPLING = ("solver", "steps", "spacing", "guidance", "guidance_interval")
"""Options that become the model's own way of being drawn from."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the run, where the model goes, and how it is to be drawn from."""
    parser.add_argument("run", type=Path, help="folder that 'pasdedeux train' left")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the packed model")
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default=PRECISIONS[0],
        help="of the network: numbers stored in 16 bits (default) or 32, or multiplied in 8",
    )
    group = parser.add_argument_group("how it is drawn from if nobody says otherwise")
    group.add_argument("--solver", choices=("ddim", "dpm2m"), help="(default dpm2m)")
    group.add_argument("--steps", type=int, help="sampling steps (default 10)")
    group.add_argument("--spacing", choices=("leading", "trailing"), help="(default trailing)")
    group.add_argument("--guidance", type=float, help="weight of the text (default 2)")
    group.add_argument(
        "--guidance-interval",
        type=int,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="first and last diffusion step that is guided (default 0 999)",
    )
    parser.add_argument(
        "--figures",
        type=Path,
        metavar="JSON",
        help="what was measured, for the model card (python -m benchmarks.results.card)",
    )


def execute(args: argparse.Namespace, console: Console) -> int:
    """Pack and say how large it is."""
    require_torch()
    from generator.training.card import Figures
    from generator.training.portable import pack

    sampling: dict[str, Any] = {
        name: value for name in _SAMPLING if (value := getattr(args, name)) is not None
    }
    with console.stage("pack"):
        sizes = pack(
            args.run,
            args.out,
            precision=args.precision,
            sampling=sampling,
            figures=Figures.load(args.figures) if args.figures else None,
        )
    for name, size in sizes.items():
        console.show(f"{args.out / name}: {size / 1e6:.2f} MB")
    console.show(f"together {sum(sizes.values()) / 1e6:.2f} MB")
    console.result({"folder": str(args.out), "bytes": sizes})
    return 0
