"""Options that several verbs share."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bridge.sources import MotionRequest
from bridge.stages import CONTROLLERS, GENERATORS, PLANTS
from robots.errors import SpecError

if TYPE_CHECKING:
    from generator.intergen import IntergenRequest
    from generator.runtime.generation import DiffusionRequest
    from sim.track import TrackSettings

DEFAULT_ROBOT = "op3"
QUALITIES = ("preview", "normal", "high")
"""What ``--quality`` may say: the keys of ``sim.controllers.ilqr.settings.QUALITIES``."""


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add ``--seed``."""
    parser.add_argument(
        "--seed", type=int, default=0, help="same seed, same machine: same output (default 0)"
    )


def add_generator(parser: argparse.ArgumentParser) -> None:
    """Add what ``generate`` and ``run`` share."""
    parser.add_argument(
        "--generator",
        choices=GENERATORS,
        default=GENERATORS[0],
        help="who turns the sentence into motion: composed movements (choreographer, default), a"
        " diffusion model without torch (diffusion), or with it (intergen)",
    )
    parser.add_argument(
        "--nearest",
        action="store_true",
        help="for a sentence outside the repertoire, take the nearest interaction",
    )


def add_intergen(parser: argparse.ArgumentParser) -> None:
    """Add what ``--generator diffusion`` and ``--generator intergen`` take."""
    group = parser.add_argument_group("for --generator diffusion and --generator intergen")
    group.add_argument(
        "--weights", default="", metavar="DIR", help="a model; for intergen also a .ckpt file"
    )
    length = group.add_mutually_exclusive_group()
    length.add_argument("--frames", type=int, help="length in frames")
    length.add_argument("--seconds", type=float, help="length in seconds")
    group.add_argument(
        "--steps", type=int, help="sampling steps (default: the model's own; 50 for intergen)"
    )
    group.add_argument(
        "--guidance", type=float, help="weight of the text (the model's own; 3.5 for intergen)"
    )
    group.add_argument(
        "--threads", type=int, help="of the processor (default: one; for intergen all but one)"
    )
    group = parser.add_argument_group("for --generator intergen")
    group.add_argument("--solver", choices=("auto", "ddim", "dpm2m"), default="auto")
    group.add_argument("--precision", choices=("float32", "fast", "bfloat16"), default="fast")
    group.add_argument("--given", default="", metavar="FILE", help="keep one person of this motion")
    group.add_argument("--given-person", choices=("a", "b"), default="a", help="which (default a)")
    for person in ("a", "b"):
        group.add_argument(
            f"--path-{person}",
            default="",
            metavar="CSV",
            help=f"where {person} goes: lines of time s, x m, y m; or a motion file",
        )
    for edge, verb in (("start", "begins"), ("end", "ends")):
        group.add_argument(
            f"--{edge}",
            default="",
            metavar="FILE[@S:S]",
            help=f"the motion {verb} with this one, or with a part of it (seconds)",
        )
    group.add_argument(
        "--then",
        action="append",
        default=[],
        metavar="TEXT",
        help="one more round between start and end, from the motion so far; can be repeated",
    )
    group.add_argument(
        "--strength", type=float, default=0.7, help="how much a round changes, 0 to 1 (0.7)"
    )


_INTERGEN = (
    "weights", "frames", "seconds", "solver", "precision", "given", "given_person", "path_a",
    "path_b", "start", "end", "strength",
)  # fmt: skip
_OWN = ("steps", "guidance")
"""Settings of which a model has its own."""
_GIVEN = ("given", "path_a", "path_b", "start", "end", "then")


def intergen_request(args: argparse.Namespace) -> IntergenRequest | None:
    """Return what :func:`add_intergen` parsed; ``None`` for another generator.

    Raises:
        SpecError: Settings exclude each other, or are out of range.
    """
    if args.generator != "intergen":
        return None
    from generator.intergen import IntergenRequest

    values = {name: getattr(args, name) for name in _INTERGEN}
    values |= {name: value for name in _OWN if (value := getattr(args, name)) is not None}
    return IntergenRequest(**values, threads=args.threads, then=tuple(args.then))


def diffusion_request(args: argparse.Namespace) -> DiffusionRequest | None:
    """Return what :func:`add_intergen` parsed for a model without torch; ``None`` for another.

    Raises:
        SpecError: Settings exclude each other, are out of range, or need torch.
    """
    if args.generator != "diffusion":
        return None
    for name in _GIVEN:
        if getattr(args, name):
            raise SpecError(
                "--generator diffusion takes nothing that is given of the motion",
                where=f"--{name.replace('_', '-')}",
                allowed="--generator intergen",
            )
    from generator.runtime.generation import DiffusionRequest

    names = ("weights", "frames", "seconds", "threads", *_OWN)
    return DiffusionRequest(**{name: getattr(args, name) for name in names})


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
