"""Questions that a command asks before it goes on, and options of the commands that ask."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.cli.console import Console
from bridge.cli.options import DEFAULT_ROBOT
from robots.errors import GateRefused, SpecError

if TYPE_CHECKING:
    from bridge.ports import Ports
    from robots.spec import RobotSpec

DECLINED = 130
"""Exit status if the user said no: stopped safely."""


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add whose servos are meant and which of the buses."""
    parser.add_argument(
        "--robot", default=DEFAULT_ROBOT, metavar="NAME", help="whose servos (default op3)"
    )
    parser.add_argument("--bus", metavar="NAME", help="which bus of the robot, if it has several")


def add_asking(parser: argparse.ArgumentParser) -> None:
    """Add what is not asked and where backups go."""
    from bridge.setup.backup import FOLDER

    parser.add_argument("--yes", action="store_true", help="take every question as answered yes")
    parser.add_argument(
        "--backups",
        type=Path,
        default=FOLDER,
        metavar="DIR",
        help=f"folder for what servos held before a change (default {FOLDER})",
    )


def asker(args: argparse.Namespace, console: Console) -> Callable[[str], bool]:
    """Return what asks the user: shows a text, takes ``y`` for yes and anything else for no."""

    def ask(text: str) -> bool:
        console.say(f"{text}{'' if args.yes else ' [y/N]'}")
        return args.yes or sys.stdin.readline().strip().lower() in ("y", "yes")

    return ask


def ports_by_bus(words: list[str], robot: RobotSpec) -> Ports:
    """Return what ``--port`` named: one port for all, or ``bus=port`` for each.

    Raises:
        SpecError: A bus is named twice, or only some ports have a bus's name.
    """
    if len(words) == 1 and "=" not in words[0]:
        return words[0]
    pairs = [word.partition("=")[::2] for word in words]
    named = {bus: port for bus, port in pairs if port}
    if len(named) != len(words):
        raise SpecError(
            f"--port {' '.join(words)}",
            where=robot.name,
            allowed=" ".join(f"{bus}=PORT" for bus in robot.buses),
        )
    return named


def require_armed(ports: Ports, *, arm: bool) -> None:
    """Refuse to move real servos that were not armed.

    Raises:
        GateRefused: A port is real and ``arm`` is not set.
    """
    from bridge.ports import VIRTUAL

    names = [ports] if isinstance(ports, str) else list(ports.values())
    real = [name for name in names if name != VIRTUAL]
    if real and not arm:
        raise GateRefused(
            f"{', '.join(real)} would move real servos",
            hint="read SAFETY.md, clear the stage, then allow it with --arm",
        )
