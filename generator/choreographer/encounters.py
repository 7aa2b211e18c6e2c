"""Close encounters: hug, push, boxing, handing over an object."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, window
from generator.choreographer.interaction import interaction
from generator.choreographer.role import outward
from generator.choreographer.spacing import ByReach, ByTouch
from generator.choreographer.stage import PALM_TO_PALM, Span, Stage
from generator.choreographer.style import FACING, SIDES, Side

BOX_DEPTH = 0.12
"""Depth of the object that is handed over, m; hands hold it by its sides."""
BOX_HALF_WIDTH = 0.13


@interaction(ByTouch(-0.005), overlap=0.03)
def hug(stage: Stage) -> None:
    """Both open their arms, embrace and hold each other, one arm over and one under."""
    beat = stage.phases(approach=1.3, prepare=0.6, contact=0.8, hold=1.4, release=0.9, depart=1.2)
    stage.face_to_face(arrive=beat.prepare.at(0.4))
    stage.step_back(beat.depart, far=0.3)
    held = beat.hold
    on = window(stage.times, beat.prepare.start, held.start, held.end, beat.depart.at(0.6))
    opening = window(
        stage.times,
        beat.approach.at(0.5),
        beat.prepare.end,
        beat.release.at(0.6),
        beat.depart.at(0.8),
    )
    sizes = [build.scale for build in stage.builds]
    for role, ahead, taller in zip(
        stage.people, (1.0, -1.0), (sizes[0] / sizes[1], sizes[1] / sizes[0]), strict=True
    ):
        role.path[:, 1] += 0.05 * stage.scale * ahead
        role.lean += 0.16 * on
        role.tilt -= 0.08 * on
        role.gaze -= 0.9 * on
        # Right over, left under; if sizes differ, the tall one's arms over, the other's under.
        over = {"right": taller > 0.95, "left": taller > 1.05}
        for side in SIDES:
            height = 0.30 if over[side] else -0.24
            role.gesture(side, (0.32, 0.42, height), opening, elbow=(-0.2, 1.0, -0.2))
            out = -outward(side)  # on the same side of the stage, hence the partner's other side
            if over[side]:
                point, offset, elbow = "spine3", (-0.12, 0.08 * out, 0.18), (0.0, 1.0, 0.4)
            elif taller > 0.95:
                point, offset, elbow = "spine2", (-0.12, 0.11 * out, -0.05), (0.0, 0.7, -1.0)
            else:
                point, offset, elbow = "spine1", (-0.10, 0.14 * out, 0.0), (0.0, 0.7, -1.0)
            stage.lay_on(
                role,
                side,
                point,
                offset,
                on=held,
                start=beat.prepare.at(0.8),
                end=beat.depart.at(0.3),
                elbow=elbow,
            )


@interaction(ByReach(0.80))
def push(stage: Stage) -> None:
    """One puts both hands on the other's chest and pushes; the other gives way backwards."""
    beat = stage.phases(approach=1.2, prepare=0.6, contact=0.15, hold=0.15, release=0.8, depart=1.3)
    stage.face_to_face(arrive=beat.prepare.at(0.7))
    first, second = stage.people
    hands = window(
        stage.times, beat.prepare.start, beat.contact.start, beat.hold.end, beat.release.end
    )
    for side in SIDES:
        stage.lay_on(
            first,
            side,
            "spine3",
            (0.15, -0.10 * outward(side), 0.04),
            on=beat.touch,
            start=beat.approach.at(0.85),
            end=beat.release.end,
            elbow=(-0.3, 0.7, -1.0),
        )
    first.lean += 0.14 * stage.style.energy * hands
    first.path[:, 0] += 0.06 * hands
    blow = beat.contact.at(0.5)
    far = min(stage.pick(0.35, 0.55) * stage.style.energy, 0.6)
    second.path[:, 0] += far * rise(stage.times, blow, blow + 1.2)
    recoil = window(stage.times, blow, blow + 0.35, blow + 0.5, blow + 1.3)
    second.lean -= 0.16 * stage.style.energy * recoil
    for side in SIDES:
        second.gesture(side, (0.25, 0.42, -0.05), recoil, elbow=(-0.6, 0.8, -0.6))


