"""``pasdedeux track``: two humanoids perform a motion in physics."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.options import add_assist, add_motion_request, in_folder, motion_request


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is tracked and how."""
    parser.add_argument("motion", type=Path, help="any motion file")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(stages.ROLLOUT), help="file or folder"
    )
    add_assist(parser)
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Track, and say who fell."""
    out = in_folder(args.out, stages.ROLLOUT)
    with console.stage("track") as progress:
        rollout = stages.track(
            args.motion,
            out,
            request=motion_request(args),
            controller=args.controller,
            assist=args.assist,
            progress=progress,
        )
    fell = [person for person, yes in rollout.fell.items() if yes]
    ending = f"{' and '.join(fell)} fell" if fell else "nobody fell"
    console.show(f"{out}: {rollout.times[-1]:.1f} s, {ending}")
    console.result(
        {
            "file": str(out),
            "seconds": float(rollout.times[-1]),
            "fell": rollout.fell,
            "fall_time_s": rollout.fall_time,
        }
    )
    return 1 if fell else 0
