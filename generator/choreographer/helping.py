"""Lending a hand: helping up, supporting, walking hand in hand, carrying something together."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, window
from generator.choreographer.formations import stagger
from generator.choreographer.interaction import interaction
from generator.choreographer.spacing import Apart, ByReach, ByTouch
from generator.choreographer.stage import CALM, PALM_TO_PALM, TOP_SPEED, Span, Stage
from generator.choreographer.style import SIDES
from robots.skeleton import FloatArray


@interaction(ByReach(0.84, room=0.10))
def help_up(stage: Stage) -> None:
    """One holds out a hand to the other, who crouches on the floor, and pulls the other up."""
    beat = stage.phases(
        approach=1.3, prepare=0.8, contact=0.4, hold=1.3, release=0.8, depart=0.8, restless=0.004
    )
    times = stage.times
    first, second = stage.people
    walk = min(stage.pick(0.4, 0.7), TOP_SPEED * (beat.prepare.start - CALM) / 1.875)
    come = 1.0 - rise(times, CALM, beat.prepare.at(0.2))
    first.path[:, 0] -= 0.5 * stage.near + walk * come
    second.path[:, 0] += 0.5 * stage.near
    second.heading += np.pi
    pulled = Span(beat.hold.at(0.15), beat.hold.at(0.95))
    low = 1.0 - rise(times, pulled.start, pulled.end)
    late = min(stage.answer(), 0.5)
    second.crouch += 0.40 * low
    second.lean += 0.30 * low
    second.gaze *= rise(times, 0.3 + late, beat.prepare.start + 0.3 + late)
    second.nod += 0.30 * (1.0 - rise(times, 0.3 + late, beat.prepare.start + late))
    second.stance *= 1.15
    second.heels["left"] = 0.55 * low
    second.heels["right"] = 0.55 * low
    second.shift[:, 0] += 0.10 * low
    bend = window(times, beat.approach.at(0.8), beat.contact.at(0.5), pulled.start, pulled.end)
    first.lean += 0.52 * bend
    first.crouch += 0.12 * bend
    effort = window(times, pulled.start, pulled.at(0.5), pulled.at(0.6), pulled.end + 0.3)
    first.lean -= 0.12 * stage.style.energy * effort
    first.shift[:, 0] -= 0.05 * stage.style.energy * effort
    stagger(stage, beat.approach.at(0.7), beat.depart.at(0.2), 0.08 * stage.style.amplitude)
    second.footing.clear()
    shift = np.zeros((len(times), 3))
    # The hands rise with the shoulders; the height of a meeting counts from their mean.
    shift[:, 2] = (0.26 - 0.50 * low) * 0.8
    stage.meet(
        ("right", "right"),
        on=Span(beat.contact.end, beat.hold.end),
        start=beat.prepare.start,
        end=beat.release.end,
        height=-0.28,
        apart=(0.0, PALM_TO_PALM, 0.0),
        shift=shift,
        elbow=(-0.3, 0.5, -1.0),
    )
    second.gesture("left", (0.30, 0.10, -0.22), low, elbow=(-0.1, 1.0, -0.4))
    before = 1.0 - rise(times, beat.prepare.start, beat.contact.at(0.5))
    second.reaches.insert(0, second.reaches.pop())
    second.gesture("right", (0.30, 0.10, -0.22), before * low, elbow=(-0.1, 1.0, -0.4))
    second.reaches.insert(0, second.reaches.pop())


@interaction(ByTouch(0.19), overlap=0.04)
def support_walk(stage: Stage) -> None:
    """One supports the other, who limps along and leans on the helper's shoulder."""
    beat = stage.phases(approach=0.3, prepare=1.3, hold=4.0, release=1.3, depart=0.5)
    times, energy = stage.times, stage.style.energy
    helper, hurt = stage.people
    pace = min(0.50 * stage.style.speed, 0.6)
    going = window(times, beat.prepare.end, beat.hold.at(0.2), beat.hold.at(0.8), beat.hold.end)
    way = _travel(times, pace * going)
    close = window(
        times, beat.prepare.at(0.3), beat.hold.start, beat.hold.end, beat.release.end + 0.1
    )
    for role, sign in zip(stage.people, (1.0, -1.0), strict=True):
        role.path[:, 0] += way - 0.5 * way[-1]
        role.path[:, 1] += 0.5 * sign * (stage.near + 0.34 * stage.scale * (1.0 - close))
        role.first_step = "left"
        role.gaze -= 0.75 * going
        role.nod += 0.12 * going
    limp = stage.rhythm(Span(beat.prepare.end, beat.hold.end), 0.85, 1.0) / stage.style.amplitude
    hurt.crouch += (0.035 + 0.022 * limp) * energy * going
    hurt.tilt -= (0.10 + 0.05 * limp) * stage.style.amplitude * going
    hurt.lean += 0.12 * going
    hurt.arm_swing *= 0.3
    helper.tilt -= 0.05 * going
    helper.lean += 0.06 * going
    start, end = beat.prepare.start, beat.release.end
    late = min(stage.answer(), 0.4)
    on = Span(beat.hold.start + late, beat.hold.end)
    # Arms go up and back before the bodies come together, or they would get between them.
    lifted = window(times, 0.1, beat.prepare.at(0.4), beat.release.at(0.6), beat.end + 0.2)
    hurt.gesture("left", (0.32, 0.14, 0.04), lifted, elbow=(0.2, 0.9, -0.8))
    helper.gesture("right", (-0.28, 0.16, -0.22), lifted, elbow=(-1.0, 0.5, -0.3))
    stage.lay_on(
        hurt,
        "left",
        "right_collar",
        (0.07, -0.12, 0.07),
        on=on,
        start=start + late,
        end=end,
        elbow=(0.5, 0.7, -0.8),
    )
    stage.lay_on(
        helper,
        "right",
        "spine1",
        (-0.14, -0.06, 0.0),
        on=on,
        start=start,
        end=end,
        elbow=(-1.0, 0.2, -1.0),
    )
    clutch = window(times, beat.prepare.start, beat.hold.start, beat.hold.end, beat.release.at(0.7))
    hurt.gesture("right", (0.14, 0.12, -0.22), clutch, elbow=(-0.3, 1.0, -0.3))


