"""Two people on their own feet: a plan each, feedback between plans, and a second try after a fall.

**The problem.** A plan half a second long can lead where no next plan keeps the balance. By then it
is too late to plan better, but this is a simulation: it goes back to before the trouble and plans
anew, more often and with more sweeps, with fresh derivatives, until it is past. What was tried and
how often is part of the result.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from robots.errors import SimDiverged
from sim.controllers.base import Progress, Trace, quiet_mujoco, reference_qvel
from sim.controllers.guide import AssistGuide
from sim.controllers.ilqr.cost import TrackingCost
from sim.controllers.ilqr.person import PersonModel, person_model
from sim.controllers.ilqr.planner import Planner
from sim.controllers.ilqr.settings import IlqrSettings
from sim.controllers.ilqr.touch import find_touches
from sim.controllers.nominal import nominal_targets
from sim.disturbance import NONE, Disturbance
from sim.reference import Reference
from sim.rollout import FALL_DISTANCE
from sim.scene import Scene
from sim.simulation import Simulation, Snapshot
from sim.support import LEANS, leaning

log = logging.getLogger(__name__)

TROUBLE = 0.3
"""A person whose keypoints are further than this, m, from the reference on average is lost: time to
go back."""
_KEEP = 0.25
"""Time between states to go back to, s."""
_BACK, _BACK_MORE = 0.7, 0.5
"""How far to go back, s, and how much further with every failure at the same place."""
_TRIES = 3
"""How often the same half second is tried anew."""
_FURTHER = 0.1
"""How much further, s, the second try must have come to be worth a third."""
_WAYPOINTS = 12
"""How many states to go back to are kept: 3 s, further than any try goes back."""
_PAST = 0.5
"""How long after the trouble the extra effort lasts, s."""
_AFTER_FALL = 0.5
"""How long a fall is shown before the run ends, s."""


@dataclass(frozen=True, slots=True, eq=False)
class _Waypoint:
    """A state to go back to, and the plans that were in force."""

    snapshot: Snapshot
    plans: tuple[Any, Any]


@dataclass(slots=True)
class _Recovery:
    """What is known about failures so far."""

    waypoints: list[_Waypoint] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    tries: dict[int, int] = field(default_factory=dict)
    """Failures per half second of the reference."""
    until: int = -1
    """Tick up to which extra effort is made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IlqrController:
    """Receding-horizon iLQR for each person, with the partner as a moving ghost."""

    settings: IlqrSettings = field(default_factory=IlqrSettings)
    name: str = "ilqr"

    def run(
        self,
        scene: Scene,
        reference: Reference,
        progress: Progress | None = None,
        *,
        disturbance: Disturbance = NONE,
    ) -> Trace:
        """Simulate the reference; see :class:`sim.controllers.base.Controller`.

        Ends early, half a second after a person fell whom no recovery saved; ``facts["ended"]``
        then says so.
        """
        rounds = 1 + self.settings.refinements
        # Matrices of this size are multiplied several times slower by two threads than by one.
        one_each = threadpool_limits(limits=1, user_api="blas")
        with quiet_mujoco(), one_each, ThreadPoolExecutor(self.settings.threads) as pool:

            def perform(i: int, earlier: Trace | None) -> tuple[Trace, float]:
                run = _Run(self.settings, scene, reference, disturbance, pool, earlier)
                trace = run.to_end(partial(_share, progress, i, rounds) if progress else None)
                return trace, np.inf if run.fallen is not None else run.error

            best, least = perform(0, None)
            for i in range(1, rounds):
                trace, error = perform(i, best)
                if error >= least:
                    break
                best, least = trace, error
        return best


