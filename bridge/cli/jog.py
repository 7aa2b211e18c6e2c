"""``pasdedeux jog``: one joint, small steps, only while a key is held."""

from __future__ import annotations

import argparse
import math
import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from bridge.cli.asking import add_asking, asker, ports_by_bus, require_armed
from bridge.cli.console import Console
from bridge.cli.options import DEFAULT_ROBOT, add_unit_ports
from robots.errors import SpecError

UP_KEYS, DOWN_KEYS = ("+", "=", "k", "\x1b[A", "\x1b[C"), ("-", "_", "j", "\x1b[B", "\x1b[D")
QUIT_KEYS = ("q", "\x1b", "\x03", "\x04", "")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which joint and how far a key moves it."""
    parser.add_argument("joint", help="name of the joint")
    parser.add_argument(
        "--robot", default=DEFAULT_ROBOT, metavar="NAME", help="whose joint (default op3)"
    )
    add_unit_ports(parser)
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="of this unit")
    parser.add_argument("--arm", action="store_true", help="allow a real servo to move")
    parser.add_argument("--step", type=float, default=2.0, metavar="DEG", help="per key (2)")
    parser.add_argument(
        "--speed", type=float, default=30.0, metavar="DEG/S", help="at most (30 degrees a second)"
    )
    add_asking(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Move it until ``q``; keys may also come from a pipe, one character each."""
    from bridge.ports import connect, ports_of
    from bridge.servo.clock import MonotonicClock
    from bridge.setup.calibration import Calibration
    from bridge.setup.jog import JogSettings, jog
    from robots.registry import load_robot

    robot = load_robot(args.robot)
    if args.calibration is not None:
        robot = Calibration.load(args.calibration).apply(robot)
    joint = robot.joint(args.joint)
    if not (math.isfinite(args.step) and math.isfinite(args.speed)):
        raise SpecError("--step and --speed must be numbers")
    settings = JogSettings(step=math.radians(args.step), speed=math.radians(args.speed))
    ports = ports_by_bus(args.port, robot)
    require_armed(ports, arm=args.arm)
    port = ports_of(robot, ports)[joint.servo.bus]
    clock = MonotonicClock()
    with ExitStack() as stack:
        transport = connect(robot, joint.servo.bus, port, clock, stack)
        console.say(
            f"{joint.name}: {math.degrees(joint.lower):.0f} to {math.degrees(joint.upper):.0f}"
            " degrees; arrows or + and - move it while held, q ends (the joint goes limp)"
        )
        # Asked before the terminal is put into its raw mode, where lines do not end.
        ask = asker(args, console)
        jogged = jog(
            joint,
            transport,
            _late(stack),
            clock,
            ask,
            settings=settings,
            folder=args.backups,
            show=_shower(),
        )
    sys.stderr.write("\n" if sys.stderr.isatty() else "")
    start, end = math.degrees(jogged.start), math.degrees(jogged.end)
    console.show(f"{joint.name}: {start:.1f} -> {end:.1f} degrees, {jogged.keys} steps; limp now")
    console.result(
        {
            "joint": joint.name,
            "start_deg": round(start, 3),
            "end_deg": round(end, 3),
            "lowest_deg": round(math.degrees(jogged.lowest), 3),
            "highest_deg": round(math.degrees(jogged.highest), 3),
            "steps": jogged.keys,
        }
    )
    return 0


def _late(stack: ExitStack) -> Callable[[], str | None]:
    """Return what gives keys; the terminal is changed when it is called for the first time."""
    reader: list[Callable[[], str | None]] = []

    def read() -> str | None:
        if not reader:
            reader.append(stack.enter_context(_keys()))
        return reader[0]()

    return read


@contextmanager
def _keys() -> Iterator[Callable[[], str | None]]:
    """Yield what gives the next key that was pressed, as :mod:`bridge.setup.jog` names them."""
    try:
        import termios
        import tty
    except ImportError as error:
        raise SpecError("this system has no terminals that give single keys") from error
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd) if os.isatty(fd) else None
    if before is not None:
        tty.setcbreak(fd)
    try:
        yield lambda: _next_key(fd, whole=before is not None)
    finally:
        if before is not None:
            termios.tcsetattr(fd, termios.TCSADRAIN, before)


def _next_key(fd: int, *, whole: bool) -> str | None:
    from bridge.setup.jog import DOWN, QUIT, UP

    ready, _, _ = select.select([fd], [], [], 0)
    if not ready:
        return None
    # A terminal hands over an arrow as three bytes at once, and held keys as a run of them: the
    # last is what counts. A pipe is read key by key.
    text = os.read(fd, 3 if whole else 1).decode("latin-1")
    if text in QUIT_KEYS:
        return QUIT
    if text in UP_KEYS or text[-1] in UP_KEYS:
        return UP
    if text in DOWN_KEYS or text[-1] in DOWN_KEYS:
        return DOWN
    return QUIT if text[-1] in QUIT_KEYS else None


def _shower() -> Callable[[float, float], None]:
    """Return what shows position and goal in place, on a terminal."""
    if not sys.stderr.isatty():
        return lambda position, goal: None
    return lambda position, goal: print(
        f"\r{math.degrees(position):8.1f}°  ({math.degrees(goal):.1f}°)   ",
        end="",
        file=sys.stderr,
        flush=True,
    )
