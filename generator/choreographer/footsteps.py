"""Where and when feet step so that a person can follow a path without sliding.

**The problem.** A path says where the pelvis goes; feet may only stand or swing. Steps are planned
one after another: the foot whose turn it is leaves for the place that lies under the hip half a
stance later, so that the body passes over it in the middle of its stance. A foot that already
stands well stays. Between its steps a foot is pinned by its toe; before leaving, the heel rises
about the toe, which keeps the trailing leg long and the pelvis level, as people do.

Worked example, 1 m/s with a step every 0.52 s and 0.42 s of swing: a foot stands 0.62 s, so it is
set down 0.31 m ahead of the hip and leaves 0.31 m behind it, and steps are 0.52 m long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from generator.choreographer.curves import ease, window
from generator.choreographer.frames import apply, pitch, yaw
from generator.choreographer.role import Kick, Role
from generator.choreographer.style import SIDES, Side
from robots.skeleton import FloatArray

TOE_HEIGHT = 0.02
"""Height of the toe keypoint (ball of the foot) of a standing 1.70 m person, m; the ankle then
stands at 0.075 m = 4.4 % of stature, as in anthropometric tables."""
TOE_OUT = 0.10
"""Angle by which standing feet point outward, rad."""
SWING = 0.42
"""Time a foot is in the air, s."""
HEEL_FIRST = 0.26
"""Time the heel is up before the toe leaves, s."""
NEAR_ENOUGH = 0.06
"""A foot this close to its place does not step, m."""
TURN_WEIGHT = 0.25
"""Metres that one radian of wrong foot direction counts for."""


Spots = dict[Side, FloatArray]
"""Per foot, toe x, y and direction ``[T, 3]`` if it stood under its hip all the time."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step of one foot."""

    side: Side
    leave: float
    """Toe leaves the floor, s."""
    land: float
    """Foot stands again, s."""
    start: FloatArray
    """``[3]``, toe x, y (m) and direction (rad) before."""
    end: FloatArray
    """``[3]``, the same after."""
    kick: Kick | None = None
    """What the foot does in the air instead of going to another place."""


@dataclass(frozen=True, slots=True, eq=False)
class Foot:
    """The path of one foot."""

    ankle: FloatArray
    """``[T, 3]`` m."""
    toe: FloatArray
    """``[T, 3]`` m."""
    rotation: FloatArray
    """``[T, 3, 3]`` rest frame to world."""
    direction: FloatArray
    """``[T]`` rad."""
    kicked: FloatArray
    """``[T]`` in 0..1, how far it is kicked up."""
    heel_down: NDArray[np.bool_]
    """``[T]``: the ankle stands."""
    toe_down: NDArray[np.bool_]
    """``[T]``: the toe stands."""


def plan_steps(role: Role) -> list[Step]:
    """Return the steps that carry a role along its path, in the order in which feet leave."""
    spots: Spots = {side: _spots(role, side) for side in SIDES}
    steps = _scripted(role, spots) if role.footfalls else _planned(role, spots)
    return _with_kicks(role, steps, spots)


def _scripted(role: Role, spots: Spots) -> list[Step]:
    """Return the steps that a role prescribes."""
    fps = _fps(role)
    standing = {side: spots[side][0] for side in SIDES}
    steps = []
    for fall in role.footfalls:
        goal = _at(spots[fall.side], (fall.land + 0.5 * (fall.land - fall.leave)) * fps)
        steps.append(Step(fall.side, fall.leave, fall.land, standing[fall.side], goal))
        standing[fall.side] = goal
    return steps


def _with_kicks(role: Role, steps: list[Step], spots: Spots) -> list[Step]:
    """Return the steps with a role's kicks among them, each from where the foot stands then."""
    for kick in role.kicks:
        leave, land = kick.moments[0], kick.moments[-1]
        before = [s.end for s in steps if s.side == kick.side and s.land <= leave]
        stand = before[-1] if before else spots[kick.side][0]
        steps.append(Step(kick.side, leave, land, stand, stand, kick))
    return sorted(steps, key=lambda step: step.leave) if role.kicks else steps


def _fps(role: Role) -> float:
    return (len(role.times) - 1) / float(role.times[-1])


def _kicks_during(role: Role, start: float, end: float) -> bool:
    """Return whether a leg is up, or is just put down, between two moments."""
    return any(kick.moments[0] - 0.1 < end and start < kick.moments[-1] for kick in role.kicks)


def _planned(role: Role, spots: Spots) -> list[Step]:
    """Return steps as the path asks for them; see the top of this file."""
    end = float(role.times[-1])
    fps = _fps(role)
    pace = _pace(role, fps)

    def spot(side: Side, moment: float) -> FloatArray:
        return _at(spots[side], moment * fps)

    standing = {side: spot(side, 0.0) for side in SIDES}
    steps: list[Step] = []
    turn: Side = role.first_step
    moment = 0.25
    while moment < end - SWING - 0.15:
        period = min(max(0.66 - 0.14 * pace[round(moment * fps)], 0.5), 0.66)
        ahead = moment + SWING + period - SWING / 2
        if _kicks_during(role, moment, moment + SWING):
            moment += 1 / fps
            continue
        for side in (turn, _other(turn)):
            goal = spot(side, ahead)
            if _misplaced(goal, standing[side]) > NEAR_ENOUGH * role.build.scale:
                steps.append(Step(side, moment, moment + SWING, standing[side], goal))
                standing[side] = goal
                turn = _other(side)
                moment += period
                break
        else:
            moment += 1 / fps
    return steps


