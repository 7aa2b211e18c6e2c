"""Time the derivatives of a step: CPU time of mjd_transitionFD over that of ours.

Usage: ``python benchmarks/linearize.py``; states of a choreographed walk, tracked with assist.
"""

from __future__ import annotations

import time

import mujoco
import numpy as np

from generator.choreographer import choreograph
from sim.controllers.ilqr.linearize import Linearizer
from sim.controllers.ilqr.person import person_model
from sim.scene import build_scene
from sim.track import TrackSettings, track

_KNOTS = 100


def main() -> None:
    """Print milliseconds per state, and their ratio."""
    rollout = track(
        choreograph("walk_together", seed=0), settings=TrackSettings(controller="assist")
    )
    person = person_model(build_scene(rollout.scene().bodies, timestep=1 / 60), 0)
    model, maps = person.model, rollout.scene().maps[0]
    data = mujoco.MjData(model)
    spent = {}
    for name, linearize in (
        ("exact", Linearizer(model, exact=True)),
        ("fast", Linearizer(model)),
    ):
        spent[name] = 0.0
        for t in np.linspace(0, len(rollout.qpos) - 2, _KNOTS).astype(int):
            data.qpos[:], data.qvel[:] = rollout.qpos[t, person.qpos], rollout.qvel[t, person.qvel]
            data.ctrl[:] = rollout.ctrl[t, maps.targets.reshape(-1)]
            data.mocap_pos[:] = 10.0
            mujoco.mj_forward(model, data)
            data.qacc_warmstart[:] = data.qacc
            start = time.process_time()
            linearize(data)
            spent[name] += time.process_time() - start
    exact, fast = (1e3 * spent[n] / _KNOTS for n in ("exact", "fast"))
    print(f"derivatives: {exact:.2f} ms exact, {fast:.2f} ms fast, {exact / fast:.1f} times less")


if __name__ == "__main__":
    main()
