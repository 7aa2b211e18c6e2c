"""Measures what the options of ``--generator diffusion`` do on a trained model.

    python -m benchmarks.beyond seams manner takes interval --weights FOLDER [--samples N]

``seams``: velocity discontinuities where the windows of a choreography of one minute meet, against
those of choreographed duets. ``manner``: what tempo, energy and amplitude do to the speed and reach
of hands. ``takes``: distances to liked and unliked takes. ``interval``: guidance in a part of the
noise levels against guidance in all.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from generator.choreographer import choreograph, repertoire
from generator.finishing import DRAWN, finish
from generator.motion import DuetMotion
from generator.runtime import DiffusionRequest, draw, generate
from generator.runtime.generation import open_studio, part_frames
from generator.runtime.sequence import overlap_of, plan
from robots.skeleton import FloatArray

PARTS = (
    "two people walk towards each other",
    "they shake hands",
    "the first person bows and the second person bows back",
    "they wave at each other",
    "they dance a waltz",
)
PART_SECONDS = 12.0
"""Length of each part of a choreography, so that it is a minute long."""
SENTENCES = (
    "two people wave at each other",
    "two people shake hands",
    "two people box",
    "they dance a waltz",
)
HANDS = [20, 21]
"""Keypoints of the wrists."""


def discontinuity(motion: DuetMotion) -> FloatArray:
    """Return ``[T-2]`` m/s: the largest change of any keypoint's velocity from frame to frame."""
    velocity = np.diff(motion.keypoints, axis=0) * motion.fps
    return np.linalg.norm(np.diff(velocity, axis=0), axis=-1).max(axis=(1, 2))


def around(values: NDArray, frames: NDArray, reach: int) -> FloatArray:
    """Return the largest value within ``reach`` of each of some frames."""
    spans = [slice(max(0, round(at) - reach), round(at) + reach + 1) for at in frames.tolist()]
    return np.array([values[span].max() for span in spans if len(values[span])])


def seams(weights: str, samples: int) -> None:
    """Print discontinuities at both ends of each fade, in drawn frames and finished ones."""
    request = DiffusionRequest(weights=weights, then=PARTS[1:], seconds=PART_SECONDS)
    studio = open_studio(PARTS, request)
    fps, longest = studio.fps, studio.model.sampling.frames
    overlap = overlap_of(longest, fps)
    windows = plan(part_frames(studio, len(PARTS)), longest, overlap)
    ends = np.cumsum([w.frames - (overlap if n else 0) for n, w in enumerate(windows)])[:-1]
    edges = np.concatenate([ends - overlap, ends]) / fps  # s
    reach = max(1, round(30 / fps / 2))
    found, inside, seconds = [], [], 0.0
    start = time.process_time()
    for seed in range(samples):
        raw, _ = generate(PARTS[0], request, seed=seed)
        seconds += raw.duration
        values = discontinuity(finish(raw, settings=DRAWN))
        found.append(around(values, edges * 30 - 1, reach))
        inside.append(values)
    cost = (time.process_time() - start) / samples
    data = [discontinuity(choreograph(name, seed=seed)) for name in repertoire() for seed in (0, 1)]
    alike = np.concatenate([around(d, np.arange(reach, len(d) - reach), reach) for d in data])
    at = np.concatenate(found)
    bar = np.percentile(alike, 99)
    own = [around(d, np.arange(reach, len(d) - reach), reach) for d in inside]
    print(f"{len(at)} edges of fades, largest change of velocity within {reach} frames of each:")
    print(f"  median {np.median(at):.3f}, largest {at.max():.3f} m/s")
    print(f"  choreographed duets, the same: 99th percentile {bar:.3f} m/s")
    print(f"  share of edges below that: {np.mean(at < bar):.1%}")
    low, high = np.percentile(np.concatenate(own), (50, 99))
    print(f"  anywhere in the model's motions: median {low:.3f}, 99th percentile {high:.3f} m/s")
    print(f"  {cost:.2f} CPU s for {seconds / samples:.0f} s")


def manner(weights: str, samples: int) -> None:
    """Print speed and reach of hands, relative to the ordinary manner."""

    def figures(motion: DuetMotion) -> tuple[float, float]:
        hands = motion.keypoints[:, :, HANDS] - motion.keypoints[:, :, :1]
        speed = np.linalg.norm(np.diff(hands, axis=0), axis=-1).mean() * motion.fps
        return float(speed), float(np.linalg.norm(hands.std(axis=0), axis=-1).mean())

    def mean(request: DiffusionRequest) -> FloatArray:
        made = [generate(text, request, seed=s)[0] for text in SENTENCES for s in range(samples)]
        return np.mean([figures(motion) for motion in made], axis=0)

    ordinary = DiffusionRequest(weights=weights)
    plain = mean(ordinary)
    print("relative to ordinary: speed of hands, reach (deviation of their place)")
    for name in ("tempo", "energy", "amplitude"):
        for value in (0.7, 1.35):
            speed, reach = mean(replace(ordinary, **{name: value})) / plain
            print(f"  {name:9s} {value:4.2f}: {speed:5.2f} {reach:5.2f}")


def distance(one: DuetMotion, other: DuetMotion) -> float:
    """Return the mean distance of keypoints over the common time, m."""
    count = min(one.frames, other.frames)
    apart = one.keypoints[:count] - other.keypoints[:count]
    return float(np.linalg.norm(apart, axis=-1).mean())


def takes(weights: str, samples: int) -> None:
    """Print distances to a take: of other seeds, of what is like it, of what is unlike it."""
    plain = DiffusionRequest(weights=weights)
    rows = {"another seed": plain, "--like": replace(plain, like=("0",))}
    rows["--unlike"] = replace(plain, unlike=("0",))
    first = [generate(text, plain, seed=0)[0] for text in SENTENCES]
    for name, request in rows.items():
        apart = [
            distance(take, generate(text, request, seed=seed)[0])
            for take, text in zip(first, SENTENCES, strict=True)
            for seed in range(1, samples + 1)
        ]
        print(f"  {name:14s} {np.mean(apart):.3f} m (smallest {min(apart):.3f})")


def interval(weights: str, samples: int) -> None:
    """Print how far guidance in an interval of noise levels leads from guidance in all."""
    studio = open_studio(("x",), DiffusionRequest(weights=weights))
    frames = part_frames(studio, 1)[0]
    full = studio.sampler
    truth = {}
    for span in ((0, 999), (0, 0), (300, 999), (0, 700), (200, 800), (300, 700)):
        config = replace(full, guidance_interval=span)
        start, apart = time.process_time(), []
        for text in SENTENCES:
            for seed in range(samples):
                drawn = draw(studio.model, studio.cond(text), frames, config, seed=seed)
                points = drawn[..., :66].reshape(*drawn.shape[:3], 22, 3)
                truth.setdefault((text, seed), points)
                apart.append(np.linalg.norm(points - truth[text, seed], axis=-1).mean())
        cost = (time.process_time() - start) / len(apart)
        print(f"  guided {span}: {np.mean(apart):.3f} m from all, {cost:.2f} CPU s a clip")


MEASURES: dict[str, Callable[[str, int], None]] = {
    "seams": seams,
    "manner": manner,
    "takes": takes,
    "interval": interval,
}


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("measures", nargs="+", choices=MEASURES)
    parser.add_argument("--weights", default="", help="a model; the one that ships by default")
    parser.add_argument("--samples", type=int, default=4, help="seeds of each")
    args = parser.parse_args()
    for name in args.measures:
        print(name)
        MEASURES[name](args.weights, args.samples)


if __name__ == "__main__":
    main()
