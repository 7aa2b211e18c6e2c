"""``pasdedeux track``: two humanoids perform a motion in physics."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.options import (
    add_disturbance,
    add_motion_request,
    add_seed,
    add_tracking,
    in_folder,
    motion_request,
    track_settings,
)
from bridge.cli.tables import show_batch, show_outcome
from robots.errors import SpecError

BATCH_FOLDER = Path("out/track")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is tracked and how."""
    parser.add_argument(
        "motions",
        nargs="+",
        type=Path,
        metavar="MOTION",
        help="any motion file; of several, or of a folder of them, each gets a folder of its own",
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        help="folder, or rollout file for one motion"
        f" (default: {stages.ROLLOUT}, or {BATCH_FOLDER}/ for several)",
    )
    add_tracking(parser)
    add_seed(parser)
    parser.add_argument(
        "--least-assist",
        action="store_true",
        help="also find the least help with which nobody falls (tracks several times)",
    )
    parser.add_argument(
        "--self-collision", action="store_true", help="a person's limbs meet each other, too"
    )
    parser.add_argument(
        "--export",
        type=Path,
        metavar="FILE",
        help="write what was simulated as a motion, .npz or .bvh; in its folder for several",
    )
    parser.add_argument("--jobs", type=int, help="motions at once (default: one per core)")
    add_disturbance(parser)
    add_motion_request(parser)


def execute(args: argparse.Namespace, console: Console) -> int:
    """Track, and say how it went; 0 if nobody fell and every motion was finished."""
    from bridge.batch import is_single

    stages.require_export(args.export)
    if args.jobs is not None and args.jobs < 1:
        raise SpecError(f"{args.jobs} motions at once", allowed="1 or more")
    return _one(args, console) if is_single(args.motions) else _many(args, console)


def _one(args: argparse.Namespace, console: Console) -> int:
    out = in_folder(args.out or Path(stages.ROLLOUT), stages.ROLLOUT)
    with console.stage("track") as progress:
        outcome = stages.track(
            args.motions[0],
            out,
            request=motion_request(args),
            settings=track_settings(args),
            least_assist=args.least_assist,
            export=args.export,
            progress=progress,
        )
    show_outcome(console, outcome.to_json())
    console.show(f"files: {out}, {out.with_name(stages.TRACKING)}")
    console.result({"file": str(out), **outcome.to_json()})
    return 0 if outcome.success else 1


def _many(args: argparse.Namespace, console: Console) -> int:
    from bridge.batch import TABLE, BatchSettings, clips_of, track_clips

    out = args.out or BATCH_FOLDER
    if out.suffix:
        raise SpecError(f"'{out}' is one file for several motions", allowed="a folder")
    if args.export is not None and args.export.parent != Path():
        raise SpecError(
            f"'{args.export}' is one file for several motions",
            allowed="a name alone; it goes into the folder of each",
        )
    settings = BatchSettings(
        tracking=track_settings(args),
        request=motion_request(args),
        least_assist=args.least_assist,
        export=args.export,
    )
    clips = clips_of(args.motions, out)
    with console.stage("track") as progress:
        results = track_clips(clips, out, settings, jobs=args.jobs, progress=progress)
    lines: list[dict[str, Any]] = [result.to_json() for result in results]
    show_batch(console, lines)
    console.show(f"files: {out}/, {out / TABLE}")
    console.result({"folder": str(out), "clips": lines})
    return max(result.exit_code for result in results)