@interaction(ByReach(0.86))
def box(stage: Stage) -> None:
    """Both keep up their guard, trade straight punches and catch them with the glove."""
    beat = stage.phases(approach=1.0, prepare=0.6, hold=3.4, release=0.8, depart=0.4)
    stage.face_to_face(arrive=beat.prepare.at(0.4), travel=(0.2, 0.4))
    times = stage.times
    guard = window(
        times, beat.approach.at(0.3), beat.prepare.at(0.5), beat.release.start, beat.end - 0.1
    )
    for role in stage.people:
        role.heading -= 0.35 * rise(times, beat.approach.start, beat.prepare.end)
        role.twist += 0.15 * guard
        role.crouch += 0.035 * stage.style.energy * guard
        role.lean += 0.08 * guard
        bounce = np.sin(2 * np.pi * 1.4 * times + stage.pick(0.0, 6.3))
        role.crouch += 0.008 * stage.style.energy * guard * (1 + bounce)
        role.gesture("left", (0.30, 0.10, 0.20), guard, elbow=(-0.1, 0.5, -1.0))
        role.gesture("right", (0.22, 0.08, 0.20), guard, elbow=(-0.2, 0.6, -1.0))
    moment = beat.hold.start + 0.35
    while moment < beat.hold.end - 0.2:
        _punch(stage, moment)
        moment += stage.pick(0.55, 0.75) / stage.style.speed


def _punch(stage: Stage, moment: float) -> None:
    """Let one strike straight and the other catch the blow with the hand opposite."""
    times = stage.times
    striker = int(stage.rng.random() < 0.5)
    side: Side = "left" if stage.rng.random() < 0.5 else "right"
    other: Side = "right" if side == "left" else "left"
    shift = np.zeros((len(times), 3))
    shift[:, 0] = 0.10 if striker == 0 else -0.10
    sides = (side, other) if striker == 0 else (other, side)
    stage.meet(
        sides,
        on=Span(moment, moment + 0.07),
        start=moment - 0.30,
        end=moment + 0.42,
        height=0.04,
        apart=(PALM_TO_PALM + 0.01, 0.0, 0.0),
        shift=shift,
        elbow=(-0.1, 0.6, -1.0),
    )
    on = window(times, moment - 0.25, moment, moment + 0.07, moment + 0.4)
    stage.people[striker].twist -= 0.28 * outward(side) * on


@interaction(ByReach(0.82))
def pass_object(stage: Stage) -> None:
    """One carries something in both hands and gives it to the other, who takes it."""
    beat = stage.phases(approach=1.5, prepare=0.6, contact=0.2, hold=0.6, release=0.9, depart=1.0)
    stage.face_to_face(arrive=beat.prepare.at(0.4))
    first, second = stage.people
    times = stage.times
    carry = (0.30, BOX_HALF_WIDTH, -0.14)
    has_it = 1.0 - rise(times, beat.hold.start, beat.release.start)
    for side in SIDES:
        first.gesture(side, carry, has_it, elbow=(-0.5, 0.5, -1.0))
        second.gesture(side, carry, 1.0 - has_it, elbow=(-0.5, 0.5, -1.0))
    for side, other in FACING:
        shift = np.zeros((len(times), 3))
        shift[:, 1] = outward(side) * (BOX_HALF_WIDTH - 0.18) / stage.scale
        stage.meet(
            (side, other),
            on=beat.touch,
            start=beat.approach.at(0.75),
            end=beat.release.end,
            height=-0.28,
            apart=(BOX_DEPTH, 0.0, 0.0),
            shift=shift,
            elbow=(-0.5, 0.5, -1.0),
        )
    offer = window(
        times, beat.approach.at(0.75), beat.touch.start, beat.touch.end, beat.release.end
    )
    for role in stage.people:
        role.lean += stage.pick(0.04, 0.09) * offer
        role.nod += 0.15 * offer
