"""Time the two halves of a report: collision frames per second, and whole reports per duet-second.

Usage: ``python benchmarks/score.py [MOTION]``; without a file, a choreographed waltz.
"""

from __future__ import annotations

import sys
import time

from generator.choreographer import choreograph
from generator.io import read_motion
from sim.metrics.penetration import overlap
from sim.score import score, score_motion
from sim.track import track


def main() -> None:
    """Print the three figures."""
    motion = read_motion(sys.argv[1]) if len(sys.argv) > 1 else choreograph("waltz", seed=0)
    rollout = track(motion)
    scene = rollout.scene()
    start = time.process_time()
    overlap(scene, rollout.qpos)
    frames = len(rollout.qpos) / (time.process_time() - start)
    start = time.process_time()
    tracked = score(rollout)
    of_rollout = (time.process_time() - start) / motion.duration
    start = time.process_time()
    bare = score_motion(motion)
    of_motion = (time.process_time() - start) / motion.duration
    print(f"collision: {frames:,.0f} duet frames per CPU-second")
    print(f"score: {of_rollout:.3f} CPU-seconds per duet-second, {tracked.score:.1f}/100")
    print(f"score_motion: {of_motion:.3f} CPU-seconds per duet-second, {bare.score:.1f}/100")


if __name__ == "__main__":
    main()
