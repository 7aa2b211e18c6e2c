"""Martial arts: a kick that is dodged, a hook that is ducked, fencing."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, through, window
from generator.choreographer.gestures import follow
from generator.choreographer.interaction import interaction
from generator.choreographer.role import Kick, Role
from generator.choreographer.spacing import Apart
from generator.choreographer.stage import Phases, Stage
from generator.choreographer.style import SIDES
from robots.skeleton import FloatArray


def _guard(stage: Stage, role: Role, beat: Phases) -> FloatArray:
    """Put up the fists from the middle of preparation until the release; return how far up."""
    times, energy = stage.times, stage.style.energy
    on = window(
        times, beat.prepare.start, beat.prepare.end, beat.release.at(0.3), beat.depart.at(0.4)
    )
    for side, ahead in zip(SIDES, (0.30, 0.23), strict=True):
        role.gesture(side, (ahead, 0.10, 0.14), on, elbow=(-0.2, 0.5, -1.0))
    role.crouch += 0.04 * energy * on
    role.lean += 0.06 * on
    bounce = np.sin(2 * np.pi * 1.5 * times + stage.pick(0.0, 6.3))
    role.crouch += 0.007 * energy * on * (1 + bounce)
    back = rise(times, beat.prepare.start, beat.prepare.at(0.6)) - rise(
        times, beat.release.at(0.5), beat.depart.start
    )
    role.footing["right"] = np.column_stack([-0.20 * back, 0.02 * back, 0.35 * back])
    role.heading -= 0.25 * on
    return on


@interaction(Apart(1.28, least=1.15))
def kick(stage: Stage) -> None:
    """One kicks at the other's belly, who springs back, fists up."""
    beat = stage.phases(
        approach=0.8, prepare=0.9, contact=0.7, hold=0.8, release=0.9, depart=0.7, restless=0.002
    )
    stage.face_to_face(arrive=beat.prepare.at(0.2), travel=(0.1, 0.4))
    times, energy, size = stage.times, stage.style.energy, min(stage.style.amplitude, 1.25)
    first, second = stage.people
    for role in stage.people:
        _guard(stage, role, beat)
    tempo = min(stage.style.speed, 1.15)
    hit = beat.contact.at(0.75)
    leave, land = hit - 0.55 / tempo, hit + 0.62 / tempo
    high = 0.40 + 0.26 * size
    far = (0.60 + 0.16 * size, -0.09, high)
    first.kicks.append(
        Kick("right", (leave, hit - 0.04, hit + 0.06, land), np.array(far), tip=-0.55)
    )
    load = window(times, leave - 0.35, leave + 0.12, land - 0.25, land + 0.25)
    up = window(times, leave, hit - 0.02, hit + 0.06, land)
    first.shift[:, 1] += 0.075 * load
    first.shift[:, 0] += 0.06 * load
    first.lean -= (0.20 + 0.10 * size) * up
    first.twist += 0.18 * energy * up
    first.heading += 0.25 * up
    first.gesture("right", (0.05, 0.34, -0.10), 0.8 * up, elbow=(-0.6, 0.6, -0.6))
    start = hit - 0.30 + min(0.3 * stage.answer(), 0.12)
    second.path[:, 0] += min(stage.pick(0.28, 0.38) * energy, 0.45) * rise(
        times, start, start + 0.9
    )
    shrink = window(times, start, hit + 0.05, hit + 0.3, beat.hold.end + 0.2)
    second.lean += 0.22 * energy * shrink
    second.shift[:, 0] -= 0.05 * shrink
    for side in SIDES:  # forearms down before the belly
        second.gesture(side, (0.32, 0.06, -0.12), shrink, elbow=(-0.3, 0.8, -0.6))


