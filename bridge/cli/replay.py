"""``pasdedeux replay``: what a telemetry file tells, as figures and as a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge.cli.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which file, and where the picture goes."""
    parser.add_argument("telemetry", type=Path, help="telemetry.jsonl, also of a run that crashed")
    parser.add_argument(
        "-o", "--out", type=Path, metavar="PNG", help="picture (default: beside the file)"
    )
    parser.add_argument("--no-plot", action="store_true", help="figures alone")


def execute(args: argparse.Namespace, console: Console) -> int:
    """Compute the summary again and draw; whatever the outcome was, 0 if the file can be read."""
    from bridge.player.replay import replay

    told = replay(args.telemetry)
    out: Path = args.out or args.telemetry.with_suffix(".png")
    if not args.no_plot:
        from bridge.player.plot import plot

        with console.stage("plot"):
            plot(told, out)
    done = told.performance
    for person, track in done.tracking.items():
        console.show(
            f"{person} ({track.robot}): {track.rms_deg:.2f}° off (at most {track.max_deg:.1f}°,"
            f" {track.worst_joint}), {track.lag_ms:.0f} ms behind,"
            f" {track.missed_reads} answers missing"
        )
    console.show(
        f"{done.outcome}: {done.ticks} ticks in {done.duration:.1f} s at {done.rate:g} Hz,"
        f" {done.late_ticks} late, {done.dropped_ticks} left out,"
        f" {done.skew_p99_ms:.2f} ms between the robots"
    )
    if not told.closed:
        console.show("the file has no closing line: the player did not come to its end")
    if not args.no_plot:
        console.show(str(out))
    console.result(
        {
            "performance": done.to_json(),
            "closed": told.closed,
            "events": [{"t": round(time, 3), "what": what} for time, what in told.events],
            "plot": None if args.no_plot else str(out),
        }
    )
    return 0
