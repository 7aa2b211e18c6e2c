"""Refines both robots over a whole stretch of time at once, after moment-by-moment kinematics.

**The problem.** Kinematics solved moment by moment cannot look ahead: joints jerk where a target
turns, and a robot that starts to run into its partner learns so too late. Here all poses of a
stretch are one unknown. The cost is the sum over time of squared residuals: distance of landmarks
from their targets (per limb length), orientations, the gap of touches, penetration found by
MuJoCo's collision, and joint accelerations. It is solved by Gauss-Newton. A frame couples only to
its two neighbours on each side, through the accelerations, so the normal matrix is banded: one
step over T frames with D degrees of freedom costs O(T D^3) operations.

Joint ranges are hard: a joint at its limit that is pushed outward is taken out of the step, and
what still steps over is brought back. Long motions are solved in stretches that overlap.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bridge.retarget.bands import second_difference_bands, solve_blocks
from bridge.retarget.build import Build
from bridge.retarget.stage import Actor, Stage
from bridge.retarget.targets import Targets
from bridge.retarget.touch import Touch
from robots.errors import LimitViolation
from robots.skeleton import FloatArray

STRETCH = 400
"""Most frames solved at once."""
OVERLAP = 60
"""Frames of a stretch that the next one solves again."""
CLEARANCE = 0.003
"""Robots keep at least this far from each other and from themselves where nothing touches, m."""
LONGEST_STEP = 0.2
"""Most a joint moves in one step, rad: limbs must not jump through each other."""
NEAR_LIMIT = 1e-6
"""rad; a joint this close to its limit is at it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PolishCosts:
    """Weights: per limb length for positions, per rad for orientations."""

    hand: float = 1.0
    elbow: float = 0.3
    ankle: float = 4.0
    base: float = 1.5
    foot: float = 0.6
    torso: float = 0.8
    head: float = 0.15
    touch: float = 8.0
    """Of hands that meet; a hand on a chest gets a tenth."""
    collision: float = 5.0
    """On robots overlapping, per arm length. More, and thin limbs jump through each other."""
    floor: float = 25.0
    """On sinking into the floor, per arm length."""
    rest: float = 0.02
    inertia: float = 0.08
    """Time constant of the low-pass that acceleration costs amount to, s."""
    damping: float = 0.15
    """On each step, per rad: stretched limbs, whose joints hardly count, would swing about."""


@dataclass(frozen=True, slots=True, eq=False)
class _Goals:
    """What to reach: R position rows and orientation rows, each three residuals over T."""

    sites: list[int]
    """Site id of each position goal."""
    positions: FloatArray
    """``[T, P, 3]`` m."""
    position_weights: FloatArray
    """``[T, P]`` 1/m."""
    bodies: list[int]
    """Body id of each orientation goal."""
    orientations: FloatArray
    """``[T, O, 3, 3]``, body to stage."""
    orientation_weights: FloatArray
    """``[O]`` 1/rad."""


def polish(
    stage: Stage,
    builds: tuple[Build, Build],
    targets: tuple[Targets, Targets],
    touching: list[Touch],
    qpos: NDArray,
    *,
    fps: float,
    costs: PolishCosts | None = None,
    iterations: int = 8,
    progress: Callable[[float], None] | None = None,
) -> FloatArray:
    """Return ``qpos [T, nq]`` refined over time.

    Args:
        stage: The model; fixed bases are placed already.
        builds: Measures of both robots.
        targets: Where everything should be, in the stage's frame.
        touching: Touches to keep.
        qpos: ``[T, nq]``, where to start: inside the limits and near the answer.
        fps: Moments per second.
        costs: Weights.
        iterations: Gauss-Newton steps per stretch.
        progress: Told the share done.

    Raises:
        LimitViolation: The equations could not be solved.
    """
    solver = _Polisher(stage, builds, targets, touching, fps, costs or PolishCosts())
    out = np.array(qpos, dtype=float)
    solver.keep_limits(out)
    count = len(out)
    starts = range(0, max(count - OVERLAP, 1), STRETCH - OVERLAP)
    for number, start in enumerate(starts):
        stop = min(start + STRETCH, count)
        for iteration in range(iterations):
            solver.step(out, start, stop)
            if progress:
                progress((number + (iteration + 1) / iterations) / len(starts))
    return out


