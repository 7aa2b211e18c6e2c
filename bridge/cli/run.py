"""``pasdedeux run``: a sentence or a motion file to two performing puppets."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.generator_options import (
    add_generator,
    diffusion_request,
    intergen_request,
    style_request,
)
from bridge.cli.options import (
    add_motion_request,
    add_plant,
    add_robots,
    add_seed,
    add_tracking,
    motion_request,
    robot_pair,
    track_settings,
)
from bridge.cli.tables import show_summary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add everything that the stages take."""
    parser.add_argument("source", help="a sentence, or a motion file")
    parser.add_argument("-o", "--out", type=Path, help="folder (default: out/ and the sentence)")
    add_seed(parser)
    add_generator(parser)
    add_tracking(parser)
    add_robots(parser)
    parser.add_argument(
        "--speed", type=float, default=1.0, help="of the performance on the virtual servos"
    )
    add_plant(parser)
    parser.add_argument("--force", action="store_true", help="perform even what the report refuses")
    parser.add_argument("--no-video", action="store_true", help="leave video and picture out")
    parser.add_argument(
        "--show",
        choices=stages.SHOWN,
        default=stages.SHOWN[0],
        help="what the puppets in the video do: what was planned (default), or what the servos"
        " did, from the telemetry",
    )
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Run every stage; 0 if all went well, 1 if the gate refused, 130 if stopped."""
    from bridge.run import RunSettings, run

    settings = RunSettings(
        source=args.source,
        out=args.out or stages.default_folder(args.source),
        seed=args.seed,
        generator=args.generator,
        intergen=intergen_request(args),
        diffusion=diffusion_request(args),
        nearest=args.nearest,
        style=style_request(args),
        raw=args.raw,
        tracking=track_settings(args),
        robots=robot_pair(args),
        speed=args.speed,
        plant=args.plant,
        force=args.force,
        video=not args.no_video,
        shown=args.show,
        request=motion_request(args),
    )
    result = run(settings, stage=console.stage, say=console.say)
    show_summary(console, result.summary)
    console.show(f"files: {settings.out}/")
    console.result(result.summary)
    return result.exit_code
