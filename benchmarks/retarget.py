"""How well and how fast duets are retargeted, for every interaction and pair of robots.

Run ``python benchmarks/retarget.py [FILE ...]`` from a checkout: without files it retargets the
choreographer's interactions, otherwise the given motion files. One line of JSON per duet.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from bridge.retarget import retarget
from generator.choreographer import choreograph, repertoire
from generator.io import read_motion
from generator.motion import DuetMotion
from robots.registry import load_robot

PAIRS = ("op3+op3", "marionette+marionette", "op3+marionette")


def main() -> None:
    """Print a line per duet and pair."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--pairs", nargs="+", default=PAIRS, metavar="A+B")
    args = parser.parse_args()
    for name, motion in duets(args.files):
        for pair in args.pairs:
            a, b = pair.split("+")
            robots = (load_robot(a), load_robot(b))
            start = time.perf_counter()
            result = retarget(motion, robots)
            seconds = time.perf_counter() - start
            figures = {"duet_fps": round(motion.frames / seconds), **result.report.to_json()}
            sys.stdout.write(json.dumps({"duet": name, "robots": pair, **figures}) + "\n")
            sys.stdout.flush()


def duets(files: list[Path]) -> Iterator[tuple[str, DuetMotion]]:
    """Yield names and motions."""
    if files:
        for file in files:
            yield file.stem, read_motion(file)
    else:
        for name in repertoire():
            yield name, choreograph(name, seed=0)


if __name__ == "__main__":
    main()
