"""Two people, each with a gesture of their own: one bows and the other waves.

**The problem.** The entries of the repertoire write both roles, and in each both are about the same
thing. What people ask for is often half of one and half of another. The leading role of the
interactions in :data:`GESTURES` needs no partner, so each person here plays that role of a gesture
of the own, on a stage of the own with the same clock: first both are played to see how long they
take, then again, the shorter one with time to stand. The two stages are then put face to face.
"""

from __future__ import annotations

import numpy as np

from generator.choreographer.arms import pose_arms
from generator.choreographer.compose import LICENCE, SOURCE, cast, finished
from generator.choreographer.interaction import Staging, lookup
from generator.choreographer.role import Build
from generator.choreographer.spacing import Apart, pose_pair
from generator.choreographer.stage import Stage
from generator.choreographer.style import Style
from generator.motion import DuetMotion
from robots.errors import PromptError, SpecError, nearest
from robots.skeleton import Skeleton, human_skeleton

STAND = "stand"
"""The gesture of who does nothing but stand and look."""
GESTURES = (
    "applaud",
    "beckon",
    "blow_kiss",
    "bow",
    "curtsy",
    "disco",
    "namaste",
    "photograph",
    "point",
    "salute",
    STAND,
    "wave",
)
"""What one person can do alone: the leading roles of interactions at a distance, and standing."""
JOINT = "+"
"""Between the two gestures in the name of an exchange."""
ANSWER = (0.2, 1.0)
"""How long after the first the second begins, at ordinary tempo and without lag, s."""
_STANDING = Apart(1.6)


def exchange(
    gestures: tuple[str, str],
    *,
    seed: int = 0,
    styles: tuple[Style, Style] | None = None,
    skeletons: tuple[Skeleton, Skeleton] | None = None,
) -> DuetMotion:
    """Return a new duet of two gestures; the same arguments give the same motion.

    Args:
        gestures: What the one does who begins, and what the other does; of :data:`GESTURES`.
        seed: Decides everything the styles leave open.
        styles: Manner of either; ordinary by default. That of the one who begins says who it is and
            with which hands both gesture; the lag is the other's.
        skeletons: Bodies of person a and person b; the project's own human by default.

    Raises:
        PromptError: There is no such gesture.
        SpecError: The two styles disagree about hand or roles, or a skeleton lacks a keypoint.
    """
    for name in gestures:
        if name not in GESTURES:
            raise PromptError(
                f"no gesture '{name}'", allowed=", ".join(GESTURES), hint=nearest(name, GESTURES)
            )
    one, other = styles or (Style(), Style())
    if (one.handedness, one.swap) != (other.handedness, other.swap):
        raise SpecError("one style names another hand or role", where="styles", allowed="the same")
    bodies = skeletons or (human_skeleton(), human_skeleton())
    builds = cast(bodies, one)
    begin = float(np.random.default_rng([seed, 2]).uniform(*ANSWER))
    waits = (0.0, (begin + other.lag) / other.speed)
    until = 0.0
    stages: list[Stage] = []
    for _ in range(2):
        stages = [
            _stage(name, style, seed, place, builds, wait, until)
            for place, (name, style, wait) in enumerate(
                zip(gestures, (one, other), waits, strict=True)
            )
        ]
        until = max(float(stage.times[-1]) for stage in stages)
    first, second = (stage.first for stage in stages)
    second.path *= -1.0
    second.heading += np.pi
    pair = pose_pair((first, second), (one.energy, other.energy))
    pose_arms(pair)
    motions = finished(pair, one)
    return DuetMotion(
        *motions, seed=seed, source=SOURCE, licence=LICENCE, interaction=JOINT.join(gestures)
    )


def is_exchange(interaction: str) -> bool:
    """Return whether a name is that of an exchange."""
    one, joint, other = interaction.partition(JOINT)
    return bool(joint) and one in GESTURES and other in GESTURES


def _stage(
    name: str,
    style: Style,
    seed: int,
    place: int,
    builds: tuple[Build, Build],
    wait: float,
    until: float,
) -> Stage:
    """Return the stage on which somebody, as its first role, makes a gesture."""
    spacing, staging = _entry(name)
    rng = np.random.default_rng([seed, place, *name.encode()])
    own = builds if place == 0 else (builds[1], builds[0])
    stage = Stage(own, style, rng, near=0.0, wait=wait, until=until)
    stage.near = max(spacing.distance * style.distance, spacing.least) * stage.scale
    staging(stage)
    return stage


def _entry(name: str) -> tuple[Apart, Staging]:
    if name == STAND:
        return _STANDING, _stand
    entry = lookup(name)
    if not isinstance(entry.spacing, Apart):
        raise TypeError(f"{name} is no gesture: its distance hangs on a touch")
    return entry.spacing, entry.staging


def _stand(stage: Stage) -> None:
    """Let the first role stand and look."""
    beat = stage.phases(approach=1.0, hold=1.6, restless=0.012)
    stage.face_to_face(arrive=beat.approach.end, travel=(0.0, 0.4))
