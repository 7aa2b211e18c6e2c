"""Signs across a distance: salute, curtsy, namaste, blown kiss, applause, a pointed finger."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, window
from generator.choreographer.gestures import clap, follow
from generator.choreographer.interaction import interaction
from generator.choreographer.spacing import Apart
from generator.choreographer.stage import Span, Stage
from generator.choreographer.style import SIDES


@interaction(Apart(1.8))
def salute(stage: Stage) -> None:
    """One stands to attention and salutes, hand at the temple; the other returns the salute."""
    beat = stage.phases(
        approach=1.0, prepare=0.6, contact=0.5, hold=1.3, release=0.5, depart=0.7, restless=0.004
    )
    stage.face_to_face(arrive=beat.prepare.at(0.5), travel=(0.2, 0.5))
    late = min(stage.answer(stage.pick(0.25, 0.5)), 0.75 * beat.hold.length)
    for role, delay in zip(stage.people, (0.0, late), strict=True):
        up = beat.contact.start + delay
        off = min(beat.hold.end + 0.5 * delay, beat.end - 0.65)
        straight = rise(stage.times, beat.prepare.start, beat.contact.start)
        weight = window(stage.times, up - 0.25, up + beat.contact.length, off, off + 0.6)
        high = 0.02 + 0.03 * stage.style.amplitude
        role.gesture("right", (0.10, 0.10, high), weight, point="head", elbow=(0.1, 1.0, -0.1))
        role.lean -= 0.05 * stage.style.energy * straight
        role.stance *= 0.8
        role.nod -= 0.06 * weight


@interaction(Apart(1.7))
def curtsy(stage: Stage) -> None:
    """One sinks into a curtsy, skirt held out; the other bows, a hand on the heart."""
    beat = stage.phases(
        approach=1.1, prepare=0.4, contact=0.9, hold=0.5, release=0.9, depart=0.9, restless=0.006
    )
    stage.face_to_face(arrive=beat.prepare.at(0.6), travel=(0.2, 0.5))
    times, size = stage.times, stage.style.amplitude
    first, second = stage.people
    skirt = window(times, beat.prepare.at(0.2), beat.contact.at(0.6), beat.hold.end, beat.end - 0.3)
    down = window(
        times, beat.contact.at(0.1), beat.contact.end, beat.hold.end, beat.release.at(0.9)
    )
    behind = rise(times, beat.prepare.end, beat.prepare.end + 0.3) - rise(
        times, beat.release.end, beat.release.end + 0.3
    )
    first.footing["right"] = np.column_stack([-0.22 * behind, -0.12 * behind, 0.3 * behind])
    first.heels["right"] = 0.55 * down
    first.crouch += 0.15 * min(size, 1.3) * down
    first.nod += 0.35 * down
    first.gaze -= 0.3 * down
    first.lean += 0.12 * down
    for side in SIDES:
        out = 0.34 + 0.08 * size
        first.gesture(side, (0.06, out, -0.36), skirt, elbow=(-0.4, 1.0, -0.2))
    late = min(stage.answer(stage.pick(0.1, 0.4)), 0.8 * beat.depart.length)
    bent = window(
        times,
        beat.contact.start + late,
        beat.contact.end + late,
        beat.hold.end + late,
        beat.release.end + late,
    )
    second.lean += min(stage.pick(0.45, 0.6) * size, 0.9) * bent
    second.gaze -= 0.9 * bent
    second.nod += 0.2 * bent
    hand = rise(times, beat.prepare.end + late, beat.contact.at(0.7) + late)
    hand -= rise(times, beat.release.at(0.5) + late, beat.release.end + late + 0.1)
    second.gesture("right", (0.20, -0.02, 0.05), hand, elbow=(0.2, 1.0, -0.5))
    second.gesture("left", (-0.17, 0.06, -0.22), hand, elbow=(-1.0, 1.0, 0.0))


@interaction(Apart(1.5))
def namaste(stage: Stage) -> None:
    """Both press their palms together before the chest and incline the head."""
    beat = stage.phases(
        approach=1.0, prepare=0.7, contact=0.7, hold=0.7, release=0.7, depart=0.9, restless=0.008
    )
    stage.face_to_face(arrive=beat.prepare.at(0.4), travel=(0.15, 0.45))
    late = min(stage.answer(stage.pick(0.0, 0.3)), 0.8 * beat.depart.length)
    for role, delay in zip(stage.people, (0.0, late), strict=True):
        start = beat.prepare.start + delay
        folded = window(
            stage.times,
            start,
            start + beat.prepare.length,
            beat.release.at(0.6) + delay,
            min(beat.release.at(0.6) + delay + 0.8, beat.end - 0.05),
        )
        bent = window(
            stage.times,
            beat.contact.start + delay,
            beat.contact.end + delay,
            beat.hold.end + delay,
            beat.release.end + delay,
        )
        for side in SIDES:
            role.gesture(side, (0.21, 0.031, 0.12), folded, elbow=(-0.2, 1.0, -0.8))
        role.lean += stage.pick(0.16, 0.24) * stage.style.amplitude * bent
        role.nod += 0.30 * bent
        role.gaze -= 0.5 * bent


@interaction(Apart(1.8))
def blow_kiss(stage: Stage) -> None:
    """One blows a kiss from the lips; the other catches it in the air and takes it to the heart."""
    beat = stage.phases(
        approach=0.6, prepare=0.8, contact=0.5, hold=1.0, release=0.9, depart=1.2, restless=0.012
    )
    stage.face_to_face(arrive=beat.prepare.start, travel=(0.0, 0.25))
    times, size = stage.times, stage.style.amplitude
    first, second = stage.people
    on = window(times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.end)
    lips, away = (0.15, 0.01, -0.05), (0.34, 0.14 + 0.14 * size, -0.02 + 0.04 * size)
    knots = [(beat.contact.at(0.3), lips), (beat.hold.at(0.5), away)]
    follow(stage, first, "right", knots, on, point="head", elbow=(0.0, 0.8, -0.8))
    blow = window(times, beat.contact.at(0.2), beat.contact.end, beat.hold.start, beat.hold.end)
    first.lean += 0.08 * size * blow
    first.nod -= 0.10 * blow
    first.tilt += 0.05 * blow
    late = min(stage.answer(stage.pick(0.0, 0.2)), 0.5 / stage.style.speed)
    catch = beat.hold.at(0.6) + late
    home = min(catch + 0.9 / stage.style.speed, beat.depart.at(0.35))
    hand = window(times, catch - 0.7 / stage.style.speed, catch, home + 0.4, beat.end)
    knots = [(catch + 0.1, (0.42, 0.16, 0.20 + 0.08 * size)), (home, (0.20, -0.02, 0.06))]
    follow(stage, second, "right", knots, hand, elbow=(0.2, 1.0, -0.5))
    melt = window(times, catch + 0.3, home, home + 0.4, beat.end)
    second.tilt += 0.10 * stage.style.energy * melt
    second.nod += 0.08 * melt


@interaction(Apart(1.9))
def applaud(stage: Stage) -> None:
    """One claps the hands in applause; the other, arms spread, takes a bow."""
    beat = stage.phases(
        approach=0.6, prepare=0.7, hold=2.6, release=0.8, depart=0.8, restless=0.012
    )
    stage.face_to_face(arrive=beat.prepare.start, travel=(0.0, 0.3))
    times, size = stage.times, stage.style.amplitude
    first, second = stage.people
    clap(stage, first, beat.hold, beat.prepare.start, beat.release.end, 0.06)
    first.nod += (
        0.05
        * np.sin(2 * np.pi * 0.8 * times)
        * window(times, beat.hold.start, beat.hold.at(0.1), beat.hold.at(0.9), beat.hold.end)
    )
    bow = beat.hold.at(0.08) + min(stage.answer(), 0.5 / stage.style.speed)
    down = window(times, bow, bow + 0.35 * beat.hold.length, beat.hold.at(0.68), beat.release.end)
    second.lean += min(stage.pick(0.55, 0.7) * size, 0.95) * down
    second.gaze -= 0.9 * down
    second.nod += 0.15 * down
    spread = window(times, bow - 0.4, bow + 0.3, beat.hold.at(0.7), beat.release.end)
    for side in SIDES:
        second.gesture(side, (0.16, 0.40 + 0.08 * size, -0.14), spread, elbow=(-0.6, 0.8, -0.8))


@interaction(Apart(1.35))
def point(stage: Stage) -> None:
    """One points an outstretched arm at the other, who starts back with raised palms."""
    beat = stage.phases(
        approach=0.9, prepare=0.6, contact=0.3, hold=1.5, release=0.8, depart=0.8, restless=0.012
    )
    stage.face_to_face(arrive=beat.prepare.at(0.4), travel=(0.2, 0.5))
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    first, second = stage.people
    up = window(times, beat.prepare.at(0.3), beat.contact.end, beat.hold.end, beat.release.end)
    jab = stage.rhythm(beat.hold, 1.4, 0.025)
    arm = np.column_stack([0.50 + jab, np.full(len(jab), 0.10), 0.15 + 0.5 * jab])
    first.gesture("right", arm, up, elbow=(-0.1, 0.5, -1.0))
    first.twist += 0.22 * up
    first.lean += 0.10 * energy * up
    first.path[:, 0] += 0.10 * rise(times, beat.prepare.start, beat.contact.end)
    start = beat.contact.start + min(stage.answer(stage.pick(0.1, 0.25)), 0.8 / stage.style.speed)
    far = min(stage.pick(0.2, 0.35) * energy, 0.45)
    second.path[:, 0] += far * rise(times, start, start + 1.0 / min(stage.style.speed, 1.2))
    hands = window(times, start - 0.1, start + 0.45, beat.hold.end, beat.depart.at(0.4))
    for side in SIDES:
        high = 0.06 + 0.06 * size
        second.gesture(side, (0.27, 0.16, high), hands, elbow=(-0.4, 0.7, -1.0))
    second.lean -= 0.10 * energy * hands
    shake = Span(start + 0.4, beat.hold.end)
    second.heading += stage.rhythm(shake, 1.0, 0.03) if shake.length > 0.6 else 0.0
