"""Walking and dancing together: side by side, in a circle, as a mirror image, as a waltz."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from generator.choreographer.curves import through, window
from generator.choreographer.interaction import interaction
from generator.choreographer.role import outward
from generator.choreographer.spacing import Apart, ByReach, ByTouch
from generator.choreographer.stage import PALM_TO_PALM, Phases, Stage
from generator.choreographer.style import FACING, SIDES, Side
from robots.skeleton import FloatArray


def _travel(times: NDArray, speed: NDArray) -> FloatArray:
    """Return the distance covered ``[T]`` at a speed ``[T]``, by the trapezoid rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(times))])


@interaction(Apart(0.80, least=0.70))
def walk_together(stage: Stage) -> None:
    """Both walk side by side in the same direction and look at each other now and then."""
    beat = stage.phases(approach=0.4, prepare=1.0, hold=3.2, release=1.0, depart=0.6)
    times = stage.times
    pace = min(stage.pick(0.8, 1.0) * stage.style.speed, 1.15)
    going = window(times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.end)
    bend = stage.pick(-0.10, 0.10) * stage.style.energy
    way = _travel(times, pace * going)
    direction = bend * (way - 0.5 * way[-1])
    ahead = np.column_stack([np.cos(direction), np.sin(direction)])
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    middle = np.column_stack([_travel(times, pace * going * ahead[:, i]) for i in range(2)])
    middle -= 0.5 * middle[-1]
    for role, sign in zip(stage.people, (1.0, -1.0), strict=True):
        role.path += middle + 0.5 * sign * stage.near * left
        role.heading += direction
        glance = stage.pick(beat.prepare.end, beat.hold.at(0.7))
        role.gaze = 0.75 * window(times, glance, glance + 0.5, glance + 1.1, glance + 1.6)


@interaction(ByReach(0.80))
def circle_dance(stage: Stage) -> None:
    """Both join hands and dance round in a circle, face to face."""
    beat = stage.phases(approach=0.3, prepare=0.9, hold=4.4, release=0.9, depart=0.4)
    times = stage.times
    going = window(
        times, beat.prepare.end - 0.3, beat.hold.at(0.25), beat.hold.at(0.75), beat.hold.end
    )
    turn = float(stage.rng.choice([-1.0, 1.0])) * stage.pick(0.8, 1.1) * stage.style.speed
    angle = _travel(times, turn * going)
    stage.couple(np.zeros((len(times), 2)), angle)
    bob = stage.rhythm(beat.hold, 1.2, 0.025) * stage.style.energy
    for role in stage.people:
        role.lean -= 0.05 * stage.style.energy * going
        role.crouch += 0.01 * going
    for side, other in FACING:
        shift = np.zeros((len(times), 3))
        shift[:, 1] = 0.06 * outward(side)
        shift[:, 2] = bob
        stage.meet(
            (side, other),
            on=beat.hold,
            start=beat.prepare.start,
            end=beat.release.end,
            height=-0.22,
            apart=(PALM_TO_PALM, 0.0, 0.0),
            shift=shift,
            elbow=(-0.2, 0.6, -1.0),
        )


@interaction(Apart(1.4))
def mirror_dance(stage: Stage) -> None:
    """One moves arms and trunk slowly, the other mirrors every movement."""
    beat = stage.phases(approach=0.8, prepare=0.6, hold=4.0, release=1.1, depart=0.5)
    stage.face_to_face(arrive=beat.prepare.end, travel=(0.05, 0.25))
    times = stage.times
    delay = stage.answer(stage.pick(0.05, 0.2))
    count = int(stage.rng.integers(4, 6))
    moments = np.linspace(beat.prepare.start, beat.hold.end, count)
    size = stage.style.amplitude
    low, high = (0.18, 0.10, -0.20), (0.38, 0.20 + 0.25 * size, 0.12 + 0.30 * size)
    poses: dict[Side, list[FloatArray]] = {
        side: [stage.rng.uniform(low, high) for _ in moments] for side in SIDES
    }
    sway = [stage.pick(-0.12, 0.12) * size for _ in moments]
    turns = [stage.pick(-0.25, 0.25) * size for _ in moments]
    for role, mirrored in zip(stage.people, (False, True), strict=True):
        clock = times - (delay if mirrored else 0.0)
        sign = -1.0 if mirrored else 1.0
        on = window(clock, beat.approach.at(0.2), beat.prepare.end, beat.hold.end, beat.end - delay)
        role.tilt += sign * on * through(clock, list(zip(moments, sway, strict=True)))
        role.twist += sign * on * through(clock, list(zip(moments, turns, strict=True)))
        for side in SIDES:
            own: Side = _other(side) if mirrored else side
            offsets = through(clock, list(zip(moments, poses[side], strict=True)))
            role.gesture(own, offsets, on, elbow=(-0.2, 0.8, -0.8))


@interaction(ByTouch(0.01))
def waltz(stage: Stage) -> None:
    """Both take closed hold and turn over the floor in three-four time."""
    beat = stage.phases(approach=0.3, prepare=1.0, hold=4.4, release=0.9, depart=0.4)
    times = stage.times
    going = window(
        times, beat.prepare.end - 0.2, beat.hold.at(0.2), beat.hold.at(0.8), beat.hold.end
    )
    turn = float(stage.rng.choice([-1.0, 1.0])) * stage.pick(0.7, 0.95) * stage.style.speed
    angle = _travel(times, turn * going)
    radius = stage.pick(0.35, 0.6)
    round_ = _travel(times, -0.6 * turn * going) + stage.pick(0.0, 2 * np.pi)
    centre = radius * np.column_stack([np.cos(round_), np.sin(round_)])
    stage.couple(centre - centre.mean(axis=0), angle, aside=0.07)
    bar = 1.7 / stage.style.speed
    fall = 0.5 - 0.5 * np.cos(2 * np.pi * (times - beat.hold.start) / bar)
    for role in stage.people:
        role.crouch += 0.025 * stage.style.energy * going * fall
        role.gaze -= 0.6 * going
        role.twist += 0.08 * going
    _closed_hold(stage, beat)


def _closed_hold(stage: Stage, beat: Phases) -> None:
    """Join one pair of hands to the side; lay the other hands on back and shoulder."""
    times, on, start, end = stage.times, beat.hold, beat.prepare.start, beat.release.end
    shift = np.zeros((len(times), 3))
    shift[:, 1] = 0.26
    stage.meet(
        ("left", "right"),
        on=on,
        start=start,
        end=end,
        height=-0.02,
        apart=(0.0, 0.0, -PALM_TO_PALM),
        shift=shift,
        elbow=(-0.1, 0.8, -0.9),
    )
    if stage.builds[0].scale > 1.08 * stage.builds[1].scale:
        # Arms of a tall leader and a small partner would cross: they dance in two-hand hold.
        stage.meet(
            ("right", "left"),
            on=on,
            start=start,
            end=end,
            height=-0.14,
            apart=(PALM_TO_PALM, 0.0, 0.0),
            shift=np.tile((0.0, -0.10, 0.0), (len(times), 1)),
            elbow=(-0.2, 0.7, -1.0),
        )
        return
    stage.lay_on(
        stage.first,
        "right",
        "spine3",
        (0.0, 0.165, -0.04),
        on=on,
        start=start,
        end=end,
        elbow=(0.0, 0.8, -1.0),
    )
    stage.lay_on(
        stage.second,
        "left",
        "right_collar",
        (0.06, -0.08, 0.12),
        on=on,
        start=start,
        end=end,
        elbow=(0.0, 1.0, 0.2),
    )


def _other(side: Side) -> Side:
    return "right" if side == "left" else "left"
