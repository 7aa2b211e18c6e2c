"""Feet that stand are put on the floor and held still; body and legs follow.

1. The person is raised or lowered by what standing feet say of the floor, slowly, so that jumps
   stay jumps.
2. Each foot gets its places: while the sole is down the foot keeps one attitude, while the ball is
   down it keeps one place; a heel that is down alone keeps the place of the flat foot beside it.
3. What both feet ask for alike was a drift of the whole body: the pelvis takes it over, and sinks
   where a leg would be too short.
4. The legs bend to where the feet are. Between stances, corrections pass from one to the next.

A foot that steps is off the floor. Few frames a second, and networks, make it leave and land
gradually: it slides while it is hardly lifted. So it stays while it is, at both ends of a step, and
between two places it is lifted at least as much as a careful walker does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter1d, maximum_filter1d
from scipy.spatial.transform import Rotation

from generator.choreographer.footsteps import TOE_HEIGHT
from generator.choreographer.frames import apply, yaw
from generator.finishing.corrections import bridge, runs
from generator.finishing.figure import Figure, turn_about
from generator.finishing.limbs import move_end
from generator.finishing.settings import Finishing
from generator.finishing.stance import SIDES, Stance, find_stances
from generator.io.plausible import stature
from robots.skeleton import FloatArray

_STATURE = 1.70
_SLOW = 0.25
"""Low-pass on what is found of floor and drift, s."""
_EASE = 0.25
"""Time in which the correction of a foot comes and goes where no other stance follows, s."""
_FOLLOW = 0.3
"""Share of what both feet ask for alike that the pelvis takes over: the rest is error of legs."""
_LONGEST = 0.995
"""Longest leg, as a share of thigh plus shank."""
_RISE = 0.8
"""Lowest ankle in the air, over a standing ball, as a share of its height in the rest pose."""
_SINK_TIME = 0.2
"""Time to either side over which pelvises sink and rise, s."""
_PIVOT = 0.6
"""Turning in a stance, rad, from which a foot pivots rather than stands askew for a moment."""
_CLEAR = 0.01
"""How softly a foot in the air keeps off the floor, m."""
_CLEAR_TIME = 0.15
"""Time from a stance in which that sets in, s."""
_BARELY = 0.012
"""Height over its stance up to which a foot that leaves or lands has not done so yet, m."""
_BESIDE = 0.05
"""Farthest that it may be from the place where it then stands, m."""
_SWING = 0.27
"""Time that is left to a step in any case, s."""
_SHUFFLE = 0.01
"""Way between two stances that a foot may be moved in less time, m."""
_STEP = 1.2
"""Longest time between two stances that is taken for a single step, s."""
_LIFT, _LIFT_MOST = 0.25, 0.05
"""Least lift of a step as a share of its length, and the most that is asked for, m."""


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Where one foot goes."""

    down: NDArray[np.bool_]
    """``[T]``: ball or heel stands, and the foot can be held."""
    ball: NDArray[np.bool_]
    """``[T]``: the ball does."""
    toe: FloatArray
    """``[T, 3]`` m: where the ball goes while ``down``."""
    turn: FloatArray
    """``[T, 3]`` rad: rotation vectors, world, by which the foot is turned."""
    glides: bool
    """Whether it stands somewhere where it moves too far to be held."""