@interaction(Apart(0.95, least=0.88))
def duck(stage: Stage) -> None:
    """One swings a wide hook, the other ducks under it and comes up again."""
    beat = stage.phases(
        approach=0.8, prepare=0.9, contact=0.6, hold=0.8, release=0.9, depart=0.7, restless=0.002
    )
    stage.face_to_face(arrive=beat.prepare.at(0.2), travel=(0.1, 0.4))
    times, energy, size = stage.times, stage.style.energy, stage.style.amplitude
    first, second = stage.people
    for role in stage.people:
        _guard(stage, role, beat)
    hit = beat.contact.at(0.9)
    swing = 0.50 / min(0.5 + 0.5 * stage.style.speed, 1.1)
    wind = hit - 0.5 * swing
    wide = 0.26 + 0.10 * min(size, 1.2)
    knots = [
        (wind - 0.5, (0.22, 0.12, 0.12)),
        (wind, (0.10, wide, 0.16)),
        (wind + swing, (0.40, -0.20, 0.20)),
        (wind + swing + 0.6, (0.22, 0.10, 0.12)),
    ]
    on = window(times, wind - 0.55, wind - 0.1, wind + swing + 0.1, wind + swing + 0.7)
    follow(stage, first, "right", knots, on, elbow=(-0.2, 1.0, 0.2))
    coil = window(times, wind - 0.5, wind, wind, wind + 0.5 * swing)
    through_ = window(
        times, wind + 0.2 * swing, wind + swing, wind + swing + 0.15, wind + swing + 0.9
    )
    first.twist += (-0.30 * coil + 0.40 * through_) * energy
    first.lean += 0.10 * through_
    early = hit - 0.42 + min(0.3 * stage.answer(), 0.12)
    low = window(times, early - 0.1, hit - 0.04, hit + 0.22, hit + 1.0)
    deep = min(0.20 + 0.06 * size, 0.28)
    second.crouch += deep * low
    second.lean += 0.42 * low
    second.nod += 0.15 * low
    second.tilt += 0.12 * low
    second.shift[:, 1] += 0.05 * low


@interaction(Apart(1.85, least=1.7))
def fence(stage: Stage) -> None:
    """Both fence: sword arm forward, one advances and lunges, the other parries and gives way."""
    beat = stage.phases(
        approach=0.3, prepare=1.1, hold=4.2, release=0.9, depart=0.7, restless=0.003
    )
    stage.face_to_face(arrive=beat.approach.end, travel=(0.0, 0.0))
    times, energy, size = stage.times, stage.style.energy, min(stage.style.amplitude, 1.2)
    on = window(times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.depart.at(0.3))
    stand = rise(times, beat.prepare.start, beat.prepare.at(0.5)) - rise(
        times, beat.release.at(0.4), beat.release.end
    )
    lunges = ((beat.hold.at(0.22), 0), (beat.hold.at(0.58), 1))
    forth = 0.14 * energy
    walk = through(
        times,
        [
            (beat.hold.start, 0.0),
            (lunges[0][0], forth),
            (lunges[1][0], -forth),
            (beat.hold.end, 0.0),
        ],
    )
    for index, role in enumerate(stage.people):
        sign = 1.0 if index == 0 else -1.0
        role.path[:, 0] += walk
        role.heading += 0.75 * on
        role.twist -= 0.25 * on
        role.crouch += 0.07 * on
        lunge = np.zeros(len(times))
        parry = np.zeros(len(times))
        for moment, who in lunges:
            long = 0.9 / stage.style.speed
            if who == index:
                lunge += window(
                    times, moment - 0.1, moment + 0.35, moment + 0.5, moment + 0.7 + long
                )
            else:
                late = min(0.4 * stage.answer(), 0.15)
                parry += window(
                    times, moment - 0.1 + late, moment + 0.3 + late, moment + 0.5, moment + long
                )
        nothing = np.zeros(len(times))
        step = 0.12 * stand + 0.16 * size * np.ceil(lunge - 0.3)
        role.footing["right"] = np.column_stack([0.7 * step, 0.5 * step, 0.35 * stand])
        role.footing["left"] = np.column_stack([-0.14 * stand, nothing, 0.35 * stand])
        role.shift[:, 0] += 0.06 * lunge - 0.06 * parry
        role.shift[:, 1] -= 0.09 * lunge - 0.05 * parry
        role.crouch += 0.06 * size * lunge
        role.lean += 0.12 * lunge - 0.06 * parry
        circle = stage.pick(0.0, 6.3) + 2 * np.pi * 1.1 * times
        ahead = 0.34 + 0.16 * lunge - 0.06 * parry + 0.02 * np.sin(circle)
        out = 0.16 + 0.16 * lunge - 0.24 * parry * sign**2 + 0.03 * np.cos(circle)
        up = 0.02 + 0.12 * lunge + 0.10 * parry + 0.03 * np.sin(circle)
        role.gesture("right", np.column_stack([ahead, out, up]), on, elbow=(-0.3, 0.6, -1.0))
        behind = np.column_stack([-0.16 - 0.10 * lunge, 0.44 + 0.06 * lunge, 0.36 - 0.30 * lunge])
        role.gesture("left", behind, on, elbow=(-0.5, 0.1, -1.0))
    salute = window(times, beat.release.at(0.2), beat.release.end, beat.depart.at(0.2), beat.end)
    for role in stage.people:
        role.gesture("right", (0.24, 0.02, 0.20), salute, elbow=(-0.1, 0.7, -0.9))
