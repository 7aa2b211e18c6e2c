"""The least root assist that makes a motion trackable: a measure of how implausible it is.

**The problem.** Whether people fall is one bit, and how much of an offered hand they take depends
on how much is offered. So the offer itself is varied: how strong must the hand at each pelvis be at
least, so that nobody falls? A motion that people can do on their own feet needs 0. One that hangs
half a metre in the air needs about the body's weight (1.03 measured, at ``within=0.2``). In between
lies what balance, friction and muscles refuse.

The measure is of motion and controller together: springs that cannot balance (``assist``) need
0.045 body weights for a choreographed handshake with its steps. It is as good as the definition of
a fall, by default half a metre of mean error; who is to hang lower than that above the floor may
drop onto it and pass, so ask for a closer ``within`` there.

More help is taken to be better, which holds up to luck: a stumble may be survived at one bound and
not at the next. The answer is a bound that worked, next to one that did not.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace

from generator.motion import DuetMotion
from robots.errors import SimDiverged, SpecError
from sim.controllers.base import Progress
from sim.rollout import FALL_DISTANCE, Rollout
from sim.scene import AssistLimits
from sim.track import TrackSettings, track

log = logging.getLogger(__name__)

_GRAIN = 1.1
"""Ratio of neighbouring bounds that may be tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AssistTry:
    """One run with a bounded hand."""

    force_bodyweight: float
    """Bound of the force per axis."""
    held: bool
    """Whether nobody fell and the motion was simulated to its end."""
    why: str = ""
    """Else what happened."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastAssist:
    """How strong a hand a motion needs."""

    trackable: bool
    """Whether any bound that was tried sufficed."""
    force_bodyweight: float | None
    """Least sufficient bound of the force per axis, in body weights, rounded up by at most 10 %; 0
    if none was needed, ``None`` if nothing sufficed."""
    torque_share: float | None
    """The bound of the torque per axis that goes with it, in body weight times stature."""
    controller: str
    """Who tracked."""
    tries: tuple[AssistTry, ...]
    """What was tried, in order."""


def least_assist(
    motion: DuetMotion,
    settings: TrackSettings | None = None,
    *,
    resolution: float = 0.01,
    ceiling: float = 2.0,
    within: float = FALL_DISTANCE,
    progress: Progress | None = None,
) -> LeastAssist:
    """Return the smallest bound of the root assist at which nobody falls.

    Bounds tried are 0, the ceiling, and then, by bisection, some of a series from ``resolution``
    to ``ceiling`` in steps of 10 %. That takes 1 run for a motion that needs no help, 2 for one
    that nothing helps, and 8 to 9 otherwise, each as dear as :func:`sim.track.track`. Force and
    torque keep the proportion of the defaults of :class:`sim.scene.AssistLimits`. The same motion
    and settings give the same answer on the same machine.

    The command line: ``pasdedeux track MOTION --least-assist``.

    Args:
        motion: What to do.
        settings: How to track; their assist gives its ``frequency`` alone.
        resolution: Smallest bound that is told from 0, body weights.
        ceiling: Largest bound tried, body weights.
        within: Mean distance of a person's keypoints from the reference, m, beyond which it does
            not count as tracked.
        progress: Told the share of the work that is done, 0 to 1.

    Raises:
        SpecError: The bounds make no sense.
    """
    if not 1e-4 <= resolution < ceiling <= 10:
        raise SpecError(
            f"bounds from {resolution} to {ceiling} body weights",
            where="least_assist",
            allowed="0.0001 <= resolution < ceiling <= 10",
        )
    if not 0 < within <= FALL_DISTANCE:
        raise SpecError(f"{within} m", where="least_assist.within", allowed=f"0 to {FALL_DISTANCE}")
    settings = settings or TrackSettings()
    count = math.ceil(math.log(ceiling / resolution) / math.log(_GRAIN))
    most = 3 + math.ceil(math.log2(count))
    tries: list[AssistTry] = []

    def holds(force: float) -> bool:
        before = len(tries)
        inner = _part(progress, before / most, 1 / most)
        tries.append(_attempt(motion, settings, force, within, inner))
        log.info("assist of %.3f body weights: %s", force, tries[-1].why or "held")
        return tries[-1].held

    def bound(index: int) -> float:
        return resolution * (ceiling / resolution) ** (index / count)

    def answer(force: float | None) -> LeastAssist:
        if progress is not None:
            progress(1.0)
        return LeastAssist(
            trackable=force is not None,
            force_bodyweight=force,
            torque_share=None if force is None else _torque(force),
            controller=settings.controller,
            tries=tuple(tries),
        )

    if holds(0.0):
        return answer(0.0)
    if not holds(ceiling):
        return answer(None)
    fails, works = -1, count
    while works - fails > 1:
        middle = (fails + works) // 2
        fails, works = (fails, middle) if holds(bound(middle)) else (middle, works)
    return answer(bound(works))


def _attempt(
    motion: DuetMotion,
    settings: TrackSettings,
    force: float,
    within: float,
    progress: Progress | None,
) -> AssistTry:
    limits = settings.assist or AssistLimits()
    limits = replace(limits, max_force=force, max_torque=_torque(force))
    try:
        rollout = track(motion, settings=replace(settings, assist=limits), progress=progress)
    except SimDiverged as error:
        return AssistTry(force_bodyweight=force, held=False, why=error.what)
    why = _failure(rollout, within)
    return AssistTry(force_bodyweight=force, held=not why, why=why)


def _failure(rollout: Rollout, within: float) -> str:
    """Return why a rollout does not count as tracked; empty if it does."""
    for person, time in rollout.fall_time.items():
        if time is not None:
            return f"person {person} fell at {time:.2f} s"
    if rollout.ended is not None:
        return str(rollout.ended["why"])
    if rollout.error.max() > within:
        moment, p = divmod(int(rollout.error.argmax()), 2)
        return (
            f"person {'ab'[p]} was {rollout.error.max():.2f} m off at {rollout.times[moment]:.2f} s"
        )
    return ""


def _torque(force: float) -> float:
    """Return the bound of the torque that goes with one of the force."""
    default = AssistLimits()
    return force * default.max_torque / default.max_force


def _part(progress: Progress | None, done: float, share: float) -> Progress | None:
    """Return what tells the progress of one run as that of its share of the whole."""
    if progress is None:
        return None
    tell = progress
    return lambda inner: tell(done + share * inner)
