"""``pasdedeux bus``: a virtual Dynamixel bus for any client, under a stable name."""

from __future__ import annotations

import argparse
import signal
from pathlib import Path

from bridge.cli.console import Console
from bridge.cli.options import DEFAULT_ROBOT, add_plant


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add whose servos hang on the bus and what it is called."""
    parser.add_argument(
        "--robot", default=DEFAULT_ROBOT, metavar="NAME", help="whose servos (default op3)"
    )
    parser.add_argument("--bus", metavar="NAME", help="which bus of the robot, if it has several")
    parser.add_argument(
        "--link", type=Path, metavar="PATH", help="symbolic link to make for the port"
    )
    add_plant(parser)
    parser.add_argument(
        "--no-timing", action="store_true", help="answer at once, not at the speed of the wire"
    )
    parser.add_argument(
        "--faults", type=Path, metavar="TOML", help="what goes wrong, and when (docs/servos.md)"
    )


def execute(args: argparse.Namespace, console: Console) -> int:
    """Serve until Ctrl-C or SIGTERM."""
    from bridge.virtual import FaultPlan, PtyServer, virtual_bus_for
    from robots.registry import load_robot

    robot = load_robot(args.robot)
    faults = FaultPlan.load(args.faults) if args.faults else None
    served = virtual_bus_for(robot, args.bus, plant=args.plant, faults=faults)
    server = PtyServer(served, link=args.link, timing=not args.no_timing)
    for name in (signal.SIGINT, signal.SIGTERM):  # all that is left to do then is to leave
        signal.signal(name, lambda *_: server.stop())
    try:
        baud = (
            next(iter(robot.buses.values())).baud
            if args.bus is None
            else robot.buses[args.bus].baud
        )
        console.result({"port": server.port, "robot": robot.name, "baud": baud})
        console.say(
            f"{robot.name}: {len(robot.joints)} servos at {server.port}, {baud} baud; Ctrl-C ends"
        )
        server.serve()
    finally:
        server.close()
    return 0
