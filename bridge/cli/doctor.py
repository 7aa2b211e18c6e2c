"""``pasdedeux doctor``: check this machine, a robot's buses, and the servos on a port."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from bridge.cli.console import Console

_MARKS = {"ok": "[green]ok[/]", "note": "[yellow]note[/]", "fail": "[red]fail[/]"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which robot's buses are checked, and on which port its servos."""
    parser.add_argument(
        "--robot", metavar="NAME", help="check the bit rate of this robot's buses (default: all)"
    )
    parser.add_argument("--rate", type=float, metavar="HZ", help="against this many ticks a second")
    parser.add_argument("--port", help="look at the servos there, too; needs --robot")
    parser.add_argument("--bus", metavar="NAME", help="which bus of the robot, if it has several")


def execute(args: argparse.Namespace, console: Console) -> int:
    """Print the findings; 0 if nothing fails, else 2."""
    from bridge.doctor import examine, examine_buses, examine_servos
    from robots.errors import SpecError
    from robots.registry import load_robot, robot_names

    if args.rate is not None and not 1 <= args.rate <= 1000:
        raise SpecError(f"--rate {args.rate:g}", allowed="1 to 1000")
    if args.port is not None and args.robot is None:
        raise SpecError("--port without --robot", hint="say whose servos hang there")
    names = robot_names() if args.robot is None else (args.robot,)
    robots = [load_robot(name) for name in names]
    findings = examine()
    for robot in robots:
        findings += examine_buses(robot, args.rate)
    if args.port is not None:
        from bridge.setup.line import bus_name, line_of
        from bridge.setup.scan import scan

        bus = bus_name(robots[0], args.bus)
        with line_of(args.port, robots[0], bus) as line, console.stage("scan"):
            found = scan(line, [robots[0].buses[bus].baud])
        findings += examine_servos(robots[0], bus, found)
    failed = any(finding.status == "fail" for finding in findings)
    console.table(
        "this machine",
        ["what", "state", "found", "do"],
        [[f.name, _MARKS[f.status], f.detail, f.hint] for f in findings],
    )
    console.result({"passed": not failed, "findings": [asdict(f) for f in findings]})
    return 2 if failed else 0