@interaction(Apart(0.82, least=0.80))
def walk_hand_in_hand(stage: Stage) -> None:
    """Both stroll along hand in hand, the joined hands swinging."""
    beat = stage.phases(
        approach=0.3, prepare=0.9, hold=4.2, release=1.0, depart=0.6, restless=0.006
    )
    times = stage.times
    pace = min(stage.pick(0.65, 0.8) * stage.style.speed, 1.05)
    going = window(times, beat.prepare.end, beat.hold.at(0.2), beat.hold.at(0.75), beat.hold.end)
    bend = stage.pick(-0.12, 0.12)
    way = _travel(times, pace * going)
    direction = bend * (way - 0.5 * way[-1])
    ahead = np.column_stack([np.cos(direction), np.sin(direction)])
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    middle = np.column_stack([_travel(times, pace * going * ahead[:, i]) for i in range(2)])
    step: tuple = ("left", "right")
    for role, sign, side in zip(stage.people, (1.0, -1.0), step, strict=True):
        role.path += middle - 0.5 * middle[-1] + 0.5 * sign * stage.near * left
        role.heading += direction
        role.first_step = side
        glance = stage.pick(beat.hold.start, beat.hold.at(0.6)) + (
            stage.answer() if role is stage.second else 0.0
        )
        looks = window(times, glance, glance + 0.5, glance + 1.2, glance + 1.7)
        role.gaze = 0.1 + 0.75 * looks
        role.tilt += (0.04 if sign > 0 else -0.04) * looks
    swing = stage.rhythm(Span(beat.prepare.end, beat.hold.end), 0.85, 0.11) * stage.style.energy
    swing = np.clip(swing, -0.2, 0.2)
    shift = np.column_stack([np.zeros(len(swing)), -swing, 0.9 * swing**2])
    stage.meet(
        ("right", "left"),
        on=beat.hold,
        start=beat.prepare.start,
        end=beat.release.end,
        height=-0.46,
        apart=(PALM_TO_PALM, 0.0, 0.0),
        shift=shift,
        elbow=(-0.8, 0.5, -0.4),
    )


@interaction(Apart(1.35, least=1.2))
def carry_together(stage: Stage) -> None:
    """Both lift a heavy chest between them, carry it sideways and put it down."""
    beat = stage.phases(
        approach=0.3, prepare=0.9, contact=0.9, hold=3.0, release=1.0, depart=0.7, restless=0.003
    )
    times, energy = stage.times, stage.style.energy
    going = window(times, beat.contact.end, beat.hold.at(0.25), beat.hold.at(0.75), beat.hold.end)
    pace = min(0.30 * stage.style.speed, 0.34)
    way = _travel(times, pace * going)
    lag = min(stage.answer(), 0.35)
    sideways = float(stage.rng.choice([-1.0, 1.0]))
    for role, sign, delay in zip(stage.people, (-1.0, 1.0), (0.0, lag), strict=True):
        role.path[:, 0] += 0.5 * sign * stage.near
        role.path[:, 1] += sideways * (way - 0.5 * way[-1])
        role.stance *= 1.35
        # The foot that goes first is the one on the side of the way.
        role.first_step = "left" if sign * sideways < 0 else "right"
        hold = window(
            times, beat.prepare.at(0.5), beat.prepare.end, beat.release.at(0.9), beat.depart.at(0.6)
        )
        deep = hold * (
            1.0
            - window(
                times,
                beat.contact.start + delay,
                beat.contact.end + delay,
                beat.hold.end,
                beat.release.at(0.9),
            )
        )
        role.crouch += (0.30 * deep + 0.02 * hold) * min(role.build.scale, 1.1)
        role.lean += 0.42 * deep
        role.lean -= 0.07 * energy * (hold - deep) * hold
        role.nod += 0.25 * deep
        role.gaze -= 0.35 * hold
        bob = 0.010 * stage.style.amplitude * np.sin(2 * np.pi * 1.5 * times) * going
        for side in SIDES:
            spot = np.column_stack(
                [
                    0.36 + 0.05 * deep,
                    np.full(len(times), 0.20),
                    -0.34 + 0.04 * stage.style.amplitude + bob,
                ]
            )
            role.gesture(side, spot, hold, elbow=(-0.6, 0.5, -0.8))
    stage.second.heading += np.pi


def _travel(times: FloatArray, speed: FloatArray) -> FloatArray:
    """Return the distance covered ``[T]`` at a speed ``[T]``, by the trapezoid rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(times))])


__all__ = ["carry_together", "help_up", "support_walk", "walk_hand_in_hand"]
