"""Time the tracker: CPU seconds per second of duet, and how well it does.

Usage: ``python -m benchmarks.track [--controller NAME] [MOTION ...]``; without files, one
choreographed duet per kind.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Iterator

import numpy as np

from generator.choreographer import choreograph, repertoire
from generator.io import read_motion
from generator.motion import DuetMotion
from sim.metrics.effort import force_share
from sim.track import CONTROLLERS, TrackSettings, track


def motions(paths: list[str]) -> Iterator[tuple[str, DuetMotion]]:
    """Yield names and motions: the given files, or the choreographer's repertoire."""
    if paths:
        for path in paths:
            yield path.rsplit("/", 1)[-1], read_motion(path)
    else:
        for name in repertoire():
            yield name, choreograph(name, seed=0)


def main() -> None:
    """Print one line per motion and the median at the end."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.track")
    parser.add_argument("motions", nargs="*")
    parser.add_argument("--controller", choices=tuple(CONTROLLERS), default="ilqr")
    args = parser.parse_args()
    settings = TrackSettings(controller=args.controller)
    ratios, errors = [], []
    print("motion                      duration   mpjpe  assist  fell  cpu-s per s")
    for name, motion in motions(args.motions):
        start = time.process_time()
        rollout = track(motion, settings=settings)
        ratio = (time.process_time() - start) / motion.duration
        error = float(rollout.error.mean()) * 1000
        help_ = float(np.mean(force_share(rollout.assist, rollout.bodies))) * 100
        fell = "yes" if any(rollout.fell.values()) else "no"
        print(
            f"{name[:26]:26s} {motion.duration:7.1f} s {error:4.0f} mm {help_:5.1f} %"
            f"  {fell:>4s}  {ratio:.2f}"
        )
        ratios.append(ratio)
        errors.append(error)
    print(
        f"median: {statistics.median(ratios):.2f} CPU-seconds per duet-second,"
        f" mpjpe {statistics.median(errors):.0f} mm"
    )


if __name__ == "__main__":
    main()
