"""``pasdedeux score``: is it plausible?"""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.options import add_motion_request, in_folder, motion_request
from bridge.cli.tables import show_report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is judged."""
    parser.add_argument("file", type=Path, help="a rollout, or a motion without physics")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(stages.REPORT), help="file or folder"
    )
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Judge; 0 if it passed, else 1."""
    out = in_folder(args.out, stages.REPORT)
    with console.stage("score"):
        report = stages.score(args.file, out, request=motion_request(args))
    show_report(console, report)
    console.result({"file": str(out), **report.to_json()})
    return 0 if report.passed else 1
