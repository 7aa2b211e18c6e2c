"""``pasdedeux export``: to the formats that other programs read."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge.cli.console import Console
from bridge.cli.options import add_motion_request, motion_request


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is exported, to what and where."""
    from bridge.exporting import FORMATS

    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        help="a motion, a rollout, telemetry and/or both trajectories; side by side in a video",
    )
    parser.add_argument(
        "--to",
        required=True,
        metavar="FORMAT[,FORMAT]",
        help="; ".join(f"{name}: {what}" for name, what in FORMATS.items()),
    )
    parser.add_argument("-o", "--out", type=Path, default=Path(), help="folder (default: here)")
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Export and name the files."""
    from bridge.exporting import export

    formats = [word.strip() for word in args.to.split(",") if word.strip()]
    with console.stage("export"):
        written = export(args.files, formats, args.out, motion_request(args))
    for path in written:
        console.show(str(path))
    console.result({"files": [str(path) for path in written]})
    return 0
