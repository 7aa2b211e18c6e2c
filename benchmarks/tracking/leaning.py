"""Duets in which people bear each other's weight, and how well they are tracked.

    python -m benchmarks.tracking.leaning [--only backs] [--angle 12] [--recovery 0]

Each person is tipped about the ankles until the weight is past the sole, so that who is not held
falls. Hands, or backs, are pressed into the other by 4 mm at full lean. Nothing here pulls: hands
do not grip, so people who hang from each other's hands cannot be simulated.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.choreographer.arms import ELBOW_BACK, HANGING, within_reach
from generator.choreographer.curves import window
from generator.choreographer.frames import apply, pitch, two_bones, yaw
from generator.choreographer.role import Build, outward
from generator.choreographer.style import SIDES
from generator.kinematics import continuous, forward_kinematics, to_wxyz, unit
from generator.motion import DuetMotion, Motion
from robots.errors import DuetError
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray, human_skeleton
from sim.controllers.ilqr.settings import IlqrSettings
from sim.metrics.penetration import overlap
from sim.outcome import Cost
from sim.rollout import Rollout
from sim.scene import Scene, build_scene
from sim.track import TrackSettings, track

Pair = tuple["Stance", "Stance"]

FPS = 30.0
SECONDS = 4.5
_REACH, _TIP, _HOLD, _RISE, _DROP = 0.3, 1.0, 1.8, 3.3, 4.0
"""Hands leave; people are at full lean; until; upright again; hands are back; s."""
DEPTH = 0.004
"""How deep people are in each other at full lean, m."""
_ARM = 0.5
"""From the shoulder that leans to the trunk that is leaned on, about, m."""
_SHOULDER = 1.37
"""Height of the shoulder above the ankle, m."""
_BRACED = 0.5
"""Lean of who is leaned on, against it, as a share of the other's: at 1 both would press on the
same place under their feet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stance:
    """One person's part."""

    place: float
    """Of the ankles along x, m."""
    facing: float = 0.0
    """Heading, rad; 0 faces +x."""
    angle: float = 0.0
    """Tip forward at full lean, rad."""
    quick: float = 1.0
    """How many times faster than usual the lean comes."""
    hands: tuple[float, float, float] | None = None
    """Where the hands go: forward, outward, up from the partner's upper spine, in its frame, m;
    ``None`` lets them hang."""
    elbow: tuple[float, float, float] = (-0.3, 0.8, -0.8)
    """Where the elbows of arms that bear weight point: forward, outward, up."""


def facing(press: float, angle: float) -> Pair:
    """Return two people who lean on each other's chest with both hands."""
    half = (_ARM + _SHOULDER * 2 * np.sin(angle)) / 2
    inside, around = (0.0, 0.1, -1.0), (0.0, 1.0, 0.0)
    return (
        Stance(place=-half, angle=angle, hands=(0.115 - press, 0.03, 0.05), elbow=inside),
        Stance(
            place=half, facing=np.pi, angle=angle, hands=(0.09 - press, 0.14, 0.12), elbow=around
        ),
    )


def backs(press: float, angle: float) -> Pair:
    """Return two people who lean back against each other's back."""
    half = 0.1 + _SHOULDER * np.sin(angle) - press
    return Stance(place=-half, facing=np.pi, angle=-angle), Stance(place=half, angle=-angle)


def shoulders(press: float, angle: float) -> Pair:
    """Return one person who leans with both hands on the back of another, who leans against."""
    behind = _ARM + _SHOULDER * (np.sin(angle) + np.sin(_BRACED * angle))
    return (
        Stance(place=-behind, angle=angle, hands=(-0.095 + press, 0.09, 0.10)),
        Stance(place=0.0, angle=-_BRACED * angle),
    )


def shove(press: float, angle: float) -> Pair:
    """Return one person who throws both hands against the chest of another, who braces."""
    before = _ARM + _SHOULDER * (np.sin(angle) + np.sin(_BRACED * angle))
    return (
        Stance(place=-before, angle=angle, quick=2.0, hands=(0.115 - press, 0.09, 0.09)),
        Stance(place=0.0, facing=np.pi, angle=_BRACED * angle),
    )


