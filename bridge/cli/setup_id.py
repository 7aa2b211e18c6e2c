"""``pasdedeux setup-id``: id and bit rate of the one servo on a bus; restores backups."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge.cli.asking import DECLINED, add_asking, add_robot, asker
from bridge.cli.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add where the servo is and what it becomes."""
    parser.add_argument(
        "--port", default="virtual", help="serial port with this one servo on it, or 'virtual'"
    )
    parser.add_argument("--id", type=int, metavar="N", help="new id, 0 to 252")
    parser.add_argument(
        "--joint", metavar="NAME", help="id and bit rate that --robot's file gives this joint"
    )
    parser.add_argument("--new-baud", type=int, metavar="B", help="new rate, bit/s")
    parser.add_argument(
        "--baud", type=int, nargs="+", metavar="B", help="look at these rates only (default: all)"
    )
    parser.add_argument(
        "--restore", type=Path, metavar="FILE", help="give the servo back what a backup kept"
    )
    add_robot(parser)
    add_asking(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Find the servo, show what would change, ask, write, and find it there again."""
    from bridge.servo.registers import BAUD_RATES
    from bridge.setup.backup import Backup
    from bridge.setup.line import line_of
    from bridge.setup.scan import scan
    from bridge.setup.set_id import only_servo, restore_servo, set_id
    from robots.errors import SpecError
    from robots.registry import load_robot

    robot = load_robot(args.robot)
    servo_id, baud = args.id, args.new_baud
    ways = [args.restore is not None, args.joint is not None, not (servo_id is baud is None)]
    if sum(ways) != 1:
        raise SpecError(
            "what should it become?", allowed="--id and --new-baud, or --joint, or --restore"
        )
    if args.joint is not None:
        servo = robot.joint(args.joint).servo
        servo_id, baud = servo.id, robot.buses[servo.bus].baud
    backup = None if args.restore is None else Backup.load(args.restore)
    ask = asker(args, console)
    with line_of(args.port, robot, args.bus) as line:
        with console.stage("scan") as progress:
            found = only_servo(scan(line, args.baud or BAUD_RATES, progress=progress))
        console.say(f"found id {found.id} at {found.baud} bit/s: {found.model}")
        if backup is not None:
            changed = restore_servo(line, found, backup, ask, folder=args.backups)
        else:
            changed = set_id(line, found, ask, servo_id=servo_id, baud=baud, folder=args.backups)
    if changed is None:
        console.say("nothing was written")
    elif not changed:
        console.show("it is so already; nothing was written")
    else:
        for name, (before, after) in changed.items():
            console.show(f"{name}: {before} -> {after}, verified")
    console.result(
        {
            "found": {"id": found.id, "baud": found.baud, "model": found.model},
            "changed": {n: list(pair) for n, pair in (changed or {}).items()},
            "declined": changed is None,
        }
    )
    return DECLINED if changed is None else 0