class _Run:
    """One run: both planners, the simulation, and the way back."""

    def __init__(
        self,
        settings: IlqrSettings,
        scene: Scene,
        reference: Reference,
        disturbance: Disturbance,
        pool: ThreadPoolExecutor,
        earlier: Trace | None = None,
    ) -> None:
        self.settings, self.scene, self.reference = settings, scene, reference
        self.pool = pool
        self.simulation = Simulation(scene, reference, disturbance)
        self.goal = scene.qpos(reference.root, reference.rotations)
        self.goal_keypoints = scene.keypoints(self.goal)
        self.ghost = settings.ghost
        if self.ghost == "auto":
            self.ghost = "yielding" if max(leaning(scene, reference)) > LEANS else False
        self.people = [person_model(scene, p, ghost=self.ghost) for p in range(2)]
        self.guide = AssistGuide(scene, reference)
        self.planners = _planners(
            settings, scene, reference, self.goal, self.people, self.guide, earlier
        )
        self.recovery = _Recovery()
        self.fallen: int | None = None
        self.furthest: Trace | None = None

    @property
    def _most_tries(self) -> int:
        """How often this motion may be gone back in: what nobody can do is to end soon."""
        seconds = (len(self.reference.root) - 1) / self.reference.rate
        return min(self.settings.recovery, max(2, round(seconds)))

    @property
    def error(self) -> float:
        """Mean distance of all keypoints from their goals so far, m."""
        keypoints = self.scene.keypoints(self.simulation.trace().qpos)
        off = keypoints - self.goal_keypoints[: len(keypoints)]
        return float(np.linalg.norm(off, axis=-1).mean())

    def to_end(self, progress: Progress | None) -> Trace:
        """Run, and return what happened."""
        simulation, rate = self.simulation, self.reference.rate
        last = len(self.reference.root) - 1
        while not simulation.done:
            if simulation.tick % round(_KEEP * rate) == 0:
                self._keep()
            if self._lost(TROUBLE) and self._go_back():
                continue
            if self.fallen is None and self._lost(FALL_DISTANCE):
                self.fallen = simulation.tick
            if self.fallen is not None and simulation.tick >= self.fallen + _AFTER_FALL * rate:
                break
            try:
                self._advance()
            except (SimDiverged, np.linalg.LinAlgError) as error:
                self._remember()
                if not self._go_back():
                    raise self._diverged() from error
            if progress is not None:
                progress(simulation.tick / last)
        return replace(simulation.trace(), facts=self._facts())

    def _advance(self) -> None:
        """Plan where it is time to, set the controls, and step."""
        simulation, data, tick = self.simulation, self.simulation.data, self.simulation.tick
        hard = tick < self.recovery.until
        every = max(1, self.settings.replan // 2) if hard else self.settings.replan
        if tick % every == 0 or any(planner.expired(tick) for planner in self.planners):
            if not hard and self.recovery.until >= 0:
                self._relax()
            forecasts = [planner.forecast(tick) for planner in self.planners]
            states = [
                (data.qpos[m.qpos], data.qvel[m.qvel], data.qacc_warmstart[m.qvel])
                for m in self.people
            ]

            def plan(p: int) -> None:
                self.planners[p].plan(tick, *states[p], forecasts[1 - p])

            list(self.pool.map(plan, range(2)))
        for p, (person, planner) in enumerate(zip(self.people, self.planners, strict=True)):
            control = planner.control(tick, data.qpos[person.qpos], data.qvel[person.qvel])
            data.ctrl[self.scene.maps[p].targets.reshape(-1)] = control
        for p in self.guide.helped:
            self.guide.set(data, tick, p, self.scene.maps[p])
        simulation.step()

    def _remember(self) -> None:
        """Keep what happened if no try came further before the physics diverged."""
        if self.furthest is None or self.simulation.tick >= len(self.furthest.qpos):
            self.furthest = self.simulation.trace()

    def _diverged(self) -> SimDiverged:
        """Return what to raise where the physics, or a plan in it, ran into absurd numbers."""
        trace = self.furthest or self.simulation.trace()
        time = (len(trace.qpos) - 1) / self.reference.rate
        return SimDiverged(
            f"the physics diverged at {time:.3f} s",
            hint="check the motion there: a jump or people deep inside each other",
            time=time,
            trace=replace(trace, facts=self._facts()),
        )

    def _lost(self, distance: float) -> bool:
        """Return whether a person is further than this, m, from its goal on average."""
        goal = self.goal_keypoints[self.simulation.tick]
        off = np.linalg.norm(self.simulation.keypoints() - goal, axis=-1)
        return bool((off.mean(axis=-1) > distance).any())

    def _keep(self) -> None:
        plans = self.planners[0].state, self.planners[1].state
        self.recovery.waypoints.append(_Waypoint(self.simulation.snapshot(), plans))
        del self.recovery.waypoints[:-_WAYPOINTS]

    def _go_back(self) -> bool:
        """Return to before the trouble with more effort; False if that was tried often enough."""
        recovery, rate, tick = self.recovery, self.reference.rate, self.simulation.tick
        if self.fallen is not None:
            self._relax()  # who lies there needs no effort
            return False
        place = int(tick / (0.5 * rate))
        again = recovery.tries.get(place, 0)
        stuck = again > 1 and tick / rate < recovery.events[-1]["lost_at"] + _FURTHER
        if stuck or again >= _TRIES or len(recovery.events) >= self._most_tries:
            return False
        recovery.tries[place] = again + 1
        target = tick - (_BACK + _BACK_MORE * again) * rate
        while len(recovery.waypoints) > 1 and recovery.waypoints[-1].snapshot.tick > target:
            recovery.waypoints.pop()
        waypoint = recovery.waypoints.pop()
        self.simulation.restore(waypoint.snapshot)
        recovery.until = tick + round(_PAST * rate)
        to = waypoint.snapshot.tick / rate
        recovery.events.append({"lost_at": tick / rate, "back_to": to, "iterations": 3 + again})
        log.info("lost the balance at %.2f s: back to %.2f s", tick / rate, to)
        for planner, plan in zip(self.planners, waypoint.plans, strict=True):
            planner.state = plan
            planner.iterations = 3 + again
            planner.derivatives.tolerance = min(1.0, self.settings.cache)
            planner.regularisation = self.settings.regularisation * (10 if again % 2 else 1)
        return True

    def _relax(self) -> None:
        """Return to the ordinary effort."""
        self.recovery.until = -1
        for planner in self.planners:
            planner.iterations = self.settings.iterations
            planner.derivatives.tolerance = self.settings.cache
            planner.regularisation = self.settings.regularisation

    def _facts(self) -> dict[str, Any]:
        asked = sum(planner.derivatives.asked for planner in self.planners)
        taken = sum(planner.derivatives.taken for planner in self.planners)
        repaired = sum(planner.derivatives.repaired for planner in self.planners)
        facts: dict[str, Any] = {
            "recoveries": self.recovery.events,
            "derivatives": {"asked": asked, "taken": taken, "repaired": repaired},
            "ghost": self.ghost,
        }
        if self.fallen is not None:
            time = self.fallen / self.reference.rate
            facts["ended"] = {
                "time": self.simulation.tick / self.reference.rate,
                "why": f"a person fell at {time:.2f} s, {len(self.recovery.events)} recoveries",
            }
        return facts


def _planners(
    settings: IlqrSettings,
    scene: Scene,
    reference: Reference,
    goal: NDArray,
    people: list[PersonModel],
    guide: AssistGuide,
    earlier: Trace | None,
) -> list[Planner]:
    """Return the planners of both people; controls of an earlier run are what they deviate from."""
    speed = reference_qvel(scene, reference)
    nominal = nominal_targets(scene, reference, settings.feed_forward)
    nominal = nominal.reshape(*nominal.shape[:2], -1)
    reach = [[b.effort(n) / b.stiffness(n) for n in b.skeleton.names[1:]] for b in scene.bodies]
    span = settings.effort_factor * np.repeat(reach, 3, axis=1)
    bounds = nominal - span, nominal + span
    if earlier is not None:
        ctrl = [earlier.ctrl[:-1, at.targets.reshape(-1)] for at in scene.maps]
        nominal = np.stack(ctrl, axis=1)
    poses = [person.poses(goal[:, person.qpos]) for person in people]
    touches = find_touches(scene.bodies, poses, reference.contacts, reference.rate)
    out = []
    for p, person in enumerate(people):
        cost = TrackingCost(person, goal[:, person.qpos], speed[:, person.qvel], settings.weights)
        out.append(
            Planner(
                person,
                cost,
                nominal[:, p],
                (bounds[0][:, p], bounds[1][:, p]),
                settings,
                rate=reference.rate,
                touches=touches[p],
                guide=partial(_guided, guide, p, person) if p in guide.helped else None,
            )
        )
    return out


def _share(progress: Progress, i: int, rounds: int, share: float) -> None:
    progress((i + share) / rounds)


def _guided(guide: AssistGuide, p: int, person: PersonModel, data: Any, tick: int) -> None:
    """Set the root assist in a person's own model."""
    guide.set(data, tick, p, person.at)
