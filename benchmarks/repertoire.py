"""How many draws of each interaction the choreographer throws away, and why.

``python -m benchmarks.repertoire [--count N] [NAME ...]``: one line of JSON per interaction.
Styles and bodies are drawn over their whole ranges. ``rejected`` is the share of draws that break a
bound of :mod:`generator.choreographer.checks`, ``faults`` counts the broken bounds.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter

import numpy as np

from generator.choreographer import choreograph, examine, repertoire
from generator.choreographer.sampling import random_bodies, random_style


def main() -> None:
    """Print one line per interaction and one for all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="interactions (all by default)")
    parser.add_argument("--count", type=int, default=25, help="draws of each")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rejected = drawn = 0
    for name in arguments.names or repertoire():
        faults, spoilt, seconds, work = Counter(), 0, 0.0, 0.0
        for number in range(arguments.count):
            rng = np.random.default_rng([arguments.seed, number, *name.encode()])
            style, bodies = random_style(rng), random_bodies(rng)
            start = time.process_time()
            duet = choreograph(name, seed=number, style=style, skeletons=bodies)
            work += time.process_time() - start
            seconds += duet.duration
            broken = examine(duet).faults
            spoilt += bool(broken)
            faults.update(broken)
        rejected, drawn = rejected + spoilt, drawn + arguments.count
        line = {
            "interaction": name,
            "rejected": round(spoilt / arguments.count, 3),
            "faults": dict(faults),
            "cpu_ms_per_s": round(1000 * work / seconds, 1),
        }
        print(json.dumps(line), flush=True)
    print(json.dumps({"interaction": "all", "rejected": round(rejected / drawn, 3)}))


if __name__ == "__main__":
    main()
