"""Springs at the joints, and a bounded helping hand at each pelvis.

**The problem.** Joint springs alone, however good, let a person fall within a second: nothing
regulates balance. The hand supplies what balance would need, up to a bound, and its size is the
measure of how far the motion is from standing on its own feet.

Springs follow only what they are told ahead. A damper ``kv`` brakes towards rest, so a target that
moves with ``omega`` is put ahead by ``kv / kp * omega``; gravity, inertia and the floor's push need
a torque, so the target is put ahead by ``torque / kp`` too, with the torque from inverse dynamics
(:mod:`sim.inverse`). What the springs then add is small. MuJoCo's integration is implicit: forces
act as of the end of a step, with its mean velocity. So the target is the pose at the end of the
step, and velocity and torque are those of its middle; half a step off, and every swinging limb
would run ahead or behind by centimetres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.kinematics import from_wxyz, to_wxyz
from robots.humanoid import body_plan
from robots.skeleton import FloatArray
from sim.controllers.base import Progress, Trace, simulate, within_effort
from sim.controllers.guide import AssistGuide
from sim.disturbance import NONE, Disturbance
from sim.inverse import inverse_dynamics
from sim.reference import Reference
from sim.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class AssistController:
    """Joint springs with feed-forward, and root assist as strong as the scene has it."""

    name: str = "assist"
    feed_forward: float = 1.0
    """Share of the torque that inverse dynamics demands which is given ahead of any error."""
    effort_factor: float = 1.5
    """Targets ask for at most this many times the effort limit of a joint."""

    def run(
        self,
        scene: Scene,
        reference: Reference,
        progress: Progress | None = None,
        *,
        disturbance: Disturbance = NONE,
    ) -> Trace:
        """Simulate the whole reference; see :class:`sim.controllers.base.Controller`."""
        ratio = body_plan().damping_ratio
        _, angular = reference.steps()
        targets = self._targets(scene, reference, angular)
        most = self._most_offset(scene)
        quats = np.concatenate([m.quats[1:] for m in scene.maps])
        dofs = np.concatenate([m.dofs[1:] for m in scene.maps])
        rows = np.concatenate([m.targets for m in scene.maps])
        guide = AssistGuide(scene, reference)

        def policy(data: Any, tick: int) -> None:
            now = from_wxyz(data.qpos[quats])
            wanted = from_wxyz(targets[tick])
            data.ctrl[rows] = within_effort(wanted, now, data.qvel[dofs], ratio, most).as_rotvec()
            for p in guide.helped:
                guide.set(data, tick, p, scene.maps[p])

        return simulate(scene, reference, policy, progress, disturbance=disturbance)

    def _targets(self, scene: Scene, reference: Reference, angular: NDArray) -> FloatArray:
        """Return the targets ``[N-1, 2 (J-1), 4]`` wxyz of all joints, per step."""
        ahead = angular[:, :, 1:] * body_plan().damping_ratio
        if self.feed_forward > 0:
            stiffness = np.array(
                [[b.stiffness(n) for n in b.skeleton.names[1:]] for b in scene.bodies]
            )
            offset = inverse_dynamics(scene, reference).torque / stiffness[..., None]
            ahead = ahead + self.feed_forward * (offset[1:] + offset[:-1]) / 2
        local = from_wxyz(reference.rotations[1:, :, 1:].reshape(-1, 4))
        made = to_wxyz(local * Rotation.from_rotvec(ahead.reshape(-1, 3)))
        return made.reshape(len(ahead), -1, 4)

    def _most_offset(self, scene: Scene) -> FloatArray:
        """Return the largest distance of target from joint, rad, for all joints of both."""
        return np.array(
            [
                self.effort_factor * body.effort(name) / body.stiffness(name)
                for body in scene.bodies
                for name in body.skeleton.names[1:]
            ]
        )