LEANS: Mapping[str, tuple[Callable[[float, float], Pair], float]] = MappingProxyType(
    {
        "facing": (facing, 15.0),
        "backs": (backs, 10.0),
        "shoulders": (shoulders, 15.0),
        "shove": (shove, 15.0),
    }
)
"""Who leans on whom, and by how many degrees."""


def leaning(name: str, angle: float | None = None) -> DuetMotion:
    """Return a duet of :data:`LEANS` in which people touch.

    Args:
        name: Which.
        angle: Lean, degrees; as listed if not given.
    """
    make, usual = LEANS[name]
    lean = np.radians(usual if angle is None else angle)
    body = HumanBody.of(human_skeleton())
    scene = build_scene((body, body))
    least, most = -0.1, 0.1
    for _ in range(10):
        press = (least + most) / 2
        deep = _depth(scene, make(press, lean)) > DEPTH
        least, most = (least, press) if deep else (press, most)
    times = np.arange(round(SECONDS * FPS) + 1) / FPS
    return replace(_duet(make(least, lean), times), text=f"{name}, {np.degrees(lean):.0f} degrees")


def _depth(scene: Scene, stances: Pair) -> float:
    """Return how deep the two are in each other at full lean, m."""
    duet = _duet(stances, np.full(2, _HOLD))
    rotations = [p.rotations for p in duet.people if p.rotations is not None]
    qpos = scene.qpos(duet.keypoints[:, :, 0], np.stack(rotations, axis=1))
    return float(overlap(scene, qpos[:1]).depth[0])


def _duet(stances: Pair, times: NDArray) -> DuetMotion:
    build = Build.of(human_skeleton())
    trunks = [_trunk(build, stance, times) for stance in stances]
    people = []
    for p, stance in enumerate(stances):
        root, frames = trunks[p]
        _pose_arms(build, stance, times, root, frames, trunks[1 - p])
        skeleton = build.skeleton
        parents = list(skeleton.parents[1:])
        local = frames.copy()
        local[:, 1:] = np.swapaxes(frames[:, parents], -1, -2) @ frames[:, 1:]
        turns = to_wxyz(Rotation.from_matrix(local.reshape(-1, 3, 3)))
        rotations = continuous(turns.reshape(*local.shape[:2], 4))
        points = forward_kinematics(skeleton, root, rotations)
        people.append(Motion(FPS, points, rotations, skeleton=skeleton))
    return DuetMotion(people[0], people[1], source="pasdedeux leaning", licence="CC0-1.0")


def _trunk(build: Build, stance: Stance, times: NDArray) -> tuple[FloatArray, FloatArray]:
    """Return root ``[T, 3]`` m and frames ``[T, J, 3, 3]`` of a person tipped about the ankles."""
    names = build.skeleton.names
    start = _TIP - (_TIP - _REACH) / stance.quick
    tip = stance.angle * window(times, start, _TIP, _HOLD + 0.5, _RISE)
    upright = yaw(np.full(len(times), stance.facing))
    frames = np.repeat((upright @ pitch(tip))[:, None], len(names), axis=1)
    for side in SIDES:
        for joint in ("ankle", "foot"):
            frames[:, names.index(f"{side}_{joint}")] = upright
    leg = sum(build.offset(f"left_{n}") for n in ("hip", "knee", "ankle")) * (1.0, 0.0, 1.0)
    sole = build.offset("left_foot")[2] - 0.02 * build.scale
    ankle = np.array([stance.place, 0.0, -sole])
    return ankle - apply(frames[:, 0], leg), frames


