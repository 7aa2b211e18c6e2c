"""One person's plan: iLQR over joint targets, half a second ahead.

**The problem.** Springs towards a reference do not balance. A plan does: it looks half a second
ahead, sees that the pelvis will be behind the feet, and moves the targets of hips and ankles so
that it will not be. Each plan starts from the last one shifted in time, takes the derivatives of
the physics along it, solves the linear-quadratic problem they make by one backward pass, and tries
the result in the physics with a few step lengths. The gains of the backward pass correct the
controls at every tick until the next plan.

Y. Tassa, T. Erez, E. Todorov, "Synthesis and Stabilization of Complex Behaviors through Online
Trajectory Optimization", IROS 2012; for whole bodies with these derivatives: J. Zhang et al.,
"Whole-Body Model-Predictive Control of Legged Robots with MuJoCo", arXiv 2503.04613.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.skeleton import FloatArray
from sim.controllers.ilqr.cost import TrackingCost
from sim.controllers.ilqr.knots import KnotDerivatives, Path, touching
from sim.controllers.ilqr.person import PersonModel
from sim.controllers.ilqr.riccati import Dynamics, Quadratic, riccati
from sim.controllers.ilqr.settings import IlqrSettings
from sim.controllers.ilqr.touch import Touch

_STEP_LENGTHS = (1.0, 0.5, 0.2, 0.05)
_WORTHWHILE = 0.02
"""Share by which a sweep must lower the cost for another one to follow."""
_TAIL = 0.8
"""Share of the last planned offset that a new plan's unplanned tail starts with."""


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """Where a person's bodies will be, by its own plan."""

    positions: FloatArray
    """``[H+1, J, 3]`` m."""
    turns: FloatArray
    """``[H+1, J, 4]`` wxyz."""
    push: FloatArray
    """``[H+1, 2]`` N: level force on the partner; 0 unless ghosts yield."""


@dataclass(frozen=True, slots=True, eq=False)
class _Goal:
    """Where a touching point is to be, along one plan."""

    touch: Touch
    target: FloatArray
    """``[H+1, 3]`` m."""
    weight: FloatArray
    """``[H+1]`` 1/m2."""


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    start: int
    path: Path
    gains: FloatArray
    """``[H, nu, 2 nv]``."""


