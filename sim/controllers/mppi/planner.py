"""Sampling model-predictive control (MPPI): try many futures in simulation, blend the best.

**The problem.** Springs that follow the reference fall within a second: where to put a foot or a
hip so as not to fall depends on what happens next. Instead of derivatives, this controller asks the
simulator itself. It perturbs its plan many times, rolls every variant of both people out over a
short horizon, and averages the variants with weights that fall off exponentially with their cost
(Williams et al., "Information-theoretic model predictive control", T-RO 2018). The simulation then
follows the plan for a few ticks, and the next round starts from the plan moved on.

Three things keep 126 dimensions searchable. A plan is a deviation from targets that already follow
the reference, not the targets themselves. It varies smoothly, as a cubic spline through a few
knots. And each person's deviations are weighted by that person's own cost: the people share the
rollouts, so they feel each other, but a good variant of one is not thrown away for a bad one of the
other. Noise comes in four sizes at once, to hold a pose and to recover from a stumble; the old plan
and half of it are always among the variants, and deviations fade, else the plan wanders off.

Deviations are added to targets in exponential coordinates, because sampling does not mind how its
directions are bent, and no rotation has to be composed for a million sampled targets.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout as RolloutPool
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from robots.skeleton import FloatArray
from sim.controllers.base import reference_qvel
from sim.controllers.guide import AssistGuide
from sim.controllers.mppi.settings import CostWeights, MppiSettings
from sim.controllers.nominal import nominal_targets
from sim.reference import Reference
from sim.scene import PEOPLE, Scene, compile_model

_SPREAD = {
    "hip": 0.12,
    "knee": 0.12,
    "ankle": 0.15,
    "foot": 0.05,
    "spine1": 0.06,
    "spine2": 0.05,
    "spine3": 0.05,
    "neck": 0.02,
    "head": 0.02,
    "collar": 0.03,
    "shoulder": 0.08,
    "elbow": 0.05,
    "wrist": 0.02,
}
"""Standard deviation of the noise on a joint's target, rad: large where balance is made."""

_EMPHASIS = {"ankle": 2.0, "foot": 2.0, "neck": 1.0, "wrist": 1.5}
"""Weight of a keypoint's position; 1 elsewhere."""

_SIZES = (1.0, 0.5, 0.25, 0.1)
"""Scales of the noise, in turn over the variants."""

_TREE_SENSORS = ("subtreecom", "subtreelinvel", "subtreeangmom")
_HOPELESS = 1e6
"""Cost of a variant whose physics diverged."""


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """Controls of the whole scene that follow the reference if nothing disturbs."""

    ctrl: FloatArray
    """``[N-1, nu]``: at tick k, what leads to tick k + 1."""
    mocap_quat: FloatArray
    """``[N-1, nmocap, 4]`` wxyz: frames of the root assist."""
    rows: NDArray[np.intp]
    """``[2, 3 (J-1)]`` addresses of the joint targets in ``ctrl``."""


def make_nominal(scene: Scene, reference: Reference, feed_forward: float) -> Nominal:
    """Return the controls along a reference: joint targets, and root assist if there is one."""
    targets, assist = nominal_targets(scene, reference, feed_forward), AssistGuide(scene, reference)
    data, count = mujoco.MjData(scene.model), len(targets)
    ctrl = np.empty((count, scene.model.nu))
    mocap_quat = np.empty((count, scene.model.nmocap, 4))
    for k in range(count):
        for p, at in enumerate(scene.maps):
            data.ctrl[at.targets] = targets[k, p]
            if p in assist.helped:
                assist.set(data, k, p, at)
        ctrl[k], mocap_quat[k] = data.ctrl, data.mocap_quat
    rows = np.stack([at.targets.reshape(-1) for at in scene.maps])
    return Nominal(ctrl, mocap_quat, rows)


