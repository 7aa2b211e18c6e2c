"""Dances of a party: cha-cha, a twirl under the arm, do-si-do, disco, conga."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, through, window
from generator.choreographer.formations import in_file
from generator.choreographer.gestures import follow, hand_on_hip
from generator.choreographer.interaction import interaction
from generator.choreographer.role import Footfall, Role, outward
from generator.choreographer.spacing import Apart, ByReach
from generator.choreographer.stage import PALM_TO_PALM, Span, Stage
from generator.choreographer.style import FACING, SIDES, Side
from robots.skeleton import FloatArray


@interaction(ByReach(0.76, room=0.16))
def cha_cha(stage: Stage) -> None:
    """Both, hand in hand, dance the cha-cha: rock step, cha-cha-cha to the side, and back again."""
    beat = stage.phases(
        approach=0.2, prepare=0.8, hold=5.6, release=0.8, depart=0.3, restless=0.002
    )
    times, size = stage.times, min(stage.style.amplitude, 1.25)
    stage.couple(np.zeros((len(times), 2)), np.zeros(len(times)))
    bars = 3
    count = beat.hold.length / (4 * bars)
    aside = 0.20 * size * stage.scale
    knots = [(beat.hold.start, 0.0)]
    for bar in range(bars):
        start = beat.hold.start + 4 * bar * count
        knots += [(start + 1.8 * count, knots[-1][1])]
        knots += [(start + 3.3 * count, aside if bar % 2 == 0 else 0.0)]
    going = window(
        times, beat.hold.start - 0.2, beat.hold.start + 0.2, beat.hold.end - 0.3, beat.hold.end
    )
    pulse = np.sin(np.pi * (times - beat.hold.start) / count)
    path = through(times, knots)
    for role, leads in zip(stage.people, (True, False), strict=True):
        role.path[:, 1] += path
        _cha_cha_steps(role, beat.hold.start, count, bars, size, leads=leads)
        side = 1.0 if leads else -1.0
        role.shift[:, 1] += 0.032 * size * side * pulse * going
        role.tilt += 0.07 * size * side * pulse * going
        role.twist += 0.08 * side * stage.style.energy * pulse * going
        role.crouch += (
            0.012 * stage.style.energy * going * (1.0 - np.cos(2 * np.pi * times / count))
        )
        role.gaze -= 0.3 * going
    for side, other in FACING:
        shift = np.zeros((len(times), 3))
        shift[:, 1] = outward(side) * 0.08
        shift[:, 2] = 0.012 * size * pulse * going
        stage.meet(
            (side, other),
            on=beat.hold,
            start=beat.prepare.start,
            end=beat.release.end,
            height=-0.20,
            apart=(PALM_TO_PALM, 0.0, 0.0),
            shift=shift,
            elbow=(-0.1, 0.8, -0.9),
        )


def _cha_cha_steps(
    role: Role, start: float, count: float, bars: int, size: float, *, leads: bool
) -> None:
    """Write the steps: two, three, four-and-one; whoever leads begins forward, the other back."""
    times = role.times
    swing = 0.52 * count
    rock = {side: np.zeros(len(times)) for side in SIDES}
    for bar in range(bars):
        bar_start = start + 4 * bar * count
        free: Side = "left" if (bar % 2 == 0) == leads else "right"
        other: Side = "right" if free == "left" else "left"
        forward = 1.0 if (bar % 2 == 0) == leads else -1.0
        out = rise(times, bar_start - 0.45 * count, bar_start - 0.44 * count)
        home = rise(times, bar_start + 1.3 * count, bar_start + 1.31 * count)
        rock[free] += 0.20 * size * forward * (out - home)
        role.shift[:, 0] += (
            0.06
            * size
            * forward
            * window(
                times,
                bar_start - 0.4 * count,
                bar_start + 0.3 * count,
                bar_start + 0.5 * count,
                bar_start + 1.6 * count,
            )
        )
        sides: tuple[Side, ...] = (free, other, free, other, free)
        for at, side in zip((0.0, 1.0, 2.0, 2.5, 3.0), sides, strict=True):
            land = bar_start + at * count
            airborne = 0.38 * count if at in (2.5, 3.0) else swing
            role.footfalls.append(Footfall(side, land - airborne, land))
    nothing = np.zeros(len(times))
    for side in SIDES:
        role.footing[side] = np.column_stack([rock[side], nothing, nothing])


@interaction(ByReach(0.86, room=0.24))
def twirl(stage: Stage) -> None:
    """One leads the other, hand in raised hand, into a full turn under the arm."""
    beat = stage.phases(
        approach=0.9, prepare=0.7, contact=0.5, hold=3.6, release=0.9, depart=0.6, restless=0.006
    )
    stage.face_to_face(arrive=beat.prepare.at(0.2), travel=(0.1, 0.4))
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    first, second = stage.people
    turn = Span(beat.hold.at(0.22), beat.hold.at(0.80))
    late = min(0.3 * stage.answer(), 0.15)
    second.heading -= 2 * np.pi * _even(times, turn.start + late, turn.end + late)
    up = window(times, beat.hold.start, turn.start + 0.1, turn.end + late, beat.hold.end)
    shift = np.zeros((len(times), 3))
    shift[:, 2] = (0.22 + 1.5 * _overhead(stage)) * up
    shift[:, 0] = 0.05 * up
    shift[:, 1] = 0.04 * up
    stage.meet(
        ("left", "right"),
        on=Span(beat.contact.start, beat.release.at(0.2)),
        start=beat.prepare.start,
        end=beat.release.end + 0.2,
        height=-0.22 - 0.5 * _overhead(stage),
        apart=(0.0, 0.0, -PALM_TO_PALM),
        shift=shift,
        elbow=(-0.1, 0.7, -0.8),
    )
    for role, side in zip(stage.people, ("left", "right"), strict=True):
        hold = role.reaches[-1]  # the same place with the elbow up, or it would cross the chest
        role.reach(side, hold.goal, up, elbow=(0.1, 1.0, 0.0))
    spin = window(times, turn.start - 0.2, turn.start + 0.4, turn.end - 0.3, turn.end + 0.4)
    second.gesture("left", (0.24, 0.04, -0.14 + 0.04 * size), spin, elbow=(0.0, 1.0, -0.6))
    second.gaze -= spin
    second.crouch += (0.012 * energy + _dip(stage)) * spin
    second.nod += 1.5 * _dip(stage) * spin
    second.stance *= 0.8
    hand_on_hip(first, "right", spin)
    first.tilt -= 0.06 * energy * spin
    first.twist -= 0.12 * spin


def _overhead(stage: Stage) -> float:
    """Return how far above the mean of the shoulders two hands meet with ease, m at 1.70 m."""
    tops = [1.43 * build.scale for build in stage.builds]
    tops[1] -= _dip(stage)
    high = min(top + 0.56 * build.arm for top, build in zip(tops, stage.builds, strict=True))
    return min(0.34, (high - 0.5 * sum(tops)) / stage.scale)


def _dip(stage: Stage) -> float:
    """Return how far a second who is the taller one bends the knees to pass under the arm, m."""
    return 1.2 * max(stage.builds[1].scale / stage.builds[0].scale - 1.03, 0.0)


def _even(times: FloatArray, start: float, end: float) -> FloatArray:
    """Return a course ``[T]`` from 0 to 1 with an even speed between soft ends."""
    soft = 0.3 * (end - start)
    speed = window(
        times, start - 0.5 * soft, start + 0.5 * soft, end - 0.5 * soft, end + 0.5 * soft
    )
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    return way / way[-1]


@interaction(Apart(1.3, least=1.15))
def do_si_do(stage: Stage) -> None:
    """Both, arms folded, walk round each other back to back without turning."""
    beat = stage.phases(
        approach=0.3, prepare=0.8, hold=5.0, release=0.8, depart=0.4, restless=0.003
    )
    times = stage.times
    angle = 2 * np.pi * _even(times, beat.hold.at(0.02), beat.hold.at(0.96))
    wide = 0.37 * stage.scale * (0.8 + 0.2 * stage.style.distance)
    folded = window(times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.end)
    hop = np.abs(np.sin(2 * np.pi * 0.95 * stage.style.speed * times))
    moving = window(times, beat.hold.start, beat.hold.at(0.1), beat.hold.at(0.9), beat.hold.end)
    lag = min(0.4 * stage.answer(), 0.2)
    for role, sign in zip(stage.people, (-1.0, 1.0), strict=True):
        role.path[:, 0] += 0.5 * sign * stage.near * np.cos(angle)
        role.path[:, 1] -= sign * wide * np.sin(angle)
        role.gaze *= 0.3 + 0.7 * np.cos(angle) ** 2
        role.gaze -= 0.3 * (np.cos(angle) < -0.2)
        role.gaze = np.clip(np.convolve(role.gaze, np.ones(15) / 15, mode="same"), 0.0, 1.0)
        role.lean -= 0.04 * stage.style.energy * folded
        role.crouch += 0.014 * stage.style.energy * hop * moving
        role.tilt += (
            0.05 * stage.style.amplitude * np.sin(angle + (lag if sign > 0 else 0.0)) * moving
        )
        role.gesture("left", (0.20, -0.09, -0.07), folded, elbow=(0.1, 1.0, -0.3))
        role.gesture("right", (0.15, -0.10, 0.0), folded, elbow=(0.1, 1.0, -0.2))
    stage.second.heading += np.pi


@interaction(Apart(1.5, least=1.3))
def disco(stage: Stage) -> None:
    """Both dance disco: hips swing, and an arm points up and outward and down across by turns."""
    beat = stage.phases(
        approach=0.3, prepare=0.8, hold=5.0, release=0.9, depart=0.4, restless=0.004
    )
    stage.face_to_face(arrive=beat.approach.end, travel=(0.0, 0.0))
    times, size, energy = stage.times, stage.style.amplitude, stage.style.energy
    on = window(times, beat.prepare.start, beat.prepare.end, beat.hold.end, beat.release.end)
    count = 0.70 / (0.7 + 0.3 * stage.style.speed)
    lag = min(stage.answer(), 0.3)
    mirrored = bool(stage.rng.random() < 0.5)
    for role in stage.people:
        late = lag if role is stage.second else 0.0
        clock = times - beat.hold.start - late
        bounce = 0.5 - 0.5 * np.cos(2 * np.pi * clock / count)
        sway = np.sin(np.pi * clock / count)
        sign = -1.0 if mirrored and role is stage.second else 1.0
        role.crouch += 0.030 * energy * bounce * on
        role.shift[:, 1] += 0.045 * min(size, 1.2) * sign * sway * on
        role.tilt += 0.09 * min(size, 1.2) * sign * sway * on
        role.heading += 0.12 * sign * sway * on
        role.nod += 0.08 * energy * bounce * on
        half = beat.hold.at(0.5)
        turns: tuple[tuple[Side, Side, float, float], ...] = (
            ("right", "left", beat.prepare.start, half),
            ("left", "right", half, beat.release.end),
        )
        for side, other, start, end in turns:
            arm, rest = (side, other) if sign > 0 else (other, side)
            _disco_arm(stage, role, arm, Span(start + late, end), count)
            hand_on_hip(role, rest, window(times, start, start + 0.6, end - 0.5, end + 0.1))


def _disco_arm(stage: Stage, role: Role, side: Side, span: Span, count: float) -> None:
    """Let an arm point up and outward and down across the body by turns."""
    size = min(stage.style.amplitude, 1.2)
    high = (0.12, 0.32, 0.34 + 0.20 * size)
    low = (0.26, -0.08, -0.24)
    knots: list = [(span.start + 0.5, high)]
    moment = span.start + 0.5
    while moment + 1.7 * count < span.end:
        knots += [(moment + 0.25 * count, high), (moment + count, low)]
        knots += [(moment + 1.25 * count, low), (moment + 2 * count, high)]
        moment += 2 * count
    weight = window(stage.times, span.start, span.start + 0.55, span.end - 0.55, span.end + 0.1)
    follow(stage, role, side, knots, weight, elbow=(-0.2, 0.9, -0.6))


@interaction(ByReach(0.82, room=0.14))
def conga(stage: Stage) -> None:
    """One holds on to the other's shoulders from behind, and both dance off in a conga line."""
    beat = stage.phases(
        approach=0.9, prepare=0.7, hold=4.2, release=0.8, depart=0.5, restless=0.003
    )
    times, size, energy = stage.times, min(stage.style.amplitude, 1.2), stage.style.energy
    in_file(stage, arrive=beat.prepare.at(0.2), travel=(0.2, 0.4))
    first, second = stage.people
    going = window(times, beat.prepare.end, beat.hold.at(0.2), beat.hold.at(0.8), beat.hold.end)
    pace = min(0.5 * stage.style.speed, 0.62)
    way = np.concatenate([[0.0], np.cumsum(pace * going[1:] / 30.0)])
    sway = stage.rhythm(Span(beat.prepare.end, beat.hold.end), 0.85, 1.0) / stage.style.amplitude
    lag = round(30 * min(0.4 * stage.answer(), 0.2))
    for role in stage.people:
        role.path[:, 0] += way - 0.5 * way[-1]
        role.first_step = "left"
        swing = np.roll(sway, lag) if role is second else sway
        role.tilt += 0.10 * size * swing
        role.shift[:, 1] += 0.025 * size * swing
        role.crouch += 0.02 * energy * (1.0 - np.abs(swing)) * going
        role.heading += 0.06 * swing
    second.gaze = 0.55 * window(
        times, beat.hold.at(0.3), beat.hold.at(0.5), beat.hold.at(0.6), beat.hold.at(0.8)
    )
    second.twist += 0.25 * second.gaze
    for side in SIDES:
        sign = outward(side)
        stage.lay_on(
            first,
            side,
            f"{side}_collar",
            (-0.06, 0.02 * sign, 0.11),
            on=beat.hold,
            start=beat.prepare.start,
            end=beat.release.end,
            elbow=(-0.2, 0.9, -0.7),
        )
        up = window(times, beat.prepare.at(0.3), beat.hold.at(0.1), beat.hold.end, beat.release.end)
        pump = np.roll(0.5 * (1 + sign * sway), lag)
        arm = np.column_stack(
            [0.26 + 0.08 * pump, np.full(len(times), 0.20), -0.14 + 0.16 * size * pump]
        )
        second.gesture(side, arm, up, elbow=(-0.6, 0.6, -0.8))
