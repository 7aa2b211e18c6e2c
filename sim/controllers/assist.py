"""Springs at the joints, and a bounded helping hand at each pelvis.

**The problem.** Joint springs alone, however good, let a person fall within a second: nothing
regulates balance. The hand supplies what balance would need, up to a bound, and its size is the
measure of how far the motion is from standing on its own feet.

A spring with damping ``kv`` brakes towards rest, so a target that moves with ``omega`` is put ahead
by ``kv / kp * omega``: at the reference's own speed the damping then does no work. What still lags
(gravity on outstretched arms, the legs' give under load) repeats itself exactly when the run is
repeated, so it can be learnt: after each pass the joints' remaining error is added to the targets
of the next (iterative learning control). The last pass is the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from generator.kinematics import from_wxyz, to_wxyz
from robots.errors import SpecError
from robots.humanoid import body_plan
from robots.skeleton import FloatArray
from sim.controllers.base import Progress, Trace, simulate, within_effort
from sim.inverse import inverse_dynamics
from sim.reference import Reference
from sim.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class AssistController:
    """Joint springs with velocity feed-forward, learnt offsets, and root assist."""

    name: str = "assist"
    passes: int = 3
    """Runs over the whole motion; each learns from the one before."""
    learning: float = 0.7
    """Share of the remaining joint error that the next pass corrects."""
    most_correction: float = 0.35
    """Bound on what is learnt per joint, rad."""
    feed_forward: float = 1.0
    """Share of the torque that inverse dynamics demands which is given ahead of any error."""
    effort_factor: float = 1.5
    """Targets stay within this many times effort / stiffness of the joint."""

    def __post_init__(self) -> None:
        """Validate."""
        if not 1 <= self.passes <= 20:
            raise SpecError(f"{self.passes} passes", where="controller", allowed="1 to 20")

    def run(self, scene: Scene, reference: Reference, progress: Progress | None = None) -> Trace:
        """Simulate the whole reference; see :class:`sim.controllers.base.Controller`."""
        count, people, keypoints = reference.rotations.shape[:3]
        learnt = np.zeros((count, people, keypoints - 1, 3))
        if self.feed_forward > 0:
            stiffness = np.array(
                [[b.stiffness(n) for n in b.skeleton.names[1:]] for b in scene.bodies]
            )
            torque = inverse_dynamics(scene, reference).torque
            learnt = self.feed_forward * torque / stiffness[..., None]
        trace: Trace | None = None
        for i in range(self.passes):
            if trace is not None:
                learnt = self._learn(scene, reference, trace, learnt)
            trace = self._one_pass(scene, reference, learnt, _part(progress, i, self.passes))
        assert trace is not None  # noqa: S101 - passes >= 1
        return trace

    def _one_pass(
        self, scene: Scene, reference: Reference, learnt: FloatArray, progress: Progress | None
    ) -> Trace:
        plan = body_plan()
        linear, angular = reference.steps()
        ahead = angular[:, :, 1:] * plan.damping_ratio + (learnt[1:] + learnt[:-1]) / 2
        local = from_wxyz(reference.rotations[1:, :, 1:].reshape(-1, 4))
        targets = to_wxyz(local * Rotation.from_rotvec(ahead.reshape(-1, 3)))
        targets = targets.reshape(*ahead.shape[:3], 4)
        most = self._most_offset(scene)
        quats = np.concatenate([m.quats[1:] for m in scene.maps])
        dofs = np.concatenate([m.dofs[1:] for m in scene.maps])
        rows = np.concatenate([m.targets for m in scene.maps])

        def policy(data: Any, tick: int) -> None:
            now = from_wxyz(data.qpos[quats])
            wanted = from_wxyz(targets[tick].reshape(-1, 4))
            turning = data.qvel[dofs]
            wanted = within_effort(wanted, now, turning, plan.damping_ratio, most)
            data.ctrl[rows] = wanted.as_rotvec()
            for p, at in enumerate(scene.maps):
                if len(at.assist):
                    kp, kv = _assist_gains(scene, at.assist)
                    velocity = np.concatenate([linear[tick, p], angular[tick, p, 0]])
                    lead = np.divide(kv, kp, out=np.zeros(6), where=kp > 0) * velocity
                    lead[:3] += reference.root[tick + 1, p]
                    data.ctrl[at.assist] = lead
                    data.mocap_quat[at.mocap] = reference.rotations[tick + 1, p, 0]

        return simulate(scene, reference, policy, progress)

    def _most_offset(self, scene: Scene) -> FloatArray:
        """Return the largest distance of target from joint, rad, for all joints of both."""
        return np.array(
            [
                self.effort_factor * body.effort(name) / body.stiffness(name)
                for body in scene.bodies
                for name in body.skeleton.names[1:]
            ]
        )

    def _learn(
        self, scene: Scene, reference: Reference, trace: Trace, learnt: FloatArray
    ) -> FloatArray:
        """Return the offsets for the next pass, smooth over time and bounded."""
        _, rotations = scene.poses(trace.qpos)
        shape = learnt.shape
        error = (
            from_wxyz(rotations[:, :, 1:].reshape(-1, 4)).inv()
            * from_wxyz(reference.rotations[:, :, 1:].reshape(-1, 4))
        ).as_rotvec()
        error = gaussian_filter1d(error.reshape(shape), 0.03 * reference.rate, axis=0)
        learnt = learnt + self.learning * error
        size = np.linalg.norm(learnt, axis=-1, keepdims=True)
        return learnt * np.minimum(1.0, self.most_correction / np.maximum(size, 1e-12))


def _assist_gains(scene: Scene, addresses: NDArray) -> tuple[FloatArray, FloatArray]:
    """Return stiffness and damping ``[6]`` of a person's assist actuators."""
    model = scene.model
    ids = np.searchsorted(model.actuator_ctrladr, addresses)
    return model.actuator_gainprm[ids, 0], -model.actuator_biasprm[ids, 2]


def _part(progress: Progress | None, index: int, parts: int) -> Progress | None:
    """Return a progress that reports the given part of the whole."""
    if progress is None:
        return None
    return lambda share: progress((index + share) / parts)