def _pose_arms(
    build: Build,
    stance: Stance,
    times: NDArray,
    root: NDArray,
    frames: NDArray,
    partner: tuple[FloatArray, FloatArray],
) -> None:
    """Turn both arms in ``frames`` towards where the hands go."""
    names = build.skeleton.names
    spine = sum(build.offset(n) for n in ("spine1", "spine2", "spine3"))
    reach = window(times, _REACH, _TIP, _HOLD + 0.5, _DROP)[:, None]
    for side in SIDES:
        out = outward(side)
        hang = np.array([0.07, 0.17 * out, -1.0])
        to_shoulder = spine + build.offset(f"{side}_collar") + build.offset(f"{side}_shoulder")
        trunk = frames[:, 0]
        shoulder = root + apply(trunk, to_shoulder)
        level = yaw(np.full(len(times), stance.facing))
        goal = shoulder + apply(level, unit(hang) * HANGING * build.arm)
        pole = np.broadcast_to(ELBOW_BACK, goal.shape) * (1.0, out, 1.0)
        if stance.hands is not None:
            there = partner[0] + apply(partner[1][:, 0], spine)
            forward, aside, up = stance.hands
            # On the own left lies the partner's right where the two face each other.
            same = float(np.sign(np.median(trunk[:, 0, 0] * partner[1][:, 0, 0, 0])))
            spot = there + apply(partner[1][:, 0], [forward, aside * out * same, up])
            goal = goal + reach * (spot - goal)
            pole = pole + reach * (np.array(stance.elbow) * (1.0, out, 1.0) - pole)
        upper, lower = two_bones(
            shoulder,
            shoulder + within_reach(goal - shoulder, build.arm),
            apply(trunk, pole),
            (build.offset(f"{side}_elbow"), build.offset(f"{side}_wrist")),
            (0.0, 0.0, -out),
            tip=1.0 + build.skeleton.hand_per_forearm,
        )
        frames[:, names.index(f"{side}_shoulder")] = upper
        for joint in ("elbow", "wrist"):
            frames[:, names.index(f"{side}_{joint}")] = lower


def borne(rollout: Rollout) -> float:
    """Return the mean force between the two people while they lean, N."""
    scene = rollout.scene()
    model, data = scene.model, mujoco.MjData(scene.model)
    owner = np.zeros(model.ngeom, dtype=int)
    for p, at in enumerate(scene.maps):
        owner[at.geoms] = p + 1
    moments = np.flatnonzero((rollout.times >= _TIP) & (rollout.times <= _HOLD + 0.3))
    total, force = 0.0, np.zeros(6)
    for t in moments:
        data.qpos[:], data.qvel[:], data.ctrl[:] = rollout.qpos[t], rollout.qvel[t], rollout.ctrl[t]
        mujoco.mj_forward(model, data)
        between, world = np.zeros(3), np.zeros(3)
        for c in range(data.ncon):
            pair = data.contact.geom[c]
            if sorted(owner[pair]) == [1, 2]:
                mujoco.mj_contactForce(model, data, c, force)
                world = data.contact.frame[c].reshape(3, 3).T @ force[:3]
                between += world if owner[pair[0]] == 1 else -world
        total += float(np.linalg.norm(between))
    return total / max(len(moments), 1)


VARIANTS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "everything": {},
        "yielding ghost": {"ghost": "yielding"},
        "rigid ghost": {"ghost": True},
        "without ghost": {"ghost": False},
    }
)
"""Names of variants and the fields of ``IlqrSettings`` that make them."""


def measure(motion: DuetMotion, settings: IlqrSettings) -> list[str]:
    """Return the cells of a row: falls, errors, recoveries, force borne and cost."""
    start = Cost.now()
    rollout = track(motion, settings=TrackSettings(ilqr=settings))
    cost = Cost.now().since(start)
    falls = [f"{p} at {t:.1f} s" for p, t in rollout.fall_time.items() if t is not None]
    return [
        ", ".join(falls) or "nobody",
        f"{1000 * rollout.error.mean():.0f} mm",
        f"{1000 * rollout.error.max():.0f} mm",
        str(len(rollout.metadata["recoveries"])),
        f"{borne(rollout):.0f} N",
        f"{cost.cpu / rollout.times[-1]:.1f}",
    ]


def main() -> int:
    """Track the duets and print a table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tracking.leaning", description=__doc__
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--only", default="", help="duets whose names contain this")
    parser.add_argument("--angle", type=float, help="lean of all, degrees")
    parser.add_argument("--variant", default="everything", choices=tuple(VARIANTS))
    parser.add_argument("--recovery", type=int, default=8, help="most tries after a fall")
    args = parser.parse_args()
    settings = IlqrSettings(**VARIANTS[args.variant], recovery=args.recovery)
    print("| duet | falls | mpjpe | furthest off | recoveries | borne | CPU-s per s |")
    print("|---|---|---|---|---|---|---|")
    try:
        for name in (n for n in LEANS if args.only in n):
            motion = leaning(name, args.angle)
            print(f"| {motion.text} | {' | '.join(measure(motion, settings))} |", flush=True)
    except DuetError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
