"""Inverse kinematics of both robots in one model, moment by moment, with mink.

Costs are divided by limb lengths, so that a metre weighs the same for a hand-high robot as for a
human-high one against the radians of feet and heads. A touch is one task over both robots: it sees
only the vector from one hand to the other, so the two find their meeting point themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bridge.retarget.avoid import AvoidTask
from bridge.retarget.build import Build
from bridge.retarget.stage import Actor, Stage
from bridge.retarget.targets import Targets
from bridge.retarget.touch import Touch
from robots.errors import LimitViolation
from robots.skeleton import FloatArray

SOLVER = "daqp"
CLEARANCE = 0.002
"""Distance that bodies of the two robots keep, m."""
DAMPING = 1e-4
"""Levenberg-Marquardt damping of every solve, rad^-2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """Weights of the tasks: per limb length for positions, per rad for orientations."""

    hand: float = 1.0
    elbow: float = 0.35
    ankle: float = 3.0
    base: float = 2.0
    foot: float = 0.6
    torso: float = 1.0
    head: float = 0.15
    touch: float = 12.0
    """Of hands that meet; a hand on a chest gets a tenth."""
    avoid: float = 6.0
    """Of bodies of the two robots that overlap."""
    rest: float = 0.01
    calm: float = 0.2
    """On the motion itself, which calms redundant joints."""


class TouchTask(mink.Task):
    """Holds two landmarks of two robots at a distance, wherever that may be."""

    def __init__(self, sites: tuple[int, int], gap: float) -> None:
        """Take the two site ids and the distance, m."""
        super().__init__(cost=np.zeros(3))
        self._sites, self._gap = sites, gap

    def set_weight(self, weight: float) -> None:
        """Set the cost, 1/m."""
        self.cost = np.full(3, weight)

    def compute_error(self, configuration: mink.Configuration) -> NDArray:
        """Return how far the second point is from where it should be, seen from the first."""
        a, b = (configuration.data.site_xpos[site] for site in self._sites)
        between = b - a
        return between - self._gap * between / max(float(np.linalg.norm(between)), 1e-9)

    def compute_jacobian(self, configuration: mink.Configuration) -> NDArray:
        """Return the derivative of the error, with the direction between the points held."""
        model, data = configuration.model, configuration.data
        a, b = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, a, None, self._sites[0])
        mujoco.mj_jacSite(model, data, b, None, self._sites[1])
        return b - a


class _Follower:
    """The tasks of one robot, and how to point them at a moment's targets."""

    def __init__(self, stage: Stage, actor: Actor, build: Build, costs: Costs, targets: Targets):
        self.tasks: list[Any] = []
        self._moves: list[Callable[[int], None]] = []
        self.hands: dict[str, mink.FrameTask] = {}
        site = f"{actor.person}/landmark:"
        for name, path in targets.points.items():
            part = name.partition("_")[2]
            length = build.leg_length if part == "ankle" else build.arm_length
            feet = targets.feet.get(name.partition("_")[0]) if part == "ankle" else None
            task = mink.FrameTask(
                site + name,
                "site",
                position_cost=getattr(costs, part) / length,
                orientation_cost=costs.foot if feet is not None else 0.0,
            )
            self._follow(task, path, feet)
            if part == "hand":
                self.hands[name] = task
        self._hand_cost = costs.hand / build.arm_length
        if actor.free:
            root = stage.model.body(actor.root).name
            task = mink.FrameTask(root, "body", costs.base / build.leg_length, costs.torso)
            self._follow(task, targets.base, targets.torso)
        else:
            self._follow(mink.FrameTask(build.torso, "body", 0.0, costs.torso), None, targets.torso)
        if "head" in actor.sites:
            task = mink.FrameTask(site + "head", "site", 0.0, costs.head)
            self._follow(task, None, targets.head)

    def _follow(self, task: Any, path: FloatArray | None, turn: Rotation | None) -> None:
        quaternions = None if turn is None else turn.as_quat(scalar_first=True)
        nowhere, unturned = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])

        def move(t: int) -> None:
            q = unturned if quaternions is None else quaternions[t]
            p = nowhere if path is None else path[t]
            task.set_target(mink.SE3(np.concatenate([q, p])))

        self.tasks.append(task)
        self._moves.append(move)

    def move(self, t: int) -> None:
        """Point every task at the targets of moment t."""
        for move in self._moves:
            move(t)

    def ease(self, name: str, weight: float) -> None:
        """Let a hand go where its touch wants it, as far as the touch weighs."""
        self.hands[name].set_position_cost(self._hand_cost * (1.0 - 0.9 * weight))


