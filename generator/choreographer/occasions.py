"""Occasions: a toast, a proposal, a photograph."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, through, window
from generator.choreographer.gestures import follow, hand_on_hip
from generator.choreographer.interaction import interaction
from generator.choreographer.role import Role
from generator.choreographer.spacing import Apart, ByReach
from generator.choreographer.stage import PALM_TO_PALM, Span, Stage
from generator.choreographer.style import SIDES

CLINK = 0.12
"""Distance of two hands whose glasses touch, m."""


@interaction(ByReach(0.82, room=0.3))
def toast(stage: Stage) -> None:
    """Both raise a glass, clink and drink."""
    beat = stage.phases(
        approach=1.1, prepare=0.7, contact=0.12, hold=0.2, release=2.6, depart=0.7, restless=0.012
    )
    stage.face_to_face(arrive=beat.prepare.at(0.3), travel=(0.2, 0.5))
    times, size = stage.times, stage.style.amplitude
    late = min(0.5 * stage.answer(), 0.3)
    hold = window(times, 0.1, 0.7, beat.depart.at(0.1), beat.end)
    sip = Span(beat.release.at(0.30), beat.release.at(0.72))
    for role, delay in zip(stage.people, (0.0, late), strict=True):
        role.gesture("right", (0.27, 0.10, -0.06), hold, elbow=(-0.4, 0.4, -1.0))
        drink = window(
            times,
            beat.release.at(0.08) + delay,
            sip.start + delay,
            sip.end + delay,
            beat.release.end + delay,
        )
        tilt = window(
            times,
            sip.start + delay - 0.1,
            sip.start + delay + 0.3,
            sip.end + delay - 0.2,
            sip.end + delay + 0.2,
        )
        role.nod -= (0.18 + 0.10 * size) * tilt
        role.gaze -= 0.4 * tilt
        role.lean -= 0.04 * stage.style.energy * tilt
        role.gesture("right", (0.155, 0.03, -0.045), drink, point="head", elbow=(0.0, 1.0, -0.5))
        nod = window(
            times, beat.hold.end, beat.hold.end + 0.2, beat.hold.end + 0.2, beat.hold.end + 0.5
        )
        role.nod += 0.10 * nod
    stage.meet(
        ("right", "right"),
        on=beat.touch,
        start=beat.approach.at(0.7),
        end=beat.release.at(0.28),
        height=-0.04 + 0.05 * size,
        apart=(CLINK, 0.0, 0.0),
        elbow=(-0.3, 0.5, -1.0),
    )
    offer = window(
        times, beat.prepare.start, beat.touch.start, beat.touch.end, beat.release.at(0.3)
    )
    for role in stage.people:
        role.lean += 0.05 * stage.style.energy * offer
        role.twist += 0.12 * offer


@interaction(ByReach(0.84, room=0.12))
def propose(stage: Stage) -> None:
    """One goes down on one knee with a ring; the other, hands at the mouth, gives a hand."""
    beat = stage.phases(
        approach=0.6, prepare=1.5, contact=1.3, hold=1.5, release=0.8, depart=1.0, restless=0.003
    )
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    stage.face_to_face(arrive=beat.approach.end, travel=(0.0, 0.15))
    first, second = stage.people
    step = rise(times, beat.prepare.start, beat.prepare.at(0.2)) - rise(
        times, beat.depart.at(0.25), beat.depart.at(0.5)
    )
    down = window(
        times, beat.prepare.at(0.40), beat.prepare.end + 0.25, beat.hold.end, beat.depart.at(0.45)
    )
    _kneel(first, step, down)
    first.nod -= 0.05 * down
    ring = window(
        times, beat.prepare.at(0.7), beat.contact.at(0.3), beat.contact.at(0.6), beat.contact.end
    )
    high = 0.02 + 0.06 * size
    first.gesture("right", (0.34, 0.03, high), ring, elbow=(-0.3, 0.5, -1.0))
    rest = window(
        times, beat.prepare.at(0.6), beat.contact.at(0.2), beat.hold.end, beat.depart.at(0.2)
    )
    first.gesture("left", (0.32, 0.04, high - 0.05), rest, elbow=(-0.3, 0.5, -1.0))
    late = min(0.5 * stage.answer(), 0.3)
    gasp = window(
        times,
        beat.prepare.at(0.85) + late,
        beat.contact.at(0.3) + late,
        beat.contact.at(0.55),
        beat.contact.end,
    )
    keep = window(
        times,
        beat.prepare.at(0.85) + late,
        beat.contact.at(0.3) + late,
        beat.hold.at(0.6),
        beat.release.end,
    )
    second.gesture("left", (0.13, 0.02, -0.05), gasp, point="head", elbow=(0.0, 0.6, -1.0))
    second.gesture("right", (0.13, 0.02, -0.05), keep, point="head", elbow=(0.0, 0.6, -1.0))
    second.lean += (0.06 + 0.10 * down) * down
    second.lean -= 0.08 * energy * gasp
    second.nod += 0.10 * down
    second.tilt += 0.07 * stage.style.amplitude * keep
    shift = np.zeros((len(times), 3))
    shift[:, 1] = -0.04
    stage.meet(
        ("right", "left"),
        on=Span(beat.contact.end, beat.hold.end),
        start=beat.contact.at(0.45),
        end=beat.release.at(0.6),
        height=-0.14,
        apart=(0.0, 0.0, PALM_TO_PALM),
        shift=shift,
        elbow=(-0.4, 0.5, -1.0),
    )


def _kneel(role: Role, step: np.ndarray, down: np.ndarray) -> None:
    """Let somebody kneel on the right knee: a step back, then the knee sinks to the floor."""
    nothing = np.zeros(len(step))
    role.footing["right"] = np.column_stack([-0.46 * step, nothing, -0.10 * step])
    role.footing["left"] = np.column_stack([0.12 * step, 0.02 * step, nothing])
    role.heels["right"] = 0.95 * down
    role.crouch += 0.28 * role.build.scale * down
    role.shift[:, 0] -= 0.12 * down
    role.lean += 0.06 * down


@interaction(Apart(2.0, least=1.7))
def photograph(stage: Stage) -> None:
    """One holds up a camera and takes photographs of the other, who strikes poses."""
    beat = stage.phases(
        approach=0.5, prepare=0.8, hold=3.8, release=0.9, depart=0.6, restless=0.008
    )
    stage.face_to_face(arrive=beat.approach.end + 0.2, travel=(0.0, 0.3))
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    first, second = stage.people
    eye = window(times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.end)
    for side in SIDES:
        first.gesture(side, (0.155, 0.065, 0.01), eye, point="head", elbow=(0.0, 0.7, -0.9))
    first.crouch += through(
        times,
        [
            (beat.prepare.end, 0.02),
            (beat.hold.at(0.35), 0.02),
            (beat.hold.at(0.6), 0.02 + 0.16 * energy),
            (beat.hold.end, 0.02 + 0.16 * energy),
            (beat.release.end, 0.0),
        ],
    )
    first.lean += 0.08 * eye
    first.tilt += stage.rhythm(beat.hold, 0.4, 0.05)
    late = min(stage.answer(), 0.4)
    change = beat.hold.at(0.48) + late
    start = beat.prepare.at(0.2) + late
    one = window(times, start - 0.15, start + 0.8, change - 0.4, change + 0.5)
    two = window(times, change - 0.25, change + 0.45, beat.hold.end, beat.release.end)
    hand_on_hip(second, "right", one)
    follow(
        stage,
        second,
        "left",
        [(0.0, (0.08, 0.09, 0.06))],
        one,
        point="head",
        elbow=(-0.1, 1.0, 0.1),
    )
    for side in SIDES:
        up = (0.06, 0.36 + 0.05 * size, 0.34 + 0.08 * size)
        second.gesture(side, up, two, elbow=(-0.1, 1.0, -0.2))
    second.tilt += 0.10 * size * (one - two * 0.6)
    second.heading += 0.35 * one - 0.15 * two
    second.shift[:, 1] += 0.04 * one
    second.lean -= 0.05 * two
    second.gaze = np.clip(second.gaze + 0.3 * (one + two), 0.0, 1.0)
