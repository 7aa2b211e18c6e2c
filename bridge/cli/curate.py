"""``pasdedeux curate``: physics repairs or rejects the clips that a model is to learn from."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from bridge.cli.console import Console
from bridge.cli.options import QUALITIES
from robots.errors import SpecError

if TYPE_CHECKING:
    from generator.data import Curation
    from generator.training.config import RunConfig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add whose clips are judged, and how."""
    parser.add_argument(
        "config", type=Path, help="training configuration; its choreographed clips are judged"
    )
    parser.add_argument(
        "-o",
        "--out",
        type=Path,
        help="folder for verdicts and motions (default: the one that the configuration reads from)",
    )
    parser.add_argument(
        "--limit",
        type=int,
        metavar="N",
        help="only the first N clips, which are spread over the interactions",
    )
    parser.add_argument(
        "--quality",
        choices=QUALITIES,
        default=QUALITIES[0],
        help="how thoroughly the people plan (default preview)",
    )
    parser.add_argument("--jobs", type=int, help="clips at once (default: one per core)")


def execute(args: argparse.Namespace, console: Console) -> int:
    """Judge what has no verdict yet, and say how it went; 1 if a clip still has none."""
    from generator.training.config import load_config
    from sim.controllers.ilqr.settings import QUALITIES as PLANNING
    from sim.curation import CurationSettings, curate, in_order, summary
    from sim.track import TrackSettings

    for name in ("jobs", "limit"):
        value = getattr(args, name)
        if value is not None and value < 1:
            raise SpecError(f"{value}", where=f"--{name}", allowed="1 or more")
    curations = _curations(load_config(args.config), args.out, args.config)
    ilqr = replace(PLANNING[args.quality], threads=1)  # every core has a clip
    settings = CurationSettings(tracking=TrackSettings(ilqr=ilqr))
    items = in_order(curations)[: args.limit]
    with console.stage("curate") as progress:
        results = curate(items, settings, jobs=args.jobs, progress=progress)
    facts = summary(results)
    _show(console, facts)
    folder = curations[0].root
    console.show(f"files: {folder}/")
    console.result({"folder": str(folder), **facts})
    return 1 if facts["lost"] else 0


def _curations(run: RunConfig, out: Path | None, config: Path) -> list[Curation]:
    """Return the choreographed sources of a configuration, with the folder of their verdicts."""
    from generator.data import Curation
    from generator.data.choreographed import Split

    sources = [source for source in run.data.source if source.kind == "choreographed"]
    if not sources:
        raise SpecError("there is no choreographed source", where=str(config))
    folders = {source.repaired for source in sources} if out is None else {str(out)}
    if len(folders) > 1 or "" in folders:
        raise SpecError(
            "does not name one folder of verdicts", where=str(config), hint="name it with -o"
        )
    root = Path(folders.pop())
    return [Curation(root, cast(Split, s.split), s.seed, s.count) for s in sources]


def _show(console: Console, facts: dict[str, Any]) -> None:
    """Print a line for each interaction, what was changed, and why clips were rejected."""
    from sim.curation import FIGURES

    rows = [
        [
            name,
            str(of["kept"]),
            str(of["rejected"]),
            "" if of["changed_mm"] is None else f"{of['changed_mm']:.0f} mm",
            f"{of['cpu_s_per_clip']:.1f}",
        ]
        for name, of in facts["interactions"].items()
    ]
    total = facts["kept"] + facts["rejected"]
    title = f"{facts['kept']} of {total} clips kept"
    console.table(title, ["", "kept", "rejected", "changed", "CPU-s"], rows)
    if facts["kept"]:
        before, after = facts["figures"]["reference"], facts["figures"]["simulated"]
        lines = [
            [name, *(f"{figures[name]:.3g} {unit}" for figures in (before, after))]
            for name, unit in FIGURES.items()
        ]
        console.table("means over kept clips", ["", "invented", "repaired"], lines)
    for reason, count in facts["reasons"].items():
        console.show(f"rejected for {reason}: {count}")
    for lost in facts["lost"]:
        console.show(f"no verdict: {lost['clip']}: {lost['why']}")