class _Polisher:
    def __init__(
        self,
        stage: Stage,
        builds: tuple[Build, Build],
        targets: tuple[Targets, Targets],
        touching: list[Touch],
        fps: float,
        costs: PolishCosts,
    ) -> None:
        self.stage, self.costs = stage, costs
        self.model: Any = copy.copy(stage.model)
        self.data = mujoco.MjData(self.model)
        self.owner = self.model.body_rootid[self.model.geom_bodyid]
        self.model.geom_margin[self.owner > 0] = CLEARANCE
        self.arm = 0.5 * (builds[0].arm_length + builds[1].arm_length)
        self.goals = _goals(stage, builds, targets, touching, costs)
        self.touches = [
            (
                touch,
                stage.actors[0].sites[touch.a],
                stage.actors[1].sites[touch.b],
                costs.touch / self.arm * touch.weight * (1.0 if touch.of_hands else 0.1),
            )
            for touch in touching
        ]
        nv = self.model.nv
        self.lower, self.upper = np.full(nv, -np.inf), np.full(nv, np.inf)
        self.rest = np.zeros(nv)
        self.rest_weights = np.zeros(nv)
        inertia = np.full(nv, costs.inertia**2 * fps**2)
        for actor, build in zip(stage.actors, builds, strict=True):
            self.lower[actor.dof] = actor.robot.lower
            self.upper[actor.dof] = actor.robot.upper
            self.rest[actor.dof] = actor.robot.rest
            self.rest_weights[actor.dof] = costs.rest
            if actor.free:
                base = self.model.body_dofadr[actor.root]
                inertia[base : base + 3] /= build.leg_length or build.arm_length
        self.inertia = inertia

    def step(self, qpos: FloatArray, start: int, stop: int) -> None:
        """Take one Gauss-Newton step of the frames ``start .. stop`` in place."""
        hessian, gradient = self._tracking(qpos, start, stop)
        angles = self._angles(qpos[start:stop])
        gradient += self.rest_weights**2 * (angles - self.rest)
        diagonal = self.rest_weights**2 + self.costs.damping**2
        nv = self.model.nv
        hessian[:, range(nv), range(nv)] += diagonal
        lines, pull = self._smoothness(qpos, start, stop)
        gradient += pull
        # A joint that is at its limit and pushed outward stays there: it leaves the equations.
        fixed = (angles <= self.lower + NEAR_LIMIT) & (gradient > 0)
        fixed |= (angles >= self.upper - NEAR_LIMIT) & (gradient < 0)
        hessian[:, range(nv), range(nv)] += lines[0]
        frame, joint = np.nonzero(fixed)
        hessian[frame, joint, :] = 0.0
        hessian[frame, :, joint] = 0.0
        hessian[frame, joint, joint] = 1.0
        for k in (1, 2):
            lines[k][:-k] *= ~(fixed[:-k] | fixed[k:])
        try:
            change = solve_blocks(hessian, lines[1], lines[2], -np.where(fixed, 0.0, gradient))
        except np.linalg.LinAlgError as error:
            raise LimitViolation("the motion cannot be smoothed over time") from error
        if not np.isfinite(change).all():
            raise LimitViolation("the motion cannot be smoothed over time")
        for t, delta in enumerate(change, start=start):
            mujoco.mj_integratePos(
                self.model, qpos[t], np.clip(delta, -LONGEST_STEP, LONGEST_STEP), 1.0
            )
        self.keep_limits(qpos[start:stop])

    def keep_limits(self, qpos: FloatArray) -> None:
        """Bring joints back into their ranges, in place."""
        for actor in self.stage.actors:
            robot = actor.robot
            qpos[:, actor.qpos] = np.clip(qpos[:, actor.qpos], robot.lower, robot.upper)

    def _angles(self, qpos: NDArray) -> FloatArray:
        """Return the joints' angles ``[T, nv]``, 0 for free bases."""
        out = np.zeros((len(qpos), self.model.nv))
        for actor in self.stage.actors:
            out[:, actor.dof] = qpos[:, actor.qpos]
        return out

    def _smoothness(
        self, qpos: FloatArray, start: int, stop: int
    ) -> tuple[list[FloatArray], FloatArray]:
        """Return bands ``3 x [n, nv]`` and gradient ``[n, nv]`` of the acceleration costs.

        Frames outside the stretch take part, but do not move.
        """
        first, last = max(start - 2, 0), min(stop + 2, len(qpos))
        velocity = np.empty((last - first - 1, self.model.nv))
        for i in range(len(velocity)):
            mujoco.mj_differentiatePos(
                self.model, velocity[i], 1.0, qpos[first + i], qpos[first + i + 1]
            )
        acceleration = np.diff(velocity, axis=0)
        lines, pull = second_difference_bands(acceleration, last - first)
        inside = slice(start - first, stop - first)
        weight = self.inertia**2
        bands = [line[inside, None] * weight for line in lines]
        return bands, pull[inside] * weight

    def _tracking(self, qpos: FloatArray, start: int, stop: int) -> tuple[FloatArray, FloatArray]:
        """Return normal matrices ``[n, nv, nv]`` and gradients ``[n, nv]`` of all else."""
        model, data, goals = self.model, self.data, self.goals
        count, nv = stop - start, model.nv
        points, turns = len(goals.sites), len(goals.bodies)
        jacobian = np.zeros((count, 3 * (points + turns), nv))
        residual = np.zeros((count, points + turns, 3))
        hessian, gradient = np.zeros((count, nv, nv)), np.zeros((count, nv))
        found = np.empty((count, turns, 3, 3))
        for i, t in enumerate(range(start, stop)):
            data.qpos[:] = qpos[t]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for p, site in enumerate(goals.sites):
                mujoco.mj_jacSite(model, data, jacobian[i, 3 * p : 3 * p + 3], None, site)
            for o, body in enumerate(goals.bodies, start=points):
                mujoco.mj_jacBody(model, data, None, jacobian[i, 3 * o : 3 * o + 3], body)
            residual[i, :points] = data.site_xpos[goals.sites] - goals.positions[t]
            found[i] = data.xmat[goals.bodies].reshape(turns, 3, 3)
            rows, values = self._encounters(t)
            if rows:
                block = np.array(rows)
                hessian[i] = block.T @ block
                gradient[i] = block.T @ values
        error = found @ goals.orientations[start:stop].swapaxes(-1, -2)
        residual[:, points:] = (
            Rotation.from_matrix(error.reshape(-1, 3, 3)).as_rotvec().reshape(count, turns, 3)
        )
        weights = np.empty((count, points + turns))
        weights[:, :points] = goals.position_weights[start:stop]
        weights[:, points:] = goals.orientation_weights
        residual *= weights[..., None]
        jacobian *= np.repeat(weights, 3, axis=1)[..., None]
        transposed = jacobian.swapaxes(1, 2)
        hessian += transposed @ jacobian
        gradient += (transposed @ residual.reshape(count, -1, 1))[..., 0]
        return hessian, gradient

    def _encounters(self, t: int) -> tuple[list[FloatArray], list[float]]:
        """Return weighted rows ``[nv]`` and residuals of touches and penetrations at frame t."""
        model, data = self.model, self.data
        rows: list[FloatArray] = []
        values: list[float] = []
        one, other = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        held: set[tuple[int, int]] = set()
        for touch, a, b, weights in self.touches:
            if weights[t] <= 0:
                continue
            ends = model.site_bodyid[[a, b]]
            held.add((min(ends), max(ends)))
            between = data.site_xpos[b] - data.site_xpos[a]
            distance = float(np.linalg.norm(between))
            if distance < 1e-9:
                continue
            mujoco.mj_jacSite(model, data, one, None, a)
            mujoco.mj_jacSite(model, data, other, None, b)
            # The direction counts as given: hands a thumb's breadth apart would otherwise
            # swing about each other from step to step.
            rows.extend(weights[t] * (other - one))
            values.extend(weights[t] * (1 - touch.gap / distance) * between)
        mujoco.mj_collision(model, data)
        found = data.contact
        among_robots = (self.owner[found.geom] > 0).all(axis=1)
        lacks = found.dist - np.where(among_robots, CLEARANCE, 0.0)
        for i in np.flatnonzero(lacks < 0):
            bodies = [int(body) for body in model.geom_bodyid[found.geom[i]]]
            if (min(bodies), max(bodies)) in held:
                lacks[i] += CLEARANCE  # these two may touch, not overlap
                if lacks[i] >= 0:
                    continue
            weight = (self.costs.collision if among_robots[i] else self.costs.floor) / self.arm
            normal = found.frame[i, :3]
            row = np.zeros(model.nv)
            for sign, body in zip((-1.0, 1.0), bodies, strict=True):
                if body:
                    mujoco.mj_jac(model, data, one, None, found.pos[i], body)
                    row += sign * weight * (normal @ one)
            rows.append(row)
            values.append(weight * float(lacks[i]))
        return rows, values


