"""``pasdedeux view``: look at a file in the browser."""

from __future__ import annotations

import argparse
import signal
import threading
from pathlib import Path

from bridge.cli.console import Console
from bridge.cli.options import add_motion_request, motion_request
from robots.errors import SpecError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is shown and where."""
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        help="a motion, a rollout, telemetry, or both trajectories of a duet",
    )
    parser.add_argument("--host", default="127.0.0.1", help="0.0.0.0 shows it to the network")
    parser.add_argument("--port", type=int, default=8080, help="of the page (default 8080)")
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Serve the page until Ctrl-C."""
    from bridge.show import clips_of
    from sim.viewer import Viewer

    clips = clips_of(args.files, motion_request(args))
    if len(clips) != 1:
        raise SpecError(f"{len(clips)} things to show", allowed="one at a time")
    viewer = Viewer(clips[0], host=args.host, port=args.port)
    stop = threading.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda *_: stop.set())
    console.result({"address": viewer.address})
    console.say(f"look at {viewer.address}; Ctrl-C ends")
    viewer.play(stop)
    return 0