def plant_feet(
    figure: Figure, fps: float, labels: NDArray | None, settings: Finishing
) -> tuple[NDArray[np.bool_], dict[str, float]]:
    """Let a person stand on the floor without sliding.

    Args:
        figure: Is changed.
        fps: Frames per second.
        labels: ``[T, 4]`` foot contacts as the motion says, if it does.
        settings: Bounds.

    Returns:
        Which of ankle and toe, left and right, stand ``[T, 4]``, and how much was changed.
    """
    rest = TOE_HEIGHT * stature(figure.points) / _STATURE
    stances = find_stances(figure, fps, labels)
    raised = _level(figure, stances, rest, fps, settings.max_level)
    figure.shift(raised[:, None] * (0.0, 0.0, 1.0))
    places = [
        _place(figure, side, stance, rest, fps, settings.max_plant)
        for side, stance in zip(SIDES, stances, strict=True)
    ]
    follow = _common(figure, places, fps)
    figure.shift(follow)
    moved = [
        _goal(figure, side, place, rest, fps) for side, place in zip(SIDES, places, strict=True)
    ]
    sunk = _sink(figure, [goal for goal, _ in moved], fps)
    figure.shift(-sunk[:, None] * (0.0, 0.0, 1.0))
    farthest = 0.0
    for side, place, (ankle, by) in zip(SIDES, places, moved, strict=True):
        attitude = turn_about(place.turn) @ figure.frame(f"{side}_ankle")
        move_end(figure, f"{side}_hip", f"{side}_knee", f"{side}_ankle", ankle)
        now = figure.frame(f"{side}_ankle")
        figure.bend(f"{side}_ankle", attitude @ np.swapaxes(now, -1, -2))
        farthest = max(farthest, float(by[place.down].max(initial=0.0)))
    held = [
        (stance.heel & place.down, place.ball)
        for stance, place in zip(stances, places, strict=True)
    ]
    return np.column_stack([column for pair in held for column in pair]), {
        "raised": float(np.abs(raised).max()),
        "followed": float(np.linalg.norm(follow, axis=1).max()),
        "sunk": float(sunk.max()),
        "planted": farthest,
        "gliding": float(sum(place.glides for place in places)),
    }


def _level(
    figure: Figure, stances: tuple[Stance, Stance], rest: float, fps: float, most: float
) -> FloatArray:
    """Return by how much to raise a person ``[T]`` m so that standing balls are at ``rest``."""
    errors = rest - np.stack([figure.point(f"{side}_foot")[:, 2] for side in SIDES])
    counts = np.stack([stance.toe for stance in stances]) & (np.abs(errors) < 2 * most)
    raised = np.zeros(len(figure))
    if counts.any():
        always = float(np.clip(np.median(errors[counts]), -most, most))
        drift = _averaged(((errors - always) * counts).sum(axis=0), counts.sum(axis=0), fps)
        raised = np.clip(always + drift, -most, most)
    # Whoever kneels or lies may not sink in either.
    others = np.delete(
        figure.points[..., 2],
        [figure.skeleton.index(f"{s}_{n}") for s in SIDES for n in ("ankle", "foot")],
        axis=1,
    )
    deficit = np.maximum(-(others.min(axis=1) + raised), 0.0)
    return raised + _envelope(deficit, fps)


def _averaged(total: NDArray, count: NDArray, fps: float) -> FloatArray:
    """Return the mean over feet and about :data:`_SLOW` of time; towards 0 where nothing counts."""
    weight = gaussian_filter1d(count.astype(float), _SLOW * fps, mode="nearest")
    total = gaussian_filter1d(total.astype(float), _SLOW * fps, axis=0, mode="nearest")
    return total / np.maximum(weight, 0.1).reshape(-1, *[1] * (total.ndim - 1))


def _envelope(values: NDArray, fps: float) -> FloatArray:
    """Return a smooth course ``[T]`` that is nowhere below the given one."""
    reach = max(1, round(_SINK_TIME * fps))
    highest = maximum_filter1d(values, 2 * reach + 1, mode="nearest")
    return gaussian_filter1d(highest, 0.4 * reach, radius=reach, mode="nearest")


