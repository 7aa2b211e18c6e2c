"""``pasdedeux scan``: who hangs on a servo bus, at which rate, and what is wrong there."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from bridge.cli.asking import add_robot
from bridge.cli.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add where to look."""
    parser.add_argument(
        "--port", default="virtual", help="serial port, or 'virtual' (default) for --robot's bus"
    )
    parser.add_argument(
        "--baud", type=int, nargs="+", metavar="B", help="only these rates (default: all)"
    )
    parser.add_argument(
        "--protocol",
        type=int,
        nargs="+",
        choices=(1, 2),
        default=[1, 2],
        metavar="P",
        help="only this one (default: 2 and 1; 1 takes 5 s and more for each rate, its two factory"
        " rates or those of --baud)",
    )
    parser.add_argument(
        "--compare", action="store_true", help="with what --robot's file says is there"
    )
    add_robot(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Scan and tell; 3 if nobody answers or something is wrong."""
    from bridge.servo.registers import BAUD_RATES
    from bridge.setup.line import bus_name, line_of
    from bridge.setup.scan import OLD_BAUDS, mismatches, old_rates, scan
    from robots.errors import SpecError
    from robots.registry import load_robot

    rates = {2: BAUD_RATES, 1: old_rates()}
    known = sorted({rate for protocol in args.protocol for rate in rates[protocol]})
    for baud in args.baud or ():
        if baud not in known:
            raise SpecError(f"--baud {baud}", allowed=", ".join(map(str, known)))
    robot = load_robot(args.robot)
    with line_of(args.port, robot, args.bus) as line, console.stage("scan") as progress:
        new = [baud for baud in args.baud or BAUD_RATES if baud in rates[2]]
        old = [baud for baud in args.baud or OLD_BAUDS if baud in rates[1]]
        found = scan(
            line,
            new if 2 in args.protocol else (),
            old_bauds=old if 1 in args.protocol else (),
            progress=progress,
        )
    wrong = mismatches(found, robot, bus_name(robot, args.bus)) if args.compare else []
    console.table(
        f"{len(found.servos)} servos at {found.port}",
        ["id", "bit/s", "protocol", "model", "firmware", "notes"],
        [
            [
                f"[red]{s.id}[/]" if s.clash else str(s.id),
                str(s.baud),
                f"{s.protocol}.0",
                s.model,
                "?" if s.firmware is None else str(s.firmware),
                "; ".join(s.notes),
            ]
            for s in found.servos
        ],
    )
    for baud in found.noisy:
        console.show(f"damaged bytes at {baud} bit/s from nobody in particular: check the cable")
    if found.echo:
        console.show("the adapter hears what it sends: it must be a half-duplex one for servos")
    for line_ in wrong:
        console.show(line_)
    if not found.servos:
        console.show("nobody answers: check power and cable")
    clash = any(servo.clash for servo in found.servos)
    console.result(
        {
            "port": found.port,
            "bauds": list(found.bauds),
            "servos": [{**asdict(servo), "model": servo.model} for servo in found.servos],
            "noisy_bauds": list(found.noisy),
            "echo": found.echo,
            "mismatches": wrong,
        }
    )
    return 3 if clash or wrong or found.noisy or not found.servos else 0
