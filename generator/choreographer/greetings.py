"""Greetings and signs: handshake, high five, fist bump, wave, bow, beckon."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, window
from generator.choreographer.interaction import interaction
from generator.choreographer.spacing import Apart, ByReach
from generator.choreographer.stage import PALM_TO_PALM, Stage


@interaction(ByReach(0.84))
def handshake(stage: Stage) -> None:
    """Both walk up, clasp right hands and shake them."""
    beat = stage.phases(approach=1.4, prepare=0.5, contact=0.15, hold=1.3, release=0.7, depart=0.9)
    stage.face_to_face(arrive=beat.prepare.at(0.4))
    shift = np.zeros((len(stage.times), 3))
    shift[:, 2] = stage.rhythm(beat.hold, 2.2, stage.pick(0.025, 0.04))
    start, end = beat.approach.at(0.7), beat.release.end
    stage.meet(
        ("right", "right"),
        on=beat.touch,
        start=start,
        end=end,
        height=-0.34 + stage.pick(-0.03, 0.03),
        apart=(0.0, PALM_TO_PALM, 0.0),
        shift=shift,
        elbow=(-0.5, 0.35, -1.0),
    )
    engaged = window(stage.times, start, beat.touch.start, beat.touch.end, end)
    for role in stage.people:
        role.twist += 0.12 * engaged
        role.lean += stage.pick(0.03, 0.08) * engaged


@interaction(ByReach(0.76))
def high_five(stage: Stage) -> None:
    """Both raise the right hand and clap it against the other's, above the shoulders."""
    beat = stage.phases(approach=1.4, prepare=0.5, contact=0.12, hold=0.12, release=0.7, depart=1.0)
    stage.face_to_face(arrive=beat.prepare.at(0.4))
    start, end = beat.approach.at(0.72), beat.depart.at(0.35)
    stage.meet(
        ("right", "right"),
        on=beat.touch,
        start=start,
        end=end,
        height=0.20 * stage.style.amplitude,
        apart=(PALM_TO_PALM, 0.0, 0.0),
        elbow=(0.0, 0.55, -1.0),
    )
    engaged = window(stage.times, start, beat.touch.start, beat.touch.end, end)
    for role in stage.people:
        role.twist += 0.18 * engaged
        role.lean += 0.04 * stage.style.energy * engaged


@interaction(ByReach(0.84))
def fist_bump(stage: Stage) -> None:
    """Both hold out the right fist and knock the knuckles together."""
    beat = stage.phases(approach=1.3, prepare=0.5, contact=0.12, hold=0.15, release=0.7, depart=1.0)
    stage.face_to_face(arrive=beat.prepare.at(0.4))
    start, end = beat.approach.at(0.75), beat.release.end
    stage.meet(
        ("right", "right"),
        on=beat.touch,
        start=start,
        end=end,
        height=-0.14 + stage.pick(-0.03, 0.03),
        apart=(PALM_TO_PALM, 0.0, 0.0),
        elbow=(-0.3, 0.6, -1.0),
    )
    engaged = window(stage.times, start, beat.touch.start, beat.touch.end, end)
    for role in stage.people:
        role.twist += 0.15 * engaged


@interaction(Apart(1.9))
def wave(stage: Stage) -> None:
    """One raises the right arm and waves; the other waves back."""
    beat = stage.phases(approach=0.9, prepare=0.6, hold=2.2, release=0.8, depart=0.5)
    stage.face_to_face(arrive=beat.approach.end + 0.3, travel=(0.1, 0.4))
    room = 0.4 * beat.hold.length
    delays = (0.0, min(stage.answer(stage.pick(0.1, 0.5)), room))
    for role, delay in zip(stage.people, delays, strict=True):
        on = beat.hold
        swing = np.roll(stage.rhythm(on, stage.pick(1.4, 1.9), 0.11), round(delay * 30))
        offset = np.zeros((len(stage.times), 3))
        offset[:, 0] = 0.20
        offset[:, 1] = 0.32 + swing
        offset[:, 2] = 0.34 + 0.06 * stage.style.amplitude - 0.25 * np.abs(swing)
        up = beat.prepare.start + delay
        weight = window(stage.times, up, up + beat.prepare.length, on.end, beat.depart.end - 0.1)
        role.gesture("right", offset, weight, elbow=(-0.1, 0.7, -1.0))


@interaction(Apart(1.7))
def bow(stage: Stage) -> None:
    """Both bend the trunk forward and rise again, one a little after the other."""
    beat = stage.phases(approach=1.1, prepare=0.4, contact=0.9, hold=0.5, release=0.9, depart=0.8)
    stage.face_to_face(arrive=beat.prepare.end, travel=(0.2, 0.5))
    depth = min(stage.pick(0.6, 0.8) * stage.style.amplitude, 1.05)
    for role, delay in zip(stage.people, (0.0, stage.answer(stage.pick(0.0, 0.2))), strict=True):
        delay = min(delay, 0.9 * beat.depart.length)
        on = window(
            stage.times,
            beat.contact.start + delay,
            beat.contact.end + delay,
            beat.release.start + delay,
            beat.release.end + delay,
        )
        role.lean += depth * on
        role.gaze -= on
        role.nod += 0.25 * on


@interaction(Apart(1.0))
def beckon(stage: Stage) -> None:
    """One waves the other to come nearer, and the other comes."""
    beat = stage.phases(approach=0.4, prepare=0.6, hold=1.8, release=0.7, depart=1.2)
    stage.face_to_face(arrive=beat.approach.end, travel=(0.0, 0.0))
    leave = beat.hold.at(0.4) + stage.answer()
    arrive = beat.end - 0.5
    far = min(stage.pick(0.8, 1.1), 1.15 * (arrive - leave) / 1.875)
    stage.second.path[:, 0] += far * (1.0 - rise(stage.times, leave, arrive))
    pull = stage.rhythm(beat.hold, 1.3, 0.5) + 0.5
    offset = np.column_stack([0.40 - 0.16 * pull, np.full(len(pull), 0.20), 0.08 + 0.18 * pull])
    weight = window(
        stage.times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.end
    )
    stage.first.gesture("right", offset, weight, elbow=(-0.3, 0.4, -1.0))
    stage.first.lean += 0.05 * weight