def _place(
    figure: Figure, side: str, stance: Stance, rest: float, fps: float, most: float
) -> _Place:
    """Return where a foot stands; see the top of this file."""
    frame, offset = figure.frame(f"{side}_ankle"), _offset(figure, side)
    turn = bridge(_attitude(frame, offset, stance.flat), stance.flat, round(_EASE * fps))
    bone = apply(turn_about(turn) @ frame, offset)
    path = figure.point(f"{side}_foot")
    ankle = figure.point(f"{side}_ankle")
    goal, down, glides = path.copy(), np.zeros(len(path), dtype=bool), False
    for at in runs(stance.toe):
        middle = np.median(path[at], axis=0)
        middle[2] = rest
        if np.linalg.norm(path[at] - middle, axis=1).max() > most:
            glides = True
            continue
        goal[at], down[at] = middle, True
    free = ~(stance.heel | stance.toe)
    _linger(path, goal, down, free, rest, fps)
    _give_time(goal, down, fps)
    ball = down.copy()
    for at in runs(stance.heel & ~stance.toe):
        beside = [k for k in (at.start - 1, at.stop) if 0 <= k < len(down) and down[k]]
        # Between two flat stances the heel would have to jump from one to the other.
        if len(beside) == 1 and stance.flat[beside[0]]:
            stand = goal[beside[0]] - bone[beside[0]]
            if np.linalg.norm(ankle[at] - stand, axis=1).max() <= most:
                # A foot that stands on its heel has its ball up; else the heel is not what stands.
                up = stand[2] + bone[at, 2] >= rest
                goal[at][up] = stand + bone[at][up]
                down[at] = up
    return _Place(down, ball, goal, turn, glides)


