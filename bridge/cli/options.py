"""Options that several verbs share."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge.stages import GENERATORS, MotionRequest

DEFAULT_ROBOT = "op3"


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add ``--seed``."""
    parser.add_argument(
        "--seed", type=int, default=0, help="same seed, same machine: same output (default 0)"
    )


def add_generator(parser: argparse.ArgumentParser) -> None:
    """Add what ``generate`` and ``run`` share."""
    parser.add_argument("--generator", choices=GENERATORS, default=GENERATORS[0])
    parser.add_argument(
        "--nearest",
        action="store_true",
        help="for a sentence outside the repertoire, take the nearest interaction",
    )


def add_motion_request(parser: argparse.ArgumentParser) -> None:
    """Add what a motion file may leave unsaid."""
    group = parser.add_argument_group("what a motion file may leave unsaid")
    group.add_argument("--fps", type=float, help="frames per second")
    group.add_argument("--up", choices=("y", "z"), help="axis that points up")
    group.add_argument("--scale", type=float, help="metres per unit, for example 0.01")


def motion_request(args: argparse.Namespace) -> MotionRequest:
    """Return what :func:`add_motion_request` parsed."""
    return MotionRequest(fps=args.fps, up=args.up, scale=args.scale)


def add_robots(parser: argparse.ArgumentParser) -> None:
    """Add which robot plays whom."""
    parser.add_argument(
        "--robot",
        default=DEFAULT_ROBOT,
        metavar="NAME",
        help="robot for both: a name from 'pasdedeux robots' or a folder (default op3)",
    )
    parser.add_argument("--robot-a", metavar="NAME", help="another robot for person a")
    parser.add_argument("--robot-b", metavar="NAME", help="another robot for person b")


def robot_pair(args: argparse.Namespace) -> tuple[str, str]:
    """Return the names that :func:`add_robots` parsed."""
    return args.robot_a or args.robot, args.robot_b or args.robot


def add_assist(parser: argparse.ArgumentParser) -> None:
    """Add which controller tracks."""
    parser.add_argument("--controller", choices=("assist",), default="assist")
    parser.add_argument(
        "--assist",
        type=float,
        metavar="BODYWEIGHTS",
        help="bound of the helping force at the pelvis, in body weights",
    )


def in_folder(out: Path, name: str) -> Path:
    """Return ``out`` if it names a file, else ``out/name``."""
    return out if out.suffix else out / name
