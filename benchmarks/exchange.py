"""Does each of two people make the gesture that the sentence gives them?

    python -m benchmarks.exchange [--weights DIR] [--count 60] [--generator NAME]

Prints, for performances and for what a generator makes of their sentences, the share of people who
are seen to make their gesture: in known wordings, in unknown ones, and for pairs of gestures that
training does not hold. What is seen is judged person by person, from postures over time alone, by a
linear classifier that is fitted to performances first. The last line is the ratio of unknown
wordings to performances.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from bridge.generating import GENERATORS, default_generator, make
from generator.choreographer import GESTURES
from generator.data.choreographed import Split
from generator.data.exchanged import Exchanged, Given
from generator.finishing.resample import resample
from generator.motion import DuetMotion, Motion
from generator.runtime.request import DiffusionRequest
from generator.text.classifier import LinearClassifier
from robots.errors import DuetError
from robots.skeleton import FloatArray

KNOWN, SEED = 480, 1_000_003
"""Performances that the judge learns, and the seed of those that are asked for."""
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
RATE = 10.0
"""Postures per second that the judge looks at."""
SPLITS: tuple[Split, ...] = ("test", "sentences", "combinations")


def traits(person: Motion) -> FloatArray:
    """Return what one person does as numbers: how postures are spread over time, and how fast."""
    points = resample(person.keypoints, person.fps, RATE)
    at = person.skeleton.index
    stature = points[:, at("head"), 2].max()
    across = (points[:, at("left_hip")] - points[:, at("right_hip")])[:, :2]
    left = across / np.linalg.norm(across, axis=1, keepdims=True)
    ahead = np.column_stack([left[:, 1], -left[:, 0]])

    def seen(name: str) -> FloatArray:
        points = resample(person.point(name), person.fps, RATE)
        away = points - resample(person.point("spine3"), person.fps, RATE)
        flat = [np.abs(np.einsum("ti,ti->t", away[:, :2], axis)) for axis in (ahead, left)]
        return np.column_stack([*flat, away[:, 2]]) / stature

    hands = [seen(f"{side}_hand") for side in ("left", "right")]
    hands.sort(key=lambda hand: -float(hand[:, 2].max()))
    head = resample(person.point("head"), person.fps, RATE)
    pelvis = resample(person.point("pelvis"), person.fps, RATE)
    lean = np.linalg.norm((head - pelvis)[:, :2], axis=1)
    between = np.linalg.norm(
        np.diff([resample(person.point(f"{s}_hand"), person.fps, RATE) for s in ("left", "right")],
                axis=0)[0], axis=1,
    )  # fmt: skip
    courses = np.column_stack(
        [*hands, head[:, 2] / stature, pelvis[:, 2] / stature, lean, between / stature]
    )
    speeds = np.abs(np.diff(courses, axis=0)).mean(axis=0) * RATE
    return np.concatenate([np.quantile(courses, QUANTILES, axis=0).ravel(), speeds])


class Judge:
    """Tells gestures of one person."""

    def __init__(self, given: Sequence[Given]) -> None:
        """Learn from performances."""
        rows = np.array([traits(p) for one in given for p in one.motion.people])
        self._mean, self._scale = rows.mean(axis=0), rows.std(axis=0) + 1e-9
        labels = [name for one in given for name in asked(one)]
        self._classifier = LinearClassifier(self._spread(rows), labels)

    def sees(self, motion: DuetMotion) -> list[str]:
        """Return the gestures of person a and person b."""
        rows = np.array([traits(person) for person in motion.people])
        odds = self._classifier.probabilities(self._spread(rows))
        return [self._classifier.names[int(i)] for i in odds.argmax(axis=1)]

    def _spread(self, rows: FloatArray) -> FloatArray:
        """Return traits with their products: a linear map of these bends."""
        x = np.clip((rows - self._mean) / self._scale, -4, 4) / np.sqrt(rows.shape[1])
        first, second = np.triu_indices(x.shape[1])
        return np.concatenate([x, x[:, first] * x[:, second]], axis=1)


def asked(given: Given) -> tuple[str, str]:
    """Return the gestures of person a and person b."""
    one, other = given.gestures
    return (other, one) if given.styles[0].swap else (one, other)


def main() -> int:
    """Measure and return the exit code."""
    parser = argparse.ArgumentParser(description="Does each make the gesture that is asked for?")
    parser.add_argument("--generator", choices=GENERATORS[:2], default=default_generator())
    parser.add_argument("--weights", default="", help="a model, for diffusion")
    parser.add_argument("--count", type=int, default=60, help="sentences of each kind")
    args = parser.parse_args()
    request = DiffusionRequest(weights=args.weights, nearest=True)
    source = Exchanged(KNOWN)
    judge = Judge([source.performance(i) for i in range(KNOWN)])
    print(f"{len(GESTURES)} gestures, {args.count} sentences of each kind")
    ratio = 0.0
    try:
        for split in SPLITS:
            clips = Exchanged(args.count, seed=SEED, split=split)
            given = [clips.performance(i) for i in range(args.count)]
            real = share([(judge.sees(one.motion), asked(one)) for one in given])
            seen = []
            for number, one in enumerate(given):
                motion, _ = make(
                    one.texts[0], seed=number, generator=args.generator, diffusion=request
                )
                seen.append((judge.sees(motion), asked(one)))
            print(f"{split:13s} performances {real}, {args.generator} {share(seen)}", flush=True)
            if split == "sentences":
                ratio = _people(seen) / _people([(judge.sees(g.motion), asked(g)) for g in given])
    except DuetError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    print(f"{ratio:.3f}")
    return 0


Seen = Sequence[tuple[Sequence[str], Sequence[str]]]


def _people(seen: Seen) -> float:
    return float(np.mean([a == b for was, said in seen for a, b in zip(was, said, strict=True)]))


def share(seen: Seen) -> str:
    """Return the share of people, and of pairs, who are right."""
    both = float(np.mean([tuple(was) == tuple(said) for was, said in seen]))
    return f"{_people(seen):.1%} of people, both in {both:.1%}"


if __name__ == "__main__":
    sys.exit(main())
