"""Play: rock-paper-scissors, clapping, tug-of-war, throw and catch, low five, hand wrestling."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from generator.choreographer.curves import through, window
from generator.choreographer.formations import stagger
from generator.choreographer.gestures import follow
from generator.choreographer.interaction import interaction
from generator.choreographer.role import Role
from generator.choreographer.spacing import Apart, ByReach
from generator.choreographer.stage import PALM_TO_PALM, Span, Stage
from generator.choreographer.style import FACING, SIDES, Side

Pairs = tuple[tuple[Side, Side], ...]
"""Hands that meet: of the first role and of the second."""


@interaction(Apart(1.15, least=1.0))
def rock_paper_scissors(stage: Stage) -> None:
    """Both swing a fist three times and show rock, paper or scissors; one of them cheers."""
    beat = stage.phases(
        approach=0.7, prepare=0.6, hold=2.0, release=1.3, depart=0.8, restless=0.010
    )
    stage.face_to_face(arrive=beat.prepare.at(0.3), travel=(0.1, 0.4))
    times, size = stage.times, min(stage.style.amplitude, 1.3)
    show = beat.hold.at(0.78)
    count = np.linspace(beat.hold.start, show, 4)
    winner = int(stage.rng.random() < 0.5)
    lag = min(stage.answer(), 0.12)
    for index, role in enumerate(stage.people):
        late = lag if index else 0.0
        knots: list = [(float(beat.prepare.end + late), (0.30, 0.05, -0.10))]
        for start, end in pairwise(count):
            top = float(start + 0.45 * (end - start)) + late
            knots.append((top, (0.27, 0.06, -0.08 + 0.13 * size)))
            knots.append((float(end) + late, (0.33, 0.04, -0.10)))
        knots[-1] = (knots[-1][0], (0.42, 0.06, -0.06))
        on = window(
            times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.at(0.5)
        )
        follow(stage, role, "right", knots, on, elbow=(-0.4, 0.4, -1.0))
        role.gesture("left", (0.27, -0.02, -0.16), on, elbow=(-0.4, 0.6, -0.9))
        role.lean += 0.08 * stage.style.energy * on
        role.nod += 0.18 * on
        _celebrate(stage, role, beat.release, won=index == winner)


def _celebrate(stage: Stage, role: Role, span: Span, *, won: bool) -> None:
    """Let somebody rejoice over a win, or hang the head over a loss."""
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    start, end = span.at(0.1), span.end + 0.45
    on = window(times, start, span.at(0.5), span.at(0.8), end)
    if won:
        pump = stage.rhythm(Span(span.at(0.2), span.end), 1.6, 0.04)
        high = 0.22 + 0.08 * size + pump
        fist = np.column_stack([np.full(len(pump), 0.16), np.full(len(pump), 0.26), high])
        role.gesture("right", fist, on, elbow=(-0.1, 0.8, -0.8))
        role.lean -= 0.08 * energy * on
        role.nod -= 0.12 * on
    else:
        role.lean += 0.12 * energy * on
        role.nod += 0.35 * on
        role.gaze -= 0.5 * on
        role.gesture("right", (0.12, 0.05, 0.02), on, point="head", elbow=(0.0, 1.0, -0.6))


@interaction(ByReach(0.74))
def pat_a_cake(stage: Stage) -> None:
    """Both play a clapping game: own hands, right hands, own, left hands, own, both."""
    beat = stage.phases(
        approach=0.9, prepare=0.7, hold=4.2, release=0.8, depart=0.6, restless=0.010
    )
    stage.face_to_face(arrive=beat.prepare.at(0.3), travel=(0.1, 0.4))
    times = stage.times
    moments = np.linspace(beat.hold.start + 0.1, beat.hold.end - 0.2, 9)
    period = float(moments[1] - moments[0])
    base = window(times, beat.approach.at(0.8), beat.prepare.end, beat.hold.end, beat.release.end)
    # Palms are apart between the claps and together on every other beat.
    phase = np.clip((times - moments[0]) / (2 * period), -0.25, 4.25)
    open_ = 0.5 - 0.5 * np.cos(2 * np.pi * phase)
    wide = 0.06 + 0.05 * stage.style.amplitude
    for role in stage.people:
        for side in SIDES:
            spot = np.column_stack(
                [np.full(len(times), 0.26), 0.033 + wide * open_, np.full(len(times), 0.06)]
            )
            role.gesture(side, spot, base, elbow=(-0.2, 0.8, -0.9))
        role.nod += 0.03 * np.sin(2 * np.pi * phase) * base
        role.crouch += 0.012 * stage.style.energy * open_ * base
    for order, moment in enumerate(moments[1::2]):
        sides: Pairs = (("right", "right"), ("left", "left"), *FACING)
        for pair in sides[2:] if order % 3 == 2 else (sides[order % 3],):
            stage.meet(
                pair,
                on=Span(float(moment), float(moment) + 0.07),
                start=float(moment) - 0.62 * period,
                end=float(moment) + 0.07 + 0.62 * period,
                height=-0.04,
                apart=(PALM_TO_PALM, 0.0, 0.0),
                elbow=(-0.2, 0.6, -1.0),
            )
        if order % 3 < 2:
            on = window(times, moment - 0.6 * period, moment, moment + 0.07, moment + 0.6 * period)
            for role in stage.people:
                role.twist += (0.12, -0.12)[order % 3] * on


@interaction(Apart(1.75, least=1.6))
def tug_of_war(stage: Stage) -> None:
    """Both pull at the ends of a rope, lean back and drag each other to and fro."""
    beat = stage.phases(
        approach=0.3, prepare=0.9, hold=4.0, release=1.0, depart=0.8, restless=0.003
    )
    stage.face_to_face(arrive=beat.approach.end, travel=(0.0, 0.0))
    times, energy = stage.times, stage.style.energy
    size = min(stage.style.amplitude, 1.2)
    stagger(stage, beat.prepare.at(0.2), beat.release.end, 0.16)
    on = window(
        times, beat.prepare.at(0.5), beat.hold.start, beat.hold.at(0.92), beat.release.at(0.5)
    )
    grip = window(times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.end)
    winner = 1.0 if stage.rng.random() < 0.5 else -1.0
    drag = stage.pick(0.10, 0.16) * size
    knots = [
        (beat.hold.start, 0.0),
        (beat.hold.at(0.30), -winner * drag),
        (beat.hold.at(0.55), 0.5 * winner * drag),
        (beat.hold.at(0.92), winner * 2.2 * drag),
    ]
    rope = through(times, knots)
    heave = np.abs(stage.rhythm(Span(beat.hold.start, beat.hold.at(0.92)), 0.55, 0.05)) * energy
    for role, sign in zip(stage.people, (-1.0, 1.0), strict=True):
        role.path[:, 0] += rope
        winning = sign * winner > 0
        loss = window(
            times, beat.hold.at(0.75), beat.hold.end, beat.release.at(0.2), beat.depart.at(0.3)
        )
        role.lean -= (0.19 * on + 1.2 * heave) * (1.0 if winning else 1.0 - 0.9 * loss)
        role.lean += 0.10 * loss * energy if not winning else 0.0
        role.crouch += (0.10 + 0.3 * heave) * on
        role.shift[:, 0] -= 0.07 * on
        role.heading += 0.25 * grip
        role.nod += 0.15 * on
        lag = min(stage.answer(), 0.3) if role is stage.second else 0.0
        pull = np.roll(0.5 * heave, round(30 * lag)) * grip
        for side, ahead in zip(SIDES, (0.48, 0.27), strict=True):
            spot = np.column_stack(
                [ahead - pull, np.full(len(times), 0.04), np.full(len(times), -0.14)]
            )
            role.gesture(side, spot, grip, elbow=(-0.5, 0.7, -0.8))


@interaction(Apart(2.1, least=1.9))
def throw_catch(stage: Stage) -> None:
    """One throws a ball overarm, the other catches it with both hands and throws it back."""
    beat = stage.phases(
        approach=0.2, prepare=1.4, contact=0.6, hold=2.5, release=1.2, depart=0.7, restless=0.012
    )
    stage.face_to_face(arrive=beat.approach.end, travel=(0.0, 0.0))
    flight = 0.55
    lag = min(stage.answer(), 0.4)
    away = beat.contact.start
    back = max(beat.hold.at(0.6) + lag, away + 2.0)
    first, second = stage.people
    _throw(stage, first, away, ready=beat.prepare.start)
    caught = _catch(stage, second, away + flight, until=back - 0.55)
    _throw(stage, second, back, ready=caught)
    _catch(stage, first, back + flight, until=beat.depart.at(0.3))


def _throw(stage: Stage, role: Role, moment: float, ready: float) -> None:
    """Let somebody wind up and throw at a moment, s."""
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    wind = moment - 0.40
    on = window(times, min(ready, wind - 1.0), wind, moment + 0.3, moment + 1.0)
    back = (-0.12 - 0.03 * size, 0.40, 0.27 + 0.03 * size)
    knots = [
        (wind, back),
        (moment + 0.16, (0.44, 0.12, 0.24)),
        (moment + 0.62, (0.30, 0.0, -0.20)),
    ]
    follow(stage, role, "right", knots, on, elbow=(-0.5, 0.8, -0.6))
    aim = window(times, min(ready, wind - 0.5), wind, wind + 0.1, moment + 0.4)
    role.gesture("left", (0.40, 0.12, 0.10), aim, elbow=(-0.2, 0.8, -0.6))
    coil = window(times, wind - 0.5, wind, wind, moment + 0.05)
    swing = window(times, wind + 0.1, moment + 0.15, moment + 0.3, moment + 0.9)
    role.twist += (-0.28 * coil + 0.20 * swing) * (0.5 + 0.5 * energy)
    role.lean += (-0.08 * coil + 0.14 * swing) * energy
    role.shift[:, 0] += 0.06 * (swing - coil)


def _catch(stage: Stage, role: Role, moment: float, until: float) -> float:
    """Let somebody catch with both hands and hold on; return when the ball is safe, s."""
    times, energy = stage.times, stage.style.energy
    safe = moment + 0.45
    on = window(times, moment - 0.7, moment - 0.15, max(until, safe), max(until, safe) + 0.5)
    for side in SIDES:
        knots = [
            (moment - 0.1, (0.42, 0.10, 0.10)),
            (moment, (0.43, 0.085, 0.10)),
            (safe, (0.21, 0.08, -0.12)),
        ]
        follow(stage, role, side, knots, on, elbow=(-0.4, 0.8, -0.9))
    give = window(times, moment - 0.1, moment + 0.2, moment + 0.3, moment + 0.8)
    role.lean += 0.10 * energy * give
    role.crouch += 0.04 * energy * give
    role.nod += 0.12 * window(times, moment, moment + 0.3, moment + 0.5, moment + 0.9)
    return safe


@interaction(ByReach(0.80))
def low_five(stage: Stage) -> None:
    """One holds out a low open hand, the other swings down and slaps it."""
    beat = stage.phases(
        approach=1.2, prepare=0.9, contact=0.08, hold=0.10, release=0.8, depart=0.9, restless=0.010
    )
    stage.face_to_face(arrive=beat.prepare.at(0.1), travel=(0.3, 0.6))
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    first, second = stage.people
    late = min(stage.answer(), 0.3)
    hit = beat.contact.start
    offer = window(
        times, beat.approach.at(0.7), beat.prepare.at(0.4), beat.touch.end, beat.release.end
    )
    first.gesture("right", (0.34, 0.06, -0.26), offer, elbow=(-0.6, 0.3, -1.0))
    first.lean += 0.06 * offer
    up = hit - 0.40
    high = window(times, up - 0.55 + 0.3 * late, up, up + 0.05, hit + 0.02)
    second.gesture(
        "right", (0.20, 0.24, 0.08 + 0.08 * min(size, 1.2)), high, elbow=(-0.3, 0.8, -0.8)
    )
    second.twist -= 0.15 * energy * high
    swing = window(times, up, hit, hit + 0.15, hit + 0.9)
    second.twist += 0.22 * energy * swing
    second.lean += 0.16 * energy * swing
    second.crouch += 0.03 * energy * swing
    stage.meet(
        ("right", "right"),
        on=beat.touch,
        start=hit - 0.5,
        end=beat.release.end,
        height=-0.40,
        apart=(0.0, 0.0, PALM_TO_PALM),
        elbow=(-0.3, 0.8, -1.0),
    )
    for role in stage.people:
        role.nod += 0.15 * swing


@interaction(ByReach(0.72, room=0.2))
def hand_wrestle(stage: Stage) -> None:
    """Both lock hands at shoulder height and wrestle, pushing each other to and fro."""
    beat = stage.phases(
        approach=0.9, prepare=0.7, hold=3.6, release=0.8, depart=0.7, restless=0.003
    )
    stage.face_to_face(arrive=beat.prepare.at(0.2), travel=(0.2, 0.5))
    times, energy = stage.times, stage.style.energy
    stagger(stage, beat.prepare.at(0.1), beat.release.end, 0.12)
    push = stage.rhythm(beat.hold, 0.45, 0.055) + stage.rhythm(beat.hold, 1.1, 0.015)
    turn = stage.rhythm(beat.hold, 0.6, 0.05)
    on = window(times, beat.prepare.at(0.4), beat.hold.start, beat.hold.end, beat.release.at(0.8))
    lag = round(30 * min(stage.answer(), 0.3))
    for role, sign in zip(stage.people, (1.0, -1.0), strict=True):
        give = np.roll(push, lag) if role is stage.second else push
        role.lean += (0.15 + 1.2 * sign * give) * on * (0.7 + 0.3 * energy)
        role.shift[:, 0] += 0.5 * sign * give
        role.crouch += 0.05 * energy * on
        role.tilt += 1.3 * turn
        role.nod += 0.06 * on
    for (side, other), way in zip(FACING, (1.0, -1.0), strict=True):
        shift = np.column_stack([push + way * 0.5 * turn, 0.4 * turn, way * turn])
        stage.meet(
            (side, other),
            on=beat.hold,
            start=beat.prepare.start,
            end=beat.release.end,
            height=0.0,
            apart=(PALM_TO_PALM, 0.0, 0.0),
            shift=shift,
            elbow=(-0.1, 0.9, -0.9),
        )
