"""How much a controller bears that it was not told of: pushes, loads, floors, delays, weights.

    python -m benchmarks.tracking.robustness [--only push] [--trials 10]

Every trial is the four seconds around the grip of a choreographed handshake. Nobody can turn back
time in a world that pushes, so the controller may not go back and try again. Results go to
out/bench-track/robustness.jsonl, one line per trial; what is there already is not done again.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.tracking.ablation import VARIANTS
from benchmarks.tracking.clips import BenchClip
from benchmarks.tracking.results import Key, Record, Results
from benchmarks.tracking.run import in_processes, note, run
from benchmarks.tracking.tasks import Task
from generator.choreographer import choreograph
from generator.given import cut_motion
from generator.motion import DuetMotion
from robots.errors import DuetError
from sim.disturbance import NONE, Disturbance, Payload, Push
from sim.scene import PEOPLE
from sim.track import CONTROLLERS, TrackSettings

OUT = Path("out/bench-track/robustness.jsonl")
HANDSHAKES = 10
"""Different handshakes; trial i takes number i modulo this."""
_BEFORE, _AFTER = 1.5, 1.0
"""How much of the motion is kept before and after the grip, s."""
_PUSH_SECONDS = 0.2
_FIRST_PUSH, _LAST_PUSH = 0.3, 1.5
"""Pushes start this long after the start and before the end of the clip, s."""

Draw = Callable[[np.random.Generator, float], Disturbance]
"""Draw a disturbance for a clip of so many seconds."""


@dataclass(frozen=True, slots=True)
class Condition:
    """One row of the table."""

    name: str
    trials: int
    draw: Draw


def _push(newtons: float) -> Draw:
    def draw(rng: np.random.Generator, duration: float) -> Disturbance:
        person, angle = PEOPLE[rng.integers(2)], rng.uniform(0, 2 * math.pi)
        start = rng.uniform(_FIRST_PUSH, duration - _LAST_PUSH)
        force = (newtons * math.cos(angle), newtons * math.sin(angle), 0.0)
        push = Push(person=person, force=force, start=start, duration=_PUSH_SECONDS)
        return Disturbance(pushes=(push,))

    return draw


def _payload(body: str, mass: float) -> Draw:
    def draw(rng: np.random.Generator, duration: float) -> Disturbance:
        del duration
        person = PEOPLE[rng.integers(2)]
        return Disturbance(payloads=(Payload(person=person, body=body, mass=mass),))

    return draw


def _always(disturbance: Disturbance) -> Draw:
    return lambda rng, duration: disturbance


TICK = 1 / 60
"""Time between two controls, s."""

CONDITIONS = (
    Condition("undisturbed", 10, _always(NONE)),
    Condition("push 100 N, 0.2 s", 50, _push(100.0)),
    Condition("push 200 N, 0.2 s", 50, _push(200.0)),
    Condition("payload 2 kg, hand", 10, _payload("right_wrist", 2.0)),
    Condition("payload 5 kg, trunk", 10, _payload("spine3", 5.0)),
    Condition("friction 0.4", 10, _always(Disturbance(friction=0.4))),
    Condition("friction 0.6", 10, _always(Disturbance(friction=0.6))),
    Condition("friction 1.2", 10, _always(Disturbance(friction=1.2))),
    Condition("latency 17 ms", 10, _always(Disturbance(latency=TICK))),
    Condition("latency 33 ms", 10, _always(Disturbance(latency=2 * TICK))),
    Condition("mass +10 %", 10, _always(Disturbance(mass_error=0.1))),
    Condition("mass -10 %", 10, _always(Disturbance(mass_error=-0.1))),
)
"""Payloads are on one person, all else is the same for both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grip(BenchClip):
    """The seconds around the grip of a choreographed handshake."""

    interaction: str = "handshake"

    def load(self) -> DuetMotion:
        """Make the motion."""
        whole = choreograph(self.interaction, seed=self.seed, style=self.style)
        grip = whole.contacts[0]
        start = round(max(0.0, grip.start - _BEFORE) * whole.fps) / whole.fps
        held = replace(grip, start=grip.start - start, end=grip.end - start)
        return replace(cut_motion(whole, start, grip.end + _AFTER), contacts=(held,))


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial(Task):
    """One grip under one disturbance."""

    disturbance: Disturbance

    @property
    def settings(self) -> TrackSettings:
        """The settings: a disturbance, and no second try."""
        settings = TrackSettings(controller=self.controller, disturbance=self.disturbance)
        if self.controller == "ilqr":
            return replace(settings, ilqr=replace(settings.ilqr, recovery=0, **self.options))
        return settings


def trials_of(
    condition: Condition, controller: str, most: int, variant: str = "everything"
) -> list[Trial]:
    """Return the trials of a condition; those of one number are pushed alike at one time.

    A variant is one of :data:`benchmarks.tracking.ablation.VARIANTS`, for ``ilqr`` alone.
    """
    durations = [Grip(set="", name="", seed=seed).load().duration for seed in range(HANDSHAKES)]
    trials = []
    for number in range(min(condition.trials, most)):
        seed = number % HANDSHAKES
        rng = np.random.default_rng([2026, number])
        trials.append(
            Trial(
                clip=Grip(set=condition.name, name=f"{number:02d}_handshake_{seed}", seed=seed),
                controller=controller,
                options=VARIANTS[variant],
                disturbance=condition.draw(rng, durations[seed]),
            )
        )
    return trials


def table(trials: Sequence[Trial], records: Mapping[Key, Record]) -> Iterator[str]:
    """Yield the lines of a markdown table, one row per condition that has results."""
    yield "| disturbance | nobody falls | mpjpe, median | furthest off, median | CPU-s per s |"
    yield "|---|---|---|---|---|"
    for condition in CONDITIONS:
        keys = [trial.key for trial in trials if trial.clip.set == condition.name]
        rows = [records[key] for key in keys if key in records]
        if not rows:
            continue
        stood = sum(bool(row["success"]) for row in rows)
        count = f"{stood} of {len(rows)} ({100 * stood / len(rows):.0f} %)"
        whole = [row for row in rows if "mpjpe_global_mm" in row]
        figures = ["-"] * 3
        if whole:
            error = median(max(row["mpjpe_global_mm"].values()) for row in whole)
            most = median(max(row["max_mean_error_m"].values()) for row in whole)
            cost = median(row["cpu_seconds_per_second"] for row in whole)
            figures = [f"{error:.0f} mm", f"{1000 * most:.0f} mm", f"{cost:.1f}"]
        yield f"| {condition.name} | {count} | {' | '.join(figures)} |"


def main() -> int:
    """Perform the trials that have no result yet, and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tracking.robustness", description=__doc__
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--controller", default="ilqr", choices=tuple(CONTROLLERS))
    parser.add_argument(
        "--variant", default="everything", choices=tuple(VARIANTS), help="leave out a part of ilqr"
    )
    parser.add_argument("--only", default="", help="conditions whose names contain this")
    parser.add_argument("--trials", type=int, default=1000, help="at most so many per condition")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: 1)")
    parser.add_argument("--out", type=Path, default=OUT, help=f"file (default: {OUT})")
    args = parser.parse_args()
    chosen = [condition for condition in CONDITIONS if args.only in condition.name]
    trials = [t for c in chosen for t in trials_of(c, args.controller, args.trials, args.variant)]
    results = Results(args.out)
    try:
        run(trials, results, in_processes(args.jobs))
        note("")
        print("\n".join(table(trials, results.read())))
    except DuetError as error:
        note(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        note("stopped; run again to go on")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
