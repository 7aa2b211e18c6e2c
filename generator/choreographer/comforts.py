"""Kindness: a pat on the shoulder, comfort, a pat on the head, a massage, kisses on both cheeks."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, window
from generator.choreographer.formations import in_file, side_by_side
from generator.choreographer.gestures import circling, nod_along, pat
from generator.choreographer.interaction import interaction
from generator.choreographer.role import outward
from generator.choreographer.spacing import ByReach, ByTouch
from generator.choreographer.stage import Span, Stage
from generator.choreographer.style import SIDES, Side


@interaction(ByReach(0.80))
def pat_shoulder(stage: Stage) -> None:
    """One claps the other on the shoulder a few times, in praise."""
    beat = stage.phases(
        approach=1.3, prepare=0.6, hold=1.3, release=0.7, depart=0.9, restless=0.010
    )
    stage.face_to_face(arrive=beat.prepare.at(0.4), travel=(0.3, 0.6))
    first, second = stage.people
    energy = stage.style.energy
    apart = 0.38 / min(0.8 * stage.style.speed + 0.2, 1.1)
    moments = [beat.hold.start + apart * i for i in range(3)]
    pat(
        stage,
        first,
        "right",
        "left_collar",
        (0.03, 0.07, 0.11),
        moments=moments,
        start=beat.approach.at(0.8),
        end=moments[-1] + 1.0,
        lift=(0.02, 0.03, 0.05 + 0.04 * stage.style.amplitude),
        elbow=(-0.2, 0.7, -1.0),
    )
    on = window(
        stage.times, beat.prepare.start, beat.hold.start, beat.hold.end, beat.release.end + 0.3
    )
    first.twist += 0.15 * on
    first.lean += 0.06 * on
    late = min(stage.answer(), 0.6)
    for moment in moments:
        dip = window(stage.times, moment + 0.02, moment + 0.14, moment + 0.14, moment + 0.34)
        second.crouch += 0.012 * energy * dip
        second.lean += 0.02 * energy * dip
    nod_along(stage, first, Span(beat.hold.start, beat.hold.end))
    nod_along(stage, second, Span(beat.hold.at(0.3) + late, beat.release.end + 0.3))


@interaction(ByReach(0.84, room=0.05))
def comfort(stage: Stage) -> None:
    """One, head bowed, hides the face in the hands; the other comes and strokes the back."""
    beat = stage.phases(
        approach=1.3, prepare=0.7, contact=0.4, hold=2.4, release=0.8, depart=1.1, restless=0.006
    )
    side_by_side(stage, arrive=beat.prepare.at(0.4), travel=(0.3, 0.6), turned=(0.75, 0.0))
    times, size = stage.times, stage.style.amplitude
    first, second = stage.people
    first.path[:, 0] -= 0.20 * stage.scale
    grief = 1.0 - 0.75 * rise(times, beat.release.start, beat.depart.at(0.7))
    sob = np.abs(stage.rhythm(Span(0.4, beat.hold.end), 0.9, 0.012)) * stage.style.energy
    hide = 1.0 - rise(times, beat.release.at(0.3), beat.depart.at(0.6))
    second.lean += 0.24 * grief + sob
    second.nod += 0.35 * grief
    second.gaze = 0.9 * (1.0 - grief)
    lap = 1.0 - rise(times, beat.depart.at(0.5), beat.end + 0.3)
    for side in SIDES:
        second.gesture(side, (0.28, 0.06, -0.16), lap, elbow=(-0.5, 0.5, -1.0))
        second.gesture(side, (0.125, 0.045, -0.01), hide, point="head", elbow=(0.0, 0.5, -1.0))
    on = Span(beat.contact.end, beat.hold.end)
    stage.lay_on(
        first,
        "right",
        "spine3",
        circling(stage, on, (-0.135, 0.03, 0.0), 0.055, 0.7),
        on=on,
        start=beat.approach.at(0.85),
        end=beat.release.end,
        elbow=(-0.3, 0.9, -0.6),
    )
    near = window(times, beat.prepare.start, beat.contact.end, beat.hold.end, beat.depart.at(0.4))
    first.lean += 0.10 * near
    first.tilt += 0.07 * size * near
    first.nod += 0.10 * near
    first.gesture("left", (0.24, 0.06, -0.12), near, elbow=(-0.4, 0.8, -0.8))
    nod_along(stage, second, Span(beat.release.start + stage.answer(), beat.depart.end), 2)


@interaction(ByReach(0.76))
def pat_head(stage: Stage) -> None:
    """One pats the other fondly on the head."""
    beat = stage.phases(
        approach=1.3, prepare=0.6, hold=1.5, release=0.7, depart=0.8, restless=0.010
    )
    stage.face_to_face(arrive=beat.prepare.at(0.4), travel=(0.3, 0.6))
    times = stage.times
    first, second = stage.people
    ratio = stage.builds[0].scale / stage.builds[1].scale
    apart = 0.42 / min(0.8 * stage.style.speed + 0.2, 1.1)
    moments = [beat.hold.start + apart * i for i in range(3)]
    down = window(times, beat.prepare.start, beat.hold.start, beat.hold.end, beat.release.end)
    late = min(stage.answer(), 0.4)
    bow = window(
        times, beat.prepare.at(0.3), beat.hold.start, beat.hold.end, beat.release.end + late
    )
    second.nod += 0.22 * bow
    second.gaze -= 0.3 * bow
    second.lean += (0.08 + 0.5 * max(1.0 / ratio - 1.0, 0.0)) * bow
    second.crouch += (0.05 + 0.4 * max(1.0 / ratio - 1.0, 0.0)) * bow
    second.tilt += stage.rhythm(Span(beat.hold.start, beat.release.end), 0.7, 0.03)
    first.lean += (0.06 + 0.5 * max(ratio - 1.0, 0.0)) * down
    first.tilt -= 0.05 * down
    pat(
        stage,
        first,
        "right",
        "head",
        (0.06, 0.0, 0.145),
        moments=moments,
        start=beat.approach.at(0.8),
        end=moments[-1] + 1.1,
        lift=(0.01, 0.0, 0.03 + 0.03 * stage.style.amplitude),
        elbow=(0.0, 1.0, 0.0),
    )


@interaction(ByReach(0.68, room=0.06), overlap=0.02)
def shoulder_massage(stage: Stage) -> None:
    """One stands behind the other and kneads both shoulders."""
    beat = stage.phases(
        approach=1.2, prepare=0.7, contact=0.3, hold=3.0, release=0.8, depart=0.7, restless=0.012
    )
    in_file(stage, arrive=beat.prepare.at(0.3), travel=(0.2, 0.5))
    times, energy = stage.times, stage.style.energy
    first, second = stage.people
    on = Span(beat.contact.end, beat.hold.end)
    knead = stage.rhythm(on, 1.5, 0.03)
    for side in SIDES:
        sign = outward(side)
        offset = np.array([-0.06, 0.02 * sign, 0.11])
        places = offset + np.column_stack([knead * sign, 0.0 * knead, 0.4 * knead * sign])
        places *= (np.linalg.norm(offset) / np.linalg.norm(places, axis=1))[:, None]
        stage.lay_on(
            first,
            side,
            f"{side}_collar",
            places,
            on=on,
            start=beat.approach.at(0.85),
            end=beat.release.end,
            elbow=(-0.2, 1.0, -0.45),
        )
    near = window(times, beat.prepare.start, on.start, on.end, beat.release.end)
    first.lean += 0.07 * near + 0.3 * np.abs(knead) * energy
    first.crouch += 0.15 * np.abs(knead) * energy
    late = min(stage.answer(stage.pick(0.1, 0.4)), 1.0)
    bliss = window(times, on.start + late, on.start + late + 0.8, on.end, beat.release.end)
    second.gaze = 0.0 * times
    second.nod += 0.22 * bliss
    second.tilt += stage.rhythm(Span(on.start + late, beat.release.end), 0.35, 0.07)
    second.lean += 0.8 * np.abs(knead) * energy
    thanks = rise(times, beat.release.start, beat.release.end)
    second.gaze += 0.8 * thanks


@interaction(ByTouch(0.025), overlap=0.02)
def cheek_kiss(stage: Stage) -> None:
    """Both, hands on each other's arms, kiss on one cheek and then on the other."""
    beat = stage.phases(
        approach=1.3, prepare=0.6, contact=0.5, hold=1.2, release=0.8, depart=1.0, restless=0.004
    )
    stage.face_to_face(arrive=beat.prepare.at(0.3), travel=(0.3, 0.6))
    stage.step_back(beat.depart, far=0.3)
    times, size = stage.times, stage.style.amplitude
    half = 0.5 * beat.hold.length
    kisses = (beat.hold.start + 0.1, beat.hold.start + 0.1 + half)
    near = window(times, beat.prepare.start, beat.hold.start, beat.hold.end, beat.release.end)
    for role in stage.people:
        ratio = role.build.scale / stage.scale
        role.lean += (0.10 + 0.9 * max(ratio - 1.0, 0.0)) * near
        for moment, sign in zip(kisses, (1.0, -1.0), strict=True):
            reach = window(times, moment - 0.42, moment, moment + 0.1, moment + 0.45)
            role.shift[:, 0] += 0.03 * reach
            role.shift[:, 1] += 0.05 * sign * reach
            role.tilt -= 0.10 * sign * reach
            role.twist += 0.10 * sign * size * reach
            role.lean += 0.08 * reach
        role.gaze -= 0.8 * near
        for side in SIDES:  # one's arms over, the other's under, or they would cross
            out = -outward(side)
            over = (role is stage.first) == (stage.builds[0].scale >= stage.builds[1].scale)
            point = f"{_other(side)}_collar" if over else "spine1"
            stage.lay_on(
                role,
                side,
                point,
                (0.02, 0.09 * out, 0.10) if over else (0.06, 0.15 * out, -0.02),
                on=Span(beat.contact.end, beat.hold.end),
                start=beat.prepare.start,
                end=beat.release.end,
                elbow=(-0.1, 1.0, -0.1) if over else (-0.8, 0.4, -1.0),
            )


def _other(side: Side) -> Side:
    return "right" if side == "left" else "left"