def solve(
    stage: Stage,
    builds: tuple[Build, Build],
    targets: tuple[Targets, Targets],
    touching: list[Touch],
    *,
    fps: float,
    costs: Costs,
    iterations: int,
    progress: Callable[[float], None] | None = None,
) -> FloatArray:
    """Return ``qpos [T, nq]`` of both robots.

    Args:
        stage: The model; fixed bases are placed already.
        builds: Measures of both robots.
        targets: Where everything should be, in the stage's frame.
        touching: Touches to keep.
        fps: Moments per second of the targets.
        costs: Weights.
        iterations: Solves per moment; the first moment takes many more.
        progress: Told the share done.

    Raises:
        LimitViolation: The solver found no posture within the limits.
    """
    model = stage.model
    count = len(targets[0].base)
    dt = 1.0 / fps
    followers = [
        _Follower(stage, actor, build, costs, target)
        for actor, build, target in zip(stage.actors, builds, targets, strict=True)
    ]
    configuration = mink.Configuration(model, _start(stage, targets))
    posture = mink.PostureTask(model, cost=_joint_costs(stage, costs.rest))
    posture.set_target(_start(stage, targets))
    calm = mink.DampingTask(model, cost=_joint_costs(stage, costs.calm))
    arm = 0.5 * (builds[0].arm_length + builds[1].arm_length)
    meetings = [
        (
            touch,
            TouchTask((stage.actors[0].sites[touch.a], stage.actors[1].sites[touch.b]), touch.gap),
        )
        for touch in touching
    ]
    tasks = [task for follower in followers for task in follower.tasks]
    avoid = AvoidTask(model, CLEARANCE, costs.avoid / arm)
    tasks += [posture, calm, avoid, *(task for _, task in meetings)]
    limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, _speeds(stage))]
    out = np.empty((count, model.nq))
    for t in range(count):
        for follower in followers:
            follower.move(t)
        _weigh(followers, meetings, t, costs.touch / arm)
        rounds = iterations if t else 30 * iterations
        for _ in range(rounds):
            # Only a moment's own step counts against the speed limits, not finding the start.
            step = dt / rounds if t else 10.0
            try:
                velocity = mink.solve_ik(
                    configuration, tasks, step, SOLVER, damping=DAMPING, limits=limits
                )
            except mink.MinkError as error:
                raise LimitViolation(
                    f"no posture within the joint limits: {error}", where=f"{t / fps:.2f} s"
                ) from error
            configuration.integrate_inplace(velocity, step)
        out[t] = configuration.q
        if progress and t % 8 == 0:
            progress(t / count)
    return out


def _weigh(
    followers: list[_Follower], meetings: list[tuple[Touch, TouchTask]], t: int, cost: float
) -> None:
    eased: list[dict[str, float]] = [{}, {}]
    for touch, task in meetings:
        weight = float(touch.weight[t])
        task.set_weight(cost * weight * (1.0 if touch.of_hands else 0.1))
        for side, name in zip(eased, (touch.a, touch.b), strict=True):
            if touch.of_hands:
                side[name] = max(side.get(name, 0.0), weight)
    for follower, weights in zip(followers, eased, strict=True):
        for name in follower.hands:
            follower.ease(name, weights.get(name, 0.0))


def _start(stage: Stage, targets: tuple[Targets, Targets]) -> FloatArray:
    """Return the rest pose, with free bases where their targets begin."""
    qpos = np.array(stage.model.qpos0)
    for actor, target in zip(stage.actors, targets, strict=True):
        qpos[actor.qpos] = actor.robot.rest
        if actor.free:
            pose = [*target.base[0], *target.torso[0].as_quat(scalar_first=True)]
            qpos[actor.base_qpos : actor.base_qpos + 7] = pose
    return qpos


def _joint_costs(stage: Stage, cost: float) -> FloatArray:
    costs = np.zeros(stage.model.nv)
    for actor in stage.actors:
        costs[actor.dof] = cost
    return costs


def _speeds(stage: Stage) -> dict[str, float]:
    return {
        f"{actor.person}/{joint.name}": joint.max_velocity
        for actor in stage.actors
        for joint in actor.robot.joints
    }