@contextmanager
def planner(
    scene: Scene, reference: Reference, nominal: Nominal, settings: MppiSettings, seed: int
) -> Iterator[Planner]:
    """Give a planner whose threads end with the block."""
    with RolloutPool(nthread=settings.threads if settings.threads > 1 else 0) as pool:
        yield Planner(scene, reference, nominal, settings, seed, pool)


class Planner:
    """The plan of both people, and how it is improved by sampling."""

    def __init__(
        self,
        scene: Scene,
        reference: Reference,
        nominal: Nominal,
        settings: MppiSettings,
        seed: int,
        pool: RolloutPool,
    ) -> None:
        """Prepare to plan along a reference.

        Args:
            scene: What is simulated; its nominal model is planned with.
            reference: What to follow, at the rate of control.
            nominal: Controls to deviate from.
            settings: How to sample.
            seed: Of the noise.
            pool: Threads that roll out.
        """
        self._settings, self._scene, self._nominal, self._pool = settings, scene, nominal, pool
        self._model = planning_model(scene, 1 / reference.rate)
        self._workers = [mujoco.MjData(self._model) for _ in range(settings.threads)]
        self._random = np.random.default_rng(seed)
        self._steps = max(settings.knots, round(settings.horizon * reference.rate))
        self.every = max(1, round(reference.rate / settings.rate))
        """Ticks between plans."""
        self.plan = np.zeros((self._steps, 2, nominal.rows.shape[1]))
        """``[H, 2, 3 (J-1)]`` rad: deviation of the targets at this tick and the next ones."""
        names = scene.bodies[0].skeleton.names
        spread = [_SPREAD[n.removeprefix("left_").removeprefix("right_")] for n in names[1:]]
        self._spread = np.repeat(spread, 3)
        at_knots = np.linspace(0, self._steps - 1, settings.knots)
        spline = CubicSpline(at_knots, np.eye(settings.knots), bc_type="natural")
        self._basis: FloatArray = np.asarray(spline(np.arange(self._steps)), dtype=float)
        self._sizes = np.resize(_SIZES, settings.samples)
        self._qpos = scene.qpos(reference.root, reference.rotations)
        self._readings = self._reference_readings(reference)
        self._sensor_weights, self._turn_weights = _weights(names, settings.weights)
        self._started = False

    def replan(self, data: Any, tick: int) -> None:
        """Move the plan on to a tick and improve it from the present state of the simulation."""
        settings = self._settings
        if self._started:
            tail = settings.fade ** np.arange(1, self.every + 1)
            moved = self.plan[self.every :] if self.every < self._steps else self.plan[-1:]
            self.plan = np.concatenate([moved, moved[-1:] * tail[:, None, None]])[: self._steps]
        self._started = True
        variants = self._variants()
        costs = self.costs(variants, data, tick)
        for p in range(2):
            worse = costs[:, p] - costs[:, p].min()
            scale = np.sort(worse)[: max(2, settings.samples // 2)].std() + 1e-9
            share = np.exp(-worse / (settings.temperature * scale))
            self.plan[:, p] = np.tensordot(share / share.sum(), variants[:, :, p], axes=1)

    def _variants(self) -> FloatArray:
        """Return deviations ``[S, H, 2, 3 (J-1)]`` around the plan."""
        settings = self._settings
        shape = (settings.samples, settings.knots, *self.plan.shape[1:])
        noise = self._random.standard_normal(shape) * self._spread
        noise *= self._sizes[:, None, None, None]
        variants = np.tensordot(noise, self._basis, axes=(1, 1)).transpose(0, 3, 1, 2)
        variants = np.clip(self.plan + variants, -settings.clip, settings.clip)
        variants[0], variants[1] = self.plan, self.plan / 2
        return variants

    def costs(self, variants: FloatArray, data: Any, tick: int) -> FloatArray:
        """Return the cost ``[S, 2]`` of variants that start from the state of a simulation."""
        count, model, nominal = len(variants), self._model, self._nominal
        ticks = np.minimum(tick + np.arange(self._steps), len(nominal.ctrl) - 1)
        control = np.empty((count, self._steps, model.nu + 4 * model.nmocap))
        control[..., : model.nu] = nominal.ctrl[ticks]
        control[..., nominal.rows] += variants
        control[..., model.nu :] = nominal.mocap_quat[ticks].reshape(self._steps, -1)
        start = np.concatenate([[data.time], data.qpos, data.qvel])
        with _silent():
            states, readings = self._pool.rollout(
                model,
                self._workers,
                np.tile(start, (count, 1)),
                control,
                control_spec=int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_QUAT),
                initial_warmstart=np.tile(data.qacc_warmstart, (count, 1)),
            )
        # A sensor speaks of the state before its step.
        errors = readings - self._readings[ticks]
        per_moment = np.square(errors, out=errors) @ self._sensor_weights
        for p, at in enumerate(self._scene.maps):
            quats = states[..., 1 + at.quats]
            wanted = self._qpos[ticks + 1][:, at.quats]
            dots = np.einsum("shji,hji->shj", quats, wanted)
            per_moment[..., p] += 4 * (1 - np.minimum(dots**2, 1)) @ self._turn_weights
        per_moment += self._settings.weights.deviation * np.square(variants).mean(axis=-1)
        per_moment[:, -1] *= 1 + self._settings.weights.end * self._steps
        costs = per_moment.mean(axis=1)
        finished = states[:, -1, 0] > data.time + (self._steps - 0.5) * model.opt.timestep
        costs[~finished] = _HOPELESS
        return np.where(np.isfinite(costs), costs, _HOPELESS)

    def _reference_readings(self, reference: Reference) -> FloatArray:
        """Return what the sensors would say ``[N, nsensordata]`` along the reference."""
        model, data = self._model, mujoco.MjData(self._model)
        qvel = reference_qvel(self._scene, reference)
        out = np.empty((len(qvel), model.nsensordata))
        for k, (pose, speed) in enumerate(zip(self._qpos, qvel, strict=True)):
            data.qpos[:], data.qvel[:] = pose, speed
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_sensorPos(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_sensorVel(model, data)
            out[k] = data.sensordata
        return out


def planning_model(scene: Scene, timestep: float) -> Any:
    """Return the ``mujoco.MjModel`` of a scene with sensors, stepping once per tick.

    Sensors, for a and then b: position of every body; centre of mass, its velocity, and angular
    momentum of the whole.
    """
    root = ET.fromstring(scene.xml)  # noqa: S314 - our own text
    option = root.find("option")
    if option is not None:
        option.set("timestep", repr(timestep))
        option.set("tolerance", "1e-6")
    sensors = ET.SubElement(root, "sensor")
    for person, body in zip(PEOPLE, scene.bodies, strict=True):
        for name in body.skeleton.names:
            full = f"{person}/{name}"
            ET.SubElement(sensors, "framepos", objtype="xbody", objname=full)
        for kind in _TREE_SENSORS:
            ET.SubElement(sensors, kind, body=f"{person}/{body.skeleton.names[0]}")
    return compile_model(ET.tostring(root, encoding="unicode"))


def _weights(names: tuple[str, ...], weights: CostWeights) -> tuple[FloatArray, FloatArray]:
    """Return weights of squared sensor errors ``[nsensordata, 2]`` and of turns ``[J]``."""
    share = np.array([_EMPHASIS.get(n.rpartition("_")[2], 1.0) for n in names])
    points = np.repeat(weights.position * share / share.sum(), 3)
    points[:3] += weights.root
    balance = [weights.balance, weights.balance, 0.0]
    one = np.concatenate([points, balance, [weights.momentum] * 3, [weights.spin] * 3])
    sensors = np.zeros((2 * len(one), 2))
    sensors[: len(one), 0] = sensors[len(one) :, 1] = one
    turns = np.full(len(names), weights.joints / (len(names) - 1))
    turns[0] = weights.orientation
    return sensors, turns


@contextmanager
def _silent() -> Iterator[None]:
    """Drop MuJoCo's warnings: that a wild variant diverges is nobody's concern."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