def _linger(
    path: FloatArray,
    goal: FloatArray,
    down: NDArray[np.bool_],
    free: NDArray[np.bool_],
    rest: float,
    fps: float,
) -> None:
    """Let a ball stand as long as it is hardly off the floor; see the top of this file.

    Args:
        path: ``[T, 3]`` m, of the ball.
        goal: ``[T, 3]`` m, where it goes while ``down``; is changed.
        down: ``[T]``, when it stands; is changed.
        free: ``[T]``, when neither ball nor heel were found to stand.
        rest: Height of a standing ball, m.
        fps: Frames per second.
    """
    near = free & (path[:, 2] < rest + _BARELY)
    for gap in runs(~down):
        # Both ends take of the same time, and leave enough of it for a step.
        most = max(0, (gap.stop - gap.start - round(_SWING * fps)) // 2)
        ends = [(gap.start - 1, range(gap.start, gap.start + most))] if gap.start else []
        if gap.stop < len(down):
            ends.append((gap.stop, range(gap.stop - 1, gap.stop - 1 - most, -1)))
        for stand, moments in ends:
            for k in moments:
                if not near[k] or np.linalg.norm(path[k, :2] - goal[stand, :2]) > _BESIDE:
                    break
                goal[k], down[k] = goal[stand], True


def _give_time(goal: FloatArray, down: NDArray[np.bool_], fps: float) -> None:
    """Let a step between two places take as long as a step takes, at the cost of both stances.

    Args:
        goal: ``[T, 3]`` m, where the ball goes while ``down``.
        down: ``[T]``, when it stands; is changed.
        fps: Frames per second.
    """
    least = round(_SWING * fps)
    for gap in runs(~down):
        short = least - (gap.stop - gap.start)
        if not (gap.start and gap.stop < len(down)) or short <= 0:
            continue
        if np.linalg.norm(goal[gap.stop] - goal[gap.start - 1]) > _SHUFFLE:
            first = max(0, gap.start - (short + 1) // 2)
            down[first : gap.stop + short // 2] = False


def _offset(figure: Figure, side: str) -> FloatArray:
    return figure.skeleton.offsets[figure.skeleton.index(f"{side}_foot")]


def _attitude(frame: NDArray, offset: NDArray, flat: NDArray[np.bool_]) -> FloatArray:
    """Return rotation vectors ``[T, 3]`` that give flat feet one attitude per stance.

    Heading: the median of the stance, unless the foot pivots on the spot. Inclination of the bone
    from ankle to ball: the median of all flat moments, which is this body's own. Roll: none.
    """
    turn = np.zeros((len(frame), 3))
    if not flat.any():
        return turn
    bone = apply(frame, offset)
    drop = np.arctan2(-bone[:, 2], np.linalg.norm(bone[:, :2], axis=1))
    own = np.arctan2(-offset[2], np.linalg.norm(offset[:2]))
    pitch = Rotation.from_euler("y", float(np.median(drop[flat]) - own)).as_matrix()
    heading = np.arctan2(frame[:, 1, 0], frame[:, 0, 0])
    for at in runs(flat):
        course = np.unwrap(heading[at])
        pivots = np.ptp(course) > _PIVOT
        attitude = yaw(course if pivots else np.full_like(course, np.median(course))) @ pitch
        turn[at] = Rotation.from_matrix(attitude @ np.swapaxes(frame[at], -1, -2)).as_rotvec()
    return turn


def _common(figure: Figure, places: list[_Place], fps: float) -> FloatArray:
    """Return by how much the pelvis follows its feet ``[T, 3]`` m, along the floor."""
    total, count = np.zeros((len(figure), 3)), np.zeros(len(figure))
    for side, place in zip(SIDES, places, strict=True):
        total += (place.toe - figure.point(f"{side}_foot")) * place.down[:, None]
        count += place.down
    return _FOLLOW * _averaged(total, count, fps) * (1.0, 1.0, 0.0)


def _goal(
    figure: Figure, side: str, place: _Place, rest: float, fps: float
) -> tuple[FloatArray, FloatArray]:
    """Return where the ankle of a foot goes ``[T, 3]`` m, and how far its ball moves ``[T]`` m."""
    path = figure.point(f"{side}_foot")
    shift = bridge(place.toe - path, place.down, round(_EASE * fps))
    toe, offset = path + shift, _offset(figure, side)
    clear = _CLEAR * _since(place.down, _CLEAR_TIME * fps)
    toe[:, 2] = _above(toe[:, 2], rest + _lift(place, fps), clear)
    ankle = toe - apply(turn_about(place.turn) @ figure.frame(f"{side}_ankle"), offset)
    lifted = _above(ankle[:, 2], rest - _RISE * min(float(offset[2]), 0.0), clear)
    ankle[:, 2] = np.where(place.down, ankle[:, 2], lifted)
    return ankle, np.linalg.norm(shift, axis=1)


def _lift(place: _Place, fps: float) -> FloatArray:
    """Return how high over its stance a ball is at least while it steps ``[T]`` m."""
    lift = np.zeros(len(place.down))
    for gap in runs(~place.down):
        steps = gap.stop - gap.start + 1
        if gap.start == 0 or gap.stop == len(lift) or steps > _STEP * fps:
            continue
        length = float(np.linalg.norm((place.toe[gap.stop] - place.toe[gap.start - 1])[:2]))
        u = np.arange(1, steps) / steps
        lift[gap] = min(_LIFT * length, _LIFT_MOST) * (4 * u * (1 - u)) ** 2
    return lift


def _since(down: NDArray[np.bool_], frames: float) -> FloatArray:
    """Return 0 in stances, rising to 1 within some frames before and after ``[T]``."""
    if not down.any():
        return np.ones(len(down))
    away = np.asarray(distance_transform_edt(~down))
    return np.minimum(away / max(frames, 1.0), 1.0)


def _above(heights: NDArray, least: float | FloatArray, soft: NDArray) -> FloatArray:
    """Return heights ``[T]`` m that keep above a bound, turning softly where ``soft`` is not 0."""
    over = heights - least
    return least + 0.5 * (over + np.sqrt(over**2 + soft**2))


def _sink(figure: Figure, ankles: list[FloatArray], fps: float) -> FloatArray:
    """Return by how much the pelvis sinks ``[T]`` m so that both legs reach."""
    needed = np.zeros(len(figure))
    for side, ankle in zip(SIDES, ankles, strict=True):
        hip = figure.point(f"{side}_hip")
        lengths = figure.skeleton.bone_lengths
        longest = _LONGEST * float(
            lengths[figure.skeleton.index(f"{side}_knee")]
            + lengths[figure.skeleton.index(f"{side}_ankle")]
        )
        level = np.linalg.norm((ankle - hip)[:, :2], axis=1)
        height = np.sqrt(np.maximum(longest**2 - level**2, (0.3 * longest) ** 2))
        needed = np.maximum(needed, hip[:, 2] - ankle[:, 2] - height)
    return _envelope(np.maximum(needed, 0.0), fps)