def _goals(
    stage: Stage,
    builds: tuple[Build, Build],
    targets: tuple[Targets, Targets],
    touching: list[Touch],
    costs: PolishCosts,
) -> _Goals:
    count = len(targets[0].base)
    sites: list[int] = []
    paths: list[FloatArray] = []
    weights: list[FloatArray] = []
    bodies: list[int] = []
    frames: list[FloatArray] = []
    turn_weights: list[float] = []
    model = stage.model

    def turn(body: int, rotation: Rotation, weight: float) -> None:
        bodies.append(body)
        frames.append(rotation.as_matrix())
        turn_weights.append(weight)

    for index, (actor, build, target) in enumerate(zip(stage.actors, builds, targets, strict=True)):
        for name, path in target.points.items():
            part = name.partition("_")[2]
            length = build.leg_length if part == "ankle" else build.arm_length
            sites.append(actor.sites[name])
            paths.append(path)
            weight = np.full(count, getattr(costs, part) / length)
            weights.append(weight * (1 - 0.9 * _eased(index, name, touching, count)))
        for side, rotation in target.feet.items():
            turn(int(model.site_bodyid[actor.sites[f"{side}_ankle"]]), rotation, costs.foot)
        if "head" in actor.sites:
            turn(int(model.site_bodyid[actor.sites["head"]]), target.head, costs.head)
        turn(int(model.body(build.torso).id), target.torso, costs.torso)
        if actor.free:
            sites.append(_base_site(actor))
            paths.append(_base_path(stage, actor, target))
            weights.append(np.full(count, costs.base / (build.leg_length or build.arm_length)))
    return _Goals(
        sites,
        np.stack(paths, axis=1),
        np.stack(weights, axis=1),
        bodies,
        np.stack(frames, axis=1),
        np.array(turn_weights),
    )


def _eased(index: int, name: str, touching: list[Touch], count: int) -> FloatArray:
    """Return how far ``[T]`` 0..1 a hand follows its touch and not its own target."""
    out = np.zeros(count)
    for touch in touching:
        if touch.of_hands and (touch.a, touch.b)[index] == name:
            out = np.maximum(out, touch.weight)
    return out


def _base_site(actor: Actor) -> int:
    return actor.sites["chest"]


def _base_path(stage: Stage, actor: Actor, target: Targets) -> FloatArray:
    """Return where the chest landmark is ``[T, 3]`` m when the base is on its target.

    A free robot's torso is its base (a chest on a waist would need the waist's angle too), so the
    chest landmark stands in for the base, which carries no site.
    """
    model = stage.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = actor.root
    turn = data.xmat[root].reshape(3, 3)
    local = turn.T @ (data.site_xpos[actor.sites["chest"]] - data.xpos[root])
    return target.base + target.torso.apply(local)
