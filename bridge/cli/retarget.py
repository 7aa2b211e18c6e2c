"""``pasdedeux retarget``: a motion to joint trajectories for two servo robots."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.options import add_motion_request, add_robots, motion_request, robot_pair
from bridge.sources import load_robots


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is retargeted and to whom."""
    parser.add_argument("motion", type=Path, help="any motion file, or a rollout")
    parser.add_argument("-o", "--out", type=Path, default=Path(), help="folder (default: here)")
    add_robots(parser)
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Retarget, and say how well contacts survived."""
    robots = load_robots(*robot_pair(args))
    with console.stage("retarget") as progress:
        report = stages.retarget(
            args.motion, robots, args.out, request=motion_request(args), progress=progress
        )
    for name in stages.TRAJECTORIES:
        console.show(str(args.out / name))
    console.table(
        "retargeting", ["", "value"], [[name, _text(value)] for name, value in report.items()]
    )
    console.result({"folder": str(args.out), **report})
    return 0


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(_text(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(item)}" for key, item in value.items())
    return str(value)