def _spots(role: Role, side: Side) -> FloatArray:
    """Return toe x, y and direction ``[T, 3]`` of a foot that stands under its hip all the time."""
    sign = 1.0 if side == "left" else -1.0
    toe = role.build.offset(f"{side}_foot")
    ankle = np.array([-0.04 * role.build.scale, sign * role.stance * role.build.scale, 0.0])
    direction = role.heading + sign * TOE_OUT
    if side in role.footing:
        forward, aside, turn = role.footing[side].T
        direction = direction + sign * turn
        away = np.column_stack([forward, sign * aside, np.zeros(len(turn))])
        ankle = ankle + away * role.build.scale
    place = apply(yaw(role.heading), ankle) + apply(yaw(direction), toe)
    return np.column_stack([role.path + place[:, :2], direction])


def _at(values: FloatArray, index: float) -> FloatArray:
    """Return the row of ``values [T, N]`` at a fractional index, the last one beyond the end."""
    low = min(int(index), len(values) - 1)
    high = min(low + 1, len(values) - 1)
    return values[low] + (index - low if high > low else 0.0) * (values[high] - values[low])


def _pace(role: Role, fps: float) -> FloatArray:
    """Return the mean speed over the next 0.6 s at each frame ``[T]``, m/s."""
    count = len(role.times)
    later = np.minimum(np.arange(count) + round(0.6 * fps), count - 1)
    return np.linalg.norm(role.path[later] - role.path, axis=1) / 0.6


def _misplaced(goal: FloatArray, now: FloatArray) -> float:
    x, y, turn = goal - now
    return math.hypot(x, y) + TURN_WEIGHT * abs(turn)


def _other(side: Side) -> Side:
    return "right" if side == "left" else "left"


def foot_path(role: Role, steps: list[Step], side: Side, lift: float = 1.0) -> Foot:
    """Return the path of one foot through its steps.

    Args:
        role: Whose foot.
        steps: From :func:`plan_steps`.
        side: Which foot.
        lift: Factor on the height of steps.
    """
    times, scale = role.times, role.build.scale
    own = [step for step in steps if step.side == side]
    first = own[0].start if own else _spots(role, side)[0]
    place = np.tile(first, (len(times), 1))
    height = np.full(len(times), TOE_HEIGHT * scale)
    tip = np.zeros(len(times))
    toe_down = np.ones(len(times), dtype=np.bool_)
    heel_down = np.ones(len(times), dtype=np.bool_)
    kicked = np.zeros(len(times))
    offset = np.zeros((len(times), 3))
    settled = 0.0
    for step in own:
        if step.kick is not None:
            up = window(times, *step.kick.moments)
            kicked = np.maximum(kicked, up)
            offset += up[:, None] * step.kick.offset * (1.0, 1.0 if side == "left" else -1.0, 1.0)
            tip += step.kick.tip * up
            in_air = (times > step.leave) & (times < step.land)
            toe_down &= ~in_air
            heel_down &= ~in_air
            settled = step.land + 0.02
            continue
        swing = step.land - step.leave
        progress = (times - step.leave) / swing
        move = step.end - step.start
        length = float(np.hypot(move[0], move[1]))
        place += ease(progress)[:, None] * move
        u = np.clip(progress, 0.0, 1.0)
        height += lift * (0.035 + 0.05 * min(length, 0.8)) * scale * 64 * (u * (1 - u)) ** 3
        heading = step.start[2]
        forward = (move[0] * np.cos(heading) + move[1] * np.sin(heading)) / scale
        angle = 0.12 + 0.48 * float(np.clip(forward, 0.0, 1.1))
        heel_up = max(step.leave - HEEL_FIRST, settled)
        tip += angle * window(
            times, heel_up, step.leave + 0.3 * swing, step.leave + 0.3 * swing, step.land - 0.06
        )
        toe_down &= (times <= step.leave) | (times >= step.land)
        heel_down &= (times <= heel_up) | (times >= step.land)
        settled = step.land + 0.02
    if side in role.heels:
        tip += role.heels[side]
        heel_down &= role.heels[side] < 1e-6
    toe = np.column_stack([place[:, :2], height])
    if own and any(step.kick for step in own):
        toe += apply(yaw(role.heading), offset * scale)
    rotation = yaw(place[:, 2]) @ pitch(tip)
    ankle = toe - apply(rotation, role.build.offset(f"{side}_foot"))
    return Foot(ankle, toe, rotation, place[:, 2], kicked, heel_down, toe_down)
