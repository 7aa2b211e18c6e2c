"""Two people who follow whatever did best in sampled futures; see :mod:`.planner`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sim.controllers.base import Progress, Trace
from sim.controllers.mppi.planner import make_nominal, planner
from sim.controllers.mppi.settings import MppiSettings
from sim.disturbance import NONE, Disturbance
from sim.reference import Reference
from sim.rollout import FALL_DISTANCE
from sim.scene import Scene
from sim.simulation import Simulation

_AFTER_FALL = 0.5
"""How long a fall is shown before the run ends, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MppiController:
    """Follows the plan that did best in sampled futures; replans some times a second."""

    settings: MppiSettings = field(default_factory=MppiSettings)
    seed: int = 0
    """Of the noise."""
    name: str = "mppi"

    def run(
        self,
        scene: Scene,
        reference: Reference,
        progress: Progress | None = None,
        *,
        disturbance: Disturbance = NONE,
    ) -> Trace:
        """Simulate the reference; see :class:`sim.controllers.base.Controller`.

        Ends early, half a second after a person fell; ``facts["ended"]`` then says so.
        """
        simulation = Simulation(scene, reference, disturbance)
        goal = scene.keypoints(scene.qpos(reference.root, reference.rotations))
        nominal = make_nominal(scene, reference, self.settings.feed_forward)
        data, last = simulation.data, len(goal) - 1
        fallen: int | None = None
        with planner(scene, reference, nominal, self.settings, self.seed) as sampler:
            while not simulation.done:
                tick = simulation.tick
                off = np.linalg.norm(simulation.keypoints() - goal[tick], axis=-1)
                if fallen is None and (off.mean(axis=-1) > FALL_DISTANCE).any():
                    fallen = tick
                if fallen is not None and tick >= fallen + _AFTER_FALL * reference.rate:
                    break
                since = tick % sampler.every
                if since == 0:
                    sampler.replan(data, tick)
                data.ctrl[:] = nominal.ctrl[tick]
                data.ctrl[nominal.rows] += sampler.plan[since]
                data.mocap_quat[:] = nominal.mocap_quat[tick]
                simulation.step()
                if progress is not None:
                    progress(simulation.tick / last)
        trace = simulation.trace()
        if fallen is None:
            return trace
        why = f"a person fell at {fallen / reference.rate:.2f} s"
        return replace(
            trace, facts={"ended": {"time": simulation.tick / reference.rate, "why": why}}
        )
