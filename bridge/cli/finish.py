"""``pasdedeux finish``: the motion of any generator or file, made clean."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.options import add_motion_request, in_folder, motion_request
from robots.errors import SpecError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the motion and how far it may be changed."""
    parser.add_argument("motion", type=Path, help="any motion file")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("finished.npz"), help="file or folder"
    )
    parser.add_argument(
        "--rate", type=float, default=stages.FPS, metavar="HZ", help="of the result (default 30)"
    )
    parser.add_argument(
        "--smoothing",
        type=float,
        default=1.0,
        metavar="X",
        help="how much of the jitter is taken out: 1 what was measured, 0 nothing",
    )
    parser.add_argument(
        "--rotations",
        type=float,
        default=0.0,
        metavar="X",
        help="how far keypoints go to where the motion's own rotations put them: 0 not at all, 1"
        " all the way (default 0; what a network draws is finished with 0.9)",
    )
    parser.add_argument(
        "--touch",
        action="append",
        default=[],
        metavar="A:B",
        help="a point of a meets one of b, for example right_hand:left_shoulder; can be repeated",
    )
    for name, what in (
        ("feet", "put standing feet down and hold them"),
        ("hands", "bring hands together"),
        ("apart", "move people apart who overlap"),
    ):
        parser.add_argument(f"--no-{name}", action="store_true", help=f"do not {what}")
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Finish and say what was changed."""
    from generator.finishing import Finishing

    out = in_folder(args.out, "finished.npz")
    settings = Finishing(
        smoothing=args.smoothing,
        rotations=args.rotations,
        feet=not args.no_feet,
        hands=not args.no_hands,
        apart=not args.no_apart,
    )
    with console.stage("finish"):
        facts = stages.finish(
            args.motion,
            out,
            fps=args.rate,
            settings=settings,
            touches=[_pair(text) for text in args.touch],
            request=motion_request(args),
        )
    changes = facts["finishing"]
    console.show(
        f"{out}: {facts['frames']} frames at {facts['fps']:g} Hz; keypoints moved by"
        f" {100 * changes['moved']:.1f} cm on average, bones had changed by"
        f" {changes['bones']:.1%}, {changes['touches']} touches closed,"
        f" {changes['given_up']} given up"
    )
    console.result({"file": str(out), **facts})
    return 0


def _pair(text: str) -> tuple[str, str]:
    a, colon, b = text.partition(":")
    if not (a and colon and b):
        raise SpecError(f"'{text}'", where="--touch", allowed="A:B, such as right_hand:right_hand")
    return a.strip(), b.strip()