class Planner:
    """Plans for one person. Not thread-safe; one each."""

    def __init__(
        self,
        person: PersonModel,
        cost: TrackingCost,
        nominal: NDArray,
        bounds: tuple[NDArray, NDArray],
        settings: IlqrSettings,
        *,
        rate: float,
        touches: Sequence[Touch] = (),
        guide: Callable[[Any, int], None] | None = None,
    ) -> None:
        """Prepare.

        Args:
            person: Who plans.
            cost: What to keep small.
            nominal: ``[N, nu]`` targets that follow the reference if nothing disturbs.
            bounds: Least and largest controls, ``[N, nu]`` rad each.
            settings: How to plan.
            rate: Ticks per second.
            touches: Points to meet the partner with.
            guide: Sets the root assist in ``mujoco.MjData`` for a tick.
        """
        self.person, self.cost = person, cost
        self.horizon = max(2, round(settings.horizon * rate))
        self.iterations, self.regularisation = settings.iterations, settings.regularisation
        self.derivatives = KnotDerivatives(person, settings.cache, exact=settings.exact)
        self._settings, self._touches, self._guide = settings, touches, guide
        self._nominal, self._bounds = nominal, bounds
        self._data = mujoco.MjData(person.model)
        self._plan: _Plan | None = None
        self._partner: Forecast | None = None
        self._start = 0

    @property
    def state(self) -> Any:
        """The present plan, to come back to; opaque."""
        return self._plan

    @state.setter
    def state(self, plan: Any) -> None:
        self._plan = plan
        self.derivatives.forget()

    def expired(self, tick: int) -> bool:
        """Return whether no plan covers a tick."""
        return self._plan is None or tick - self._plan.start >= self.horizon

    def forecast(self, tick: int) -> Forecast:
        """Return where this person's bodies will be from a tick on, by its last plan."""
        states = np.empty((self.horizon + 1, self.person.model.nq))
        for h in range(self.horizon + 1):
            known = self._plan is not None and 0 <= tick + h - self._plan.start <= self.horizon
            if known and self._plan is not None:
                states[h] = self._plan.path.qpos[tick + h - self._plan.start]
            else:
                states[h] = self.cost.qpos[self.cost.clip(tick + h)]
        return Forecast(*self.person.poses(states), self._push(tick))

    def _push(self, tick: int) -> FloatArray:
        """Return the planned force on the partner ``[H+1, 2]`` N from a tick on."""
        push = np.zeros((self.horizon + 1, 2))
        if self.person.yielding and self._plan is not None and not self.expired(tick):
            known = self._plan.path.push[tick - self._plan.start :]
            push[:] = known[-1]
            push[: len(known)] = known
        return push

    def plan(
        self,
        tick: int,
        qpos: NDArray,
        qvel: NDArray,
        warmstart: NDArray,
        partner: Forecast | None = None,
    ) -> None:
        """Plan from a state at a tick.

        Args:
            tick: Of the reference.
            qpos: ``[nq]`` of the person.
            qvel: ``[nv]`` of the person.
            warmstart: ``[nv]`` acceleration that the constraint solver starts from.
            partner: Where the partner will be.
        """
        self._start, self._partner = tick, partner
        self.cost.forget(tick)
        padded = self.person.padded
        state = padded(np.array(qpos)), padded(np.array(qvel)), padded(np.array(warmstart))
        goals = self._goals(tick)
        self._lay_out(tick)
        path, gains = self._first(tick, state, goals)
        strength = self.regularisation
        for _ in range(self.iterations):
            dynamics = self.derivatives.along(tick, path, self._prepare)
            solved = self._backward(path, dynamics, goals, strength)
            if solved is None:
                break
            gains, step = solved
            before = path.cost
            for length in _STEP_LENGTHS:
                better = self._roll(tick, state, path, goals, gains, length * step)
                if better.cost < path.cost:
                    path = better
                    break
            else:
                strength *= 10
                continue
            if path.cost > (1 - _WORTHWHILE) * before:
                break
        self._plan = _Plan(tick, path, gains)

    def control(self, tick: int, qpos: NDArray, qvel: NDArray) -> FloatArray:
        """Return the joint targets ``[nu]`` of a tick, corrected for where the person is."""
        if self._plan is None:
            raise RuntimeError("control before the first plan")
        h, path = tick - self._plan.start, self._plan.path
        control = path.control[h]
        if self._settings.feedback:
            padded = self.person.padded
            off = self._off(path, h, padded(qpos), padded(qvel))
            if self.person.yielding:  # how far the partner gave way is not looked at between plans
                off.reshape(2, -1)[:, -self.person.yielding :] = 0
            control = control + self._plan.gains[h] @ off
        low, high = (bound[self._last(tick)] for bound in self._bounds)
        return np.clip(control, low, high)

    def _lay_out(self, tick: int) -> None:
        """Gather what a plan from a tick on is measured by."""
        ticks = range(tick, tick + self.horizon + 1)
        rows = [self._last(t) for t in ticks[:-1]]
        self._wanted, self._low, self._high = (
            values[rows] for values in (self._nominal, *self._bounds)
        )
        self._hessians = self.cost.hessians(ticks)
        self._hessians[-1] *= self.cost.terminal

    def _first(self, tick: int, state: tuple, goals: Sequence[_Goal]) -> tuple[Path, FloatArray]:
        """Return the last plan, carried on to the new horizon and tried from the new state."""
        H, nv = self.horizon, self.person.nv
        ticks = [self.cost.clip(tick + h) for h in range(H)]
        gains = np.zeros((H, self.person.nu, 2 * nv))
        qpos, qvel = self.cost.qpos[ticks], self.cost.qvel[ticks]
        control = self._wanted.copy()
        if self._plan is not None and 0 <= tick - self._plan.start < H:
            old, gone = self._plan.path, tick - self._plan.start
            known = H - gone
            last = min(self.cost.clip(self._plan.start + H - 1), len(self._nominal) - 1)
            control[:known] = old.control[gone:]
            control[known:] += _TAIL * (old.control[-1] - self._nominal[last])
            gains[:known] = self._plan.gains[gone:]
            qpos[:known], qvel[:known] = old.qpos[gone:H], old.qvel[gone:H]
        guess = Path(qpos, qvel, control, np.zeros((H, nv)), [], np.inf)
        return self._roll(tick, state, guess, goals, gains), gains

    def _roll(
        self,
        tick: int,
        state: tuple[FloatArray, FloatArray, FloatArray],
        around: Path,
        goals: Sequence[_Goal],
        gains: NDArray,
        step: NDArray | None = None,
    ) -> Path:
        """Return what comes of controls, corrected by gains for the distance from a path."""
        person, data, H = self.person, self._data, self.horizon
        model = person.model
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = state
        qpos, qvel = np.empty((H + 1, model.nq)), np.empty((H + 1, model.nv))
        control, warmstart = np.empty((H, person.nu)), np.empty((H, model.nv))
        met: list[bytes] = []
        push = np.zeros((H, 2))
        cost = 0.0
        meant = around.control if step is None else around.control + step
        for h in range(H + 1):
            qpos[h], qvel[h] = data.qpos, data.qvel
            if h < H:
                wanted = meant[h] + gains[h] @ self._off(around, h, qpos[h], qvel[h])
                control[h] = np.minimum(np.maximum(wanted, self._low[h]), self._high[h])
                warmstart[h] = data.qacc_warmstart
                self._prepare(data, tick + h)
                data.ctrl[person.targets] = control[h]
                mujoco.mj_step(model, data)
                met.append(touching(data))
                if person.yielding:
                    push[h] = data.qfrc_constraint[-person.yielding :]
            else:
                mujoco.mj_kinematics(model, data)
            if h > 0:
                cost += self._miss(h, data, goals)
        pull, more = self._pull(tick, qpos, qvel, control)
        cost = cost + more if np.isfinite(cost + more) else 1e12
        return Path(qpos, qvel, control, warmstart, met, cost, pull, push)

    def _pull(
        self, tick: int, qpos: NDArray, qvel: NDArray, control: NDArray
    ) -> tuple[FloatArray, float]:
        """Return the gradient ``[H+1, 2 nv]`` of the cost of states, and the cost without touch."""
        error = np.stack([self.cost.error(tick + h, qpos[h], qvel[h]) for h in range(len(qpos))])
        with np.errstate(over="ignore", invalid="ignore"):  # of physics that diverged
            halves = error.astype(np.float32).reshape(len(error), 2, -1, 1)
            pull = (self._hessians @ halves).reshape(error.shape).astype(np.float64)
        of_controls = np.square(control - self._wanted) @ self.cost.control
        return pull, 0.5 * float((error[1:] * pull[1:]).sum() + of_controls.sum())

    def _miss(self, h: int, data: Any, goals: Sequence[_Goal]) -> float:
        """Return the cost of not touching at a knot, with body poses of it in ``data``."""
        cost = 0.0
        for goal in goals:
            if goal.weight[h] > 0:
                miss = self._point(data, goal) - goal.target[h]
                cost += 0.5 * float(goal.weight[h] * (miss @ miss))
        return cost

    def _backward(
        self, path: Path, dynamics: Dynamics, goals: Sequence[_Goal], strength: float
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return gains ``[H, nu, 2 nv]`` and steps ``[H, nu]``; ``None`` if nothing helps."""
        cost = self._expand(path, goals)
        for _ in range(6):
            solved = riccati(dynamics, cost, strength)
            if solved is not None:
                return solved
            strength = max(30 * strength, 1e-2)
            dynamics = dynamics.clipped(100)
        return None

    def _expand(self, path: Path, goals: Sequence[_Goal]) -> Quadratic:
        """Return the cost about a path to second order."""
        control = self.cost.control * (path.control - self._wanted)
        if not goals:
            return Quadratic(path.pull, self._hessians, self.cost.control, control)
        nv, model, data = self.person.nv, self.person.model, self._data
        gradient, hessian = path.pull.copy(), self._hessians.copy()
        jacobian = np.empty((3, nv))
        for h in range(1, self.horizon + 1):
            touching = [goal for goal in goals if goal.weight[h] > 0]
            if not touching:
                continue
            data.qpos[:] = path.qpos[h]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            for goal in touching:
                point = self._point(data, goal)
                body = self.person.at.bodies[goal.touch.own.body]
                mujoco.mj_jac(model, data, jacobian, None, point, body)
                gradient[h, :nv] += goal.weight[h] * (point - goal.target[h]) @ jacobian
                hessian[h, 0] += goal.weight[h] * jacobian.T @ jacobian
        return Quadratic(gradient, hessian, self.cost.control, control)

    def _goals(self, tick: int) -> list[_Goal]:
        """Return where touching points are to be from a tick on."""
        partner = self._partner
        if partner is None or not self._settings.touch:
            return []
        ticks = [self.cost.clip(tick + h) for h in range(self.horizon + 1)]
        weight = np.full(len(ticks), self._settings.weights.touch)
        weight[-1] *= self.cost.terminal
        return [
            _Goal(
                touch,
                touch.partner.world(partner.positions, partner.turns) + touch.offset[ticks],
                weight * touch.weight[ticks],
            )
            for touch in self._touches
            if touch.weight[ticks].any()
        ]

    def _point(self, data: Any, goal: _Goal) -> FloatArray:
        """Return the touching point ``[3]`` m of the pose in ``data``."""
        own = goal.touch.own
        body = self.person.at.bodies[own.body]
        return data.xpos[body] + data.xmat[body].reshape(3, 3) @ own.local

    def _prepare(self, data: Any, tick: int) -> None:
        """Set what of a planning model's world changes by itself."""
        ghost = self.person.ghost
        if len(ghost) and self._partner is not None:
            h = tick - self._start
            self.person.set_ghost(
                data, self._partner.positions[h], self._partner.turns[h], self._partner.push[h]
            )
        if self._guide is not None:
            self._guide(data, tick)

    def _off(self, path: Path, h: int, qpos: NDArray, qvel: NDArray) -> FloatArray:
        """Return how far a state is from a path's, ``[2 nv]``."""
        nv = self.person.nv
        out = np.empty(2 * nv)
        mujoco.mj_differentiatePos(self.person.model, out[:nv], 1.0, path.qpos[h], qpos)
        np.subtract(qvel, path.qvel[h], out=out[nv:])
        return out

    def _last(self, tick: int) -> int:
        return min(tick, len(self._nominal) - 1)
