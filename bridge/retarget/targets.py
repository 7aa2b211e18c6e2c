"""Where each part of a robot should be: limb-normalised targets.

A robot is no scaled human: its arms may be twice as long for its legs. So directions come from the
human and lengths from the robot, limb by limb: an elbow target is the robot's own shoulder plus the
robot's upper-arm length along the human's upper arm. Feet walk on the human's steps scaled by leg
length. How far apart two robots stand is another unknown: :mod:`bridge.retarget.placement`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial.transform import Rotation

from bridge.retarget.build import SIDES, Build
from bridge.retarget.human import Person
from robots.skeleton import FloatArray

MOST_TIPPED = 0.5
"""Sine of the steepest pitch of a foot."""
CLEARANCE = 0.005
"""Hands and elbows stay this far above the floor or table, m."""
LEG_REACH = 0.985
"""A leg is never asked to stretch further than this share of its length: straight knees jerk."""


@dataclass(frozen=True, slots=True, eq=False)
class Targets:
    """Targets of one robot over time, in the frame of the stage."""

    torso: Rotation
    """``[T]``, rest frame to stage."""
    head: Rotation
    """``[T]``, rest frame to stage."""
    points: dict[str, FloatArray]
    """``[T, 3]`` m by landmark: elbows, hands, and ankles of robots with legs."""
    feet: dict[str, Rotation]
    """``[T]`` by side, for robots with legs."""
    base: FloatArray
    """``[T, 3]`` m, position of the base; constant for a fixed one."""

    def shifted(self, offset: NDArray) -> Targets:
        """Return these targets moved by ``[3]`` or ``[T, 3]`` m."""
        points = {name: path + offset for name, path in self.points.items()}
        return replace(self, points=points, base=self.base + offset)

    def turned(self, yaw: float | NDArray) -> Targets:
        """Return these targets turned about the stage's origin by rad, one or ``[T]``."""
        count = len(self.base)
        turn = about_up(np.broadcast_to(yaw, count))
        return Targets(
            torso=turn * self.torso,
            head=turn * self.head,
            points={name: turn.apply(path) for name, path in self.points.items()},
            feet={side: turn * foot for side, foot in self.feet.items()},
            base=turn.apply(self.base),
        )


def about_up(yaw: NDArray) -> Rotation:
    """Return rotations by ``[T]`` rad about the vertical."""
    return Rotation.from_rotvec(np.outer(yaw, [0.0, 0.0, 1.0]))


def standing_targets(person: Person, build: Build) -> Targets:
    """Return the targets of a robot that stands on its own legs, before placement."""
    scale = build.leg_length / person.leg_length
    torso = person.torso
    middle = np.mean(list(build.hips.values()), axis=0)
    hips = scale * person.hips
    hips[:, 2] = build.ankle_height + scale * (person.hips[:, 2] - person.floor)
    base = hips - torso.apply(middle)
    points, feet = {}, {}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        ankle = scale * person.motion.point(f"{side}_ankle")
        height = np.maximum(ankle[:, 2] - scale * person.floor, 0.0)
        ankle[:, 2] = build.ankle_height + height
        # The robot's hips are not as wide as scaled human ones: its feet stand under its own.
        wider = abs(build.hips[side][1]) - 0.5 * scale * person.hip_width
        left = np.stack([-np.sin(person.heading), np.cos(person.heading)], axis=1)
        ankle[:, :2] += sign * wider * left
        points[f"{side}_ankle"] = ankle
        # A foot tips only as far as its height leaves room under toe and heel.
        yaw, pitch = person.foot(side).T
        room = np.arcsin(np.clip(height / build.foot_reach, 0.0, MOST_TIPPED))
        pitch = np.clip(pitch, -room, room)
        feet[side] = Rotation.from_euler("ZY", np.stack([yaw, -pitch], axis=1))
    base[:, 2] -= _too_high(base, torso, points, build, person.motion.fps)
    targets = Targets(torso, person.head, points, feet, base)
    return _with_arms(targets, person, build, base + torso.apply(build.torso_from_base))


def seated_targets(person: Person, build: Build) -> Targets:
    """Return the targets of a robot on a fixed base at the origin that faces +x.

    Everything is seen from the person's own pelvis: where the person walks or turns, the robot
    does not follow; its waist turns as the chest turns against the pelvis.
    """
    still = about_up(-person.heading)
    base = np.zeros((len(person.heading), 3))
    targets = Targets(still * person.torso, still * person.head, {}, {}, base)
    yaw = targets.torso.as_euler("ZYX")[:, 0]
    torso = about_up(yaw)
    targets = replace(targets, torso=torso)
    return _with_arms(targets, person, build, base + build.torso_from_base, still)


def _with_arms(
    targets: Targets,
    person: Person,
    build: Build,
    torso: NDArray,
    seen: Rotation | None = None,
) -> Targets:
    points = dict(targets.points)
    for side in SIDES:
        upper = person.limb(f"{side}_shoulder", f"{side}_elbow")
        lower = person.limb(f"{side}_elbow", f"{side}_hand")
        if seen is not None:
            upper, lower = seen.apply(upper), seen.apply(lower)
        shoulder = torso + targets.torso.apply(build.shoulders[side])
        elbow = shoulder + build.arm[0] * upper
        hand = elbow + build.arm[1] * lower
        for name, path in ((f"{side}_elbow", elbow), (f"{side}_hand", hand)):
            path[:, 2] = np.maximum(path[:, 2], build.radii[name] + CLEARANCE)
            points[name] = path
    return replace(targets, points=points)


def _too_high(
    base: NDArray, torso: Rotation, points: dict[str, FloatArray], build: Build, fps: float
) -> FloatArray:
    """Return how far the base must come down ``[T]`` m, for both legs to reach their feet."""
    need = np.zeros(len(base))
    for side in SIDES:
        leg = base + torso.apply(build.hips[side]) - points[f"{side}_ankle"]
        reach = (LEG_REACH * build.leg_length) ** 2 - (leg[:, :2] ** 2).sum(axis=1)
        need = np.maximum(need, leg[:, 2] - np.sqrt(np.maximum(reach, 0.0)))
    window = max(int(0.2 * fps), 1)
    return gaussian_filter1d(maximum_filter1d(need, 2 * window + 1), window / 2, mode="nearest")
