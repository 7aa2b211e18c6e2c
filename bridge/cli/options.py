"""Options that several verbs share."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.sources import MotionRequest
from bridge.stages import CONTROLLERS, PLANTS
from robots.errors import SpecError

if TYPE_CHECKING:
    from sim.track import TrackSettings

DEFAULT_ROBOT = "op3"
QUALITIES = ("preview", "normal", "high")
"""What ``--quality`` may say: the keys of ``sim.controllers.ilqr.settings.QUALITIES``."""


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add ``--seed``."""
    parser.add_argument(
        "--seed", type=int, default=0, help="same seed, same machine: same output (default 0)"
    )


def add_unit_ports(parser: argparse.ArgumentParser) -> None:
    """Add where the buses of one robot are."""
    parser.add_argument(
        "--port",
        nargs="+",
        default=["virtual"],
        metavar="PORT",
        help="serial port, BUS=PORT for each of several buses, or 'virtual' (default)",
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


def add_tracking(parser: argparse.ArgumentParser) -> None:
    """Add who moves the joints of the simulated people, and how well."""
    parser.add_argument(
        "--controller",
        choices=CONTROLLERS,
        help="plan ahead and balance (ilqr, the default), sample plans (mppi), or springs and a"
        " helping hand at the pelvis (assist: in real time)",
    )
    parser.add_argument(
        "--quality",
        choices=QUALITIES,
        help="how thoroughly ilqr plans (default normal)",
    )
    parser.add_argument(
        "--assist",
        type=float,
        metavar="BODYWEIGHTS",
        help="bound of the helping force at the pelvis, in body weights",
    )


def add_disturbance(parser: argparse.ArgumentParser) -> None:
    """Add what goes otherwise in the simulation than the controller believes."""
    group = parser.add_argument_group("what the controller does not know of")
    group.add_argument(
        "--push",
        action="append",
        default=[],
        metavar="'WHO X Y Z at S for S [on BODY]'",
        help="force in N, for example 'a 100 0 0 at 1.0 for 0.2'; can be repeated",
    )
    group.add_argument(
        "--payload",
        action="append",
        default=[],
        metavar="'WHO BODY KG'",
        help="a weight, for example 'a right_wrist 2'; can be repeated",
    )
    group.add_argument("--friction", type=float, help="of the floor and the people")
    group.add_argument("--latency", type=float, default=0.0, metavar="S", help="of every joint")
    group.add_argument(
        "--mass-error",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="how much heavier the people are, 0.1 for a tenth",
    )


def track_settings(args: argparse.Namespace) -> TrackSettings:
    """Return what :func:`add_tracking` parsed, and :func:`add_disturbance` if that was added.

    Raises:
        SpecError: A value makes no sense.
    """
    from sim.controllers.ilqr.settings import QUALITIES as PLANNING
    from sim.disturbance import Disturbance, parse_payload, parse_push
    from sim.scene import AssistLimits
    from sim.track import TrackSettings

    disturbance = Disturbance()
    if hasattr(args, "push"):
        disturbance = Disturbance(
            pushes=tuple(parse_push(text) for text in args.push),
            payloads=tuple(parse_payload(text) for text in args.payload),
            friction=args.friction,
            latency=args.latency,
            mass_error=args.mass_error,
        )
    assist = None
    if args.assist is not None:
        share = AssistLimits().max_torque / AssistLimits().max_force
        assist = AssistLimits(max_force=args.assist, max_torque=share * args.assist)
    controller = args.controller or TrackSettings().controller
    if args.quality is not None and controller != "ilqr":
        raise SpecError(
            f"--quality {args.quality} with --controller {controller}",
            allowed="--quality with --controller ilqr, which plans",
        )
    return TrackSettings(
        controller=controller,
        ilqr=PLANNING[args.quality or "normal"],
        assist=assist,
        self_collision=getattr(args, "self_collision", False),
        disturbance=disturbance,
        seed=args.seed,
    )


def add_plant(parser: argparse.ArgumentParser) -> None:
    """Add what moves behind virtual ports."""
    parser.add_argument(
        "--plant",
        choices=PLANTS,
        default=PLANTS[0],
        help="what virtual servos move: nothing but themselves (servo, the default), the robot's"
        " own model, hung up (mujoco), or their horns without delay (instant)",
    )


def in_folder(out: Path, name: str) -> Path:
    """Return ``out`` if it names a file, else ``out/name``."""
    return out if out.suffix else out / name
