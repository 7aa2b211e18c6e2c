"""What finishing costs and what it mends.

    python -m benchmarks.finish [INTERACTION ...] [--seeds 3] [--fps 15] [--unlabelled]

Choreographed duets are spoilt the way a network errs (:mod:`benchmarks.spoiling`), finished, and
compared with what they were before. Prints a table of the spoilt (left of each pair) and of the
finished motions, and the CPU seconds for ten seconds of duet against their limit.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, fields, replace

import numpy as np

from benchmarks.spoiling import Spoiling, spoil
from generator.choreographer import choreograph, repertoire
from generator.finishing import finish
from generator.finishing.resample import resample
from generator.motion import CONTACT_POINTS, DuetMotion, Motion
from robots.skeleton import FloatArray
from sim.metrics.smoothness import bone_deviation, jerk

LIMIT = 0.3
"""CPU seconds that ten seconds of duet may take on one core."""


@dataclass(frozen=True, slots=True)
class Figures:
    """How clean a motion is; of both people."""

    bones: float
    """Largest deviation of a bone from its median length, as a share."""
    skate: float
    """Mean speed along the floor of feet that stand in the original, m/s."""
    jerk: float
    """Mean jerk of keypoints over that of the original."""
    sunk: float
    """Deepest ankle or toe below where standing ones are in the original, m."""
    floating: float
    """Mean distance of standing toes from their height in the original, m."""
    miss: float
    """Largest miss of a labelled touch in its middle half, m; 0 without touches."""
    away: float
    """Mean distance of keypoints from the original, m."""
    pose: float
    """The same after each pelvis is put into its place, m."""


def figures(motion: DuetMotion, original: DuetMotion) -> Figures:
    """Return how clean a motion is; it is compared at the frame rate of the original."""
    count = min(original.frames, int(motion.duration * original.fps) + 1)
    points = np.stack(
        [resample(m.keypoints, motion.fps, original.fps)[:count] for m in motion.people], axis=1
    )
    true = original.keypoints[:count]
    parents = original.a.skeleton.parents
    gap = points - true
    pose = gap - gap[:, :, :1]
    standing = [_standing(m, count) for m in original.people]
    return Figures(
        bones=float(bone_deviation(motion.keypoints, parents).max()),
        skate=float(np.mean([_skate(points[:, i], standing[i], original) for i in range(2)])),
        jerk=float(jerk(points, original.fps).mean() / jerk(true, original.fps).mean()),
        sunk=max(_sunk(points[:, i], true[:, i], original) for i in range(2)),
        floating=float(
            np.mean([_floating(points[:, i], true[:, i], standing[i], original) for i in range(2)])
        ),
        miss=_miss(motion, original),
        away=float(np.linalg.norm(gap, axis=-1).mean()),
        pose=float(np.linalg.norm(pose, axis=-1).mean()),
    )


def _feet(original: DuetMotion) -> list[int]:
    return [original.a.skeleton.index(name) for name in CONTACT_POINTS]


def _standing(person: Motion, count: int) -> np.ndarray:
    if person.foot_contacts is None:
        raise ValueError("the original has no labels of foot contacts")
    return person.foot_contacts[:count]


def _skate(points: FloatArray, standing: np.ndarray, original: DuetMotion) -> float:
    feet = points[:, _feet(original), :2]
    speed = np.linalg.norm(np.diff(feet, axis=0), axis=-1) * original.fps
    return float(speed[standing[1:] & standing[:-1]].mean())


def _sunk(points: FloatArray, true: FloatArray, original: DuetMotion) -> float:
    feet = _feet(original)
    return float(max(0.0, *(true[:, feet, 2].min(axis=0) - points[:, feet, 2].min(axis=0))))


def _floating(
    points: FloatArray, true: FloatArray, standing: np.ndarray, original: DuetMotion
) -> float:
    feet = _feet(original)
    return float(np.abs((points - true)[:, feet, 2][standing]).mean())


def _miss(motion: DuetMotion, original: DuetMotion) -> float:
    worst = 0.0
    for contact in original.contacts:
        quarter = (contact.end - contact.start) / 4
        times = motion.a.times
        inside = (times >= contact.start + quarter) & (times <= contact.end - quarter)
        inside[np.argmin(np.abs(times - (contact.start + contact.end) / 2))] = True
        worst = max(worst, float(np.abs(motion.gap(contact)[inside] - contact.gap).max()))
    return worst


def main() -> None:
    """Print the table and the cost."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("interactions", nargs="*", help="default: all")
    parser.add_argument("--seeds", type=int, default=1, help="spoilt motions of each")
    parser.add_argument("--fps", type=float, default=15.0, help="frame rate of the spoilt motions")
    parser.add_argument("--unlabelled", action="store_true", help="take the labels away")
    args = parser.parse_args()
    names = [field.name for field in fields(Figures)]
    print(f"{'':16s}" + "".join(f"{name:>17s}" for name in names))
    rows, seconds, duration = [], 0.0, 0.0
    for name in args.interactions or repertoire():
        for seed in range(args.seeds):
            original = choreograph(name, seed=seed)
            given = spoil(original, seed, Spoiling(fps=args.fps))
            if args.unlabelled:
                a, b = (replace(m, foot_contacts=None) for m in given.people)
                given = replace(given, a=a, b=b, contacts=())
            start = time.process_time()
            made = finish(given)
            seconds += time.process_time() - start
            duration += given.duration
            pair = [[getattr(figures(m, original), n) for n in names] for m in (given, made)]
            rows.append(pair)
            print(f"{name:16s}" + _cells(np.array(pair)), flush=True)
    print(f"{'mean':16s}" + _cells(np.mean(rows, axis=0)))
    cost = 10 * seconds / duration
    print(f"{cost:.3f} CPU s for 10 s of duet at {args.fps:g} fps, {cost / LIMIT:.0%} of the limit")


def _cells(pair: FloatArray) -> str:
    return "".join(f"{before:9.4f}{after:8.4f}" for before, after in pair.T)


if __name__ == "__main__":
    main()
