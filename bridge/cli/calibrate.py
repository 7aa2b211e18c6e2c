"""``pasdedeux calibrate``: zero and reach of each joint of one unit, measured by hand."""

from __future__ import annotations

import argparse
import math
import select
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.cli.asking import DECLINED, add_asking, asker, ports_by_bus
from bridge.cli.console import Console
from bridge.cli.options import DEFAULT_ROBOT, add_unit_ports

if TYPE_CHECKING:
    from bridge.setup.calibration import Calibration
    from robots.spec import RobotSpec


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which unit, and what is done with its file."""
    parser.add_argument("file", type=Path, help="calibration of this unit, JSON")
    parser.add_argument(
        "--robot", default=DEFAULT_ROBOT, metavar="NAME", help="its design (default op3)"
    )
    add_unit_ports(parser)
    parser.add_argument("--unit", metavar="NAME", help="name of the unit (default: the file's)")
    parser.add_argument(
        "--joint", nargs="+", default=[], metavar="NAME", help="these joints only; keeps the others"
    )
    parser.add_argument(
        "--home",
        choices=("zero", "rest"),
        default="zero",
        help="pose in which it is homed: all joints at 0 (default), or its rest pose",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help="length of the sweep, instead of waiting for Enter",
    )
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--verify", action="store_true", help="compare the robot with the file")
    way.add_argument(
        "--from-lerobot", type=Path, metavar="JSON", help="make the file from lerobot's"
    )
    way.add_argument("--to-lerobot", type=Path, metavar="JSON", help="make lerobot's from the file")
    add_asking(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Measure, verify or convert; 1 if a verified robot deviates."""
    from bridge.setup.calibration import Calibration, from_lerobot, to_lerobot
    from robots.files import plain, write_json
    from robots.registry import load_robot

    robot = load_robot(args.robot)
    unit = args.unit or args.file.stem
    if args.to_lerobot is not None:
        write_json(args.to_lerobot, to_lerobot(Calibration.load(args.file)))
        console.show(str(args.to_lerobot))
        console.result({"file": str(args.to_lerobot)})
        return 0
    if args.from_lerobot is not None:
        found = from_lerobot(args.from_lerobot, robot, unit=unit, home=args.home)
        found.apply(robot)
    elif args.verify:
        return _verify(args, console, robot)
    else:
        measured = _measure(args, console, robot, unit)
        if measured is None:
            console.say("nothing was measured or written")
            return DECLINED
        found = measured
    found.save(args.file)
    _show(found, robot, console)
    console.show(str(args.file))
    console.result({"file": str(args.file), **plain(found)})
    return 0


def _measure(
    args: argparse.Namespace, console: Console, robot: RobotSpec, unit: str
) -> Calibration | None:
    from bridge.servo.clock import MonotonicClock
    from bridge.setup.calibrate import limp_robot, measured
    from bridge.setup.calibration import Calibration

    before = Calibration.load(args.file) if args.joint and args.file.exists() else None
    ask = asker(args, console)
    if not ask(f"{robot.name} goes limp: hold it, or have it in its stand. Go on?"):
        return None
    ports = ports_by_bus(args.port, robot)
    with limp_robot(robot, ports, MonotonicClock(), joints=args.joint) as limp:
        limp.make_plain(ask, args.backups)
        console.say("move every joint through its whole reach, by hand, end stop to end stop;")
        console.say("then press Enter" if args.seconds is None else f"{args.seconds:g} s from now")
        sweep = limp.sweep(_done(args.seconds))
        pose = "every joint at 0" if args.home == "zero" else "the rest pose"
        if not ask(f"put it into {pose} (pasdedeux robots {robot.name} lists it). Is it there?"):
            return None
        found = measured(limp, sweep, limp.pose(), unit=unit, home=args.home)
    if before is not None:
        found = Calibration(found.robot, before.unit, {**before.joints, **found.joints})
    found.apply(robot)  # says now what play would say later
    return found


def _done(seconds: float | None) -> Callable[[], bool]:
    """Return what tells whether the sweep is over: after a time, or when Enter was pressed."""
    if seconds is not None:
        end = time.monotonic() + seconds
        return lambda: time.monotonic() >= end

    def pressed() -> bool:
        ready, _, _ = select.select([sys.stdin], [], [], 0)
        return bool(ready) and sys.stdin.readline() is not None

    return pressed


def _show(found: Calibration, robot: RobotSpec, console: Console) -> None:
    fitted = found.apply(robot)
    console.table(
        f"{found.unit} ({found.robot})",
        ["joint", "id", "zero", "reach", "lower °", "upper °"],
        [
            [
                name,
                str(joint.id),
                str(joint.zero),
                f"{joint.range_min} to {joint.range_max}",
                f"{math.degrees(fitted.joint(name).lower):.0f}",
                f"{math.degrees(fitted.joint(name).upper):.0f}",
            ]
            for name, joint in found.joints.items()
        ],
    )


def _verify(args: argparse.Namespace, console: Console, robot: RobotSpec) -> int:
    from bridge.servo.clock import MonotonicClock
    from bridge.setup.calibrate import limp_robot, verify
    from bridge.setup.calibration import Calibration

    kept = Calibration.load(args.file)
    ask = asker(args, console)
    pose = "every joint at 0" if args.home == "zero" else "the rest pose"
    with ExitStack() as stack:
        if not ask(f"{robot.name} goes limp: hold it, or have it in its stand. Go on?"):
            return DECLINED
        limp = stack.enter_context(
            limp_robot(robot, ports_by_bus(args.port, robot), MonotonicClock(), joints=args.joint)
        )
        if not ask(f"put it into {pose}. Is it there?"):
            return DECLINED
        deviations = verify(limp, kept, home=args.home)
    console.table(
        f"{kept.unit} against {args.file}",
        ["joint", "off °", "wrong"],
        [[d.joint, f"{math.degrees(d.off):+.1f}", "; ".join(d.problems)] for d in deviations],
    )
    wrong = sum(bool(d.problems) for d in deviations)
    console.show(f"{wrong} of {len(deviations)} joints deviate" if wrong else "as calibrated")
    console.result(
        {
            "passed": not wrong,
            "joints": [
                {
                    "joint": d.joint,
                    "off_deg": round(math.degrees(d.off), 3) if math.isfinite(d.off) else None,
                    "problems": list(d.problems),
                }
                for d in deviations
            ],
        }
    )
    return 1 if wrong else 0
