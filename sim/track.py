"""Make two simulated people do a motion: :class:`DuetMotion` in, :class:`Rollout` out."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from generator.motion import DuetMotion
from robots.errors import SimDiverged, SpecError, nearest
from robots.files import plain
from robots.skeleton import FloatArray
from sim.controllers.assist import AssistController
from sim.controllers.base import Controller, Progress, Trace
from sim.controllers.ilqr.controller import IlqrController
from sim.controllers.ilqr.settings import IlqrSettings
from sim.controllers.mppi.controller import MppiController
from sim.controllers.mppi.settings import MppiSettings
from sim.disturbance import NONE, Disturbance
from sim.reference import Reference, make_reference
from sim.rollout import Rollout, motion_sha256
from sim.scene import AssistLimits, Scene, build_scene

log = logging.getLogger(__name__)

CONTROLLERS: dict[str, Callable[[TrackSettings], Controller]] = {
    "ilqr": lambda settings: IlqrController(settings=settings.ilqr),
    "mppi": lambda settings: MppiController(settings=settings.mppi, seed=settings.seed),
    "assist": lambda settings: AssistController(),
}
"""What ``TrackSettings.controller`` may name, and how to make it."""

_STEPS = {"assist": 2}
"""Steps per kept moment of controllers that do not take one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackSettings:
    """How to track.

    Raises:
        SpecError: A value makes no sense.
    """

    controller: str = "ilqr"
    """One of :data:`CONTROLLERS`."""
    rate: float = 60.0
    """Moments per second that the rollout keeps."""
    steps: int = 0
    """Integration and control steps per kept moment; 0 takes what suits the controller."""
    smoothing: float = 0.02
    """Standard deviation of the low-pass on the reference, s."""
    assist: AssistLimits | None = None
    """Strength of the hand that helps each pelvis. ``None`` suits the controller: the defaults for
    ``assist``, and no hand for those that keep the balance themselves."""
    self_collision: bool = False
    """Whether a person's limbs collide with its own others."""
    weights: tuple[float | None, float | None] = (None, None)
    """Body masses of a and b, kg; ``None`` is a body mass index of 22."""
    disturbance: Disturbance = NONE
    """What the simulated world has otherwise than the controller believes."""

    seed: int = 0
    """Of controllers that draw random numbers."""
    ilqr: IlqrSettings = field(default_factory=IlqrSettings)
    """How ``ilqr`` plans."""
    mppi: MppiSettings = field(default_factory=MppiSettings)
    """How ``mppi`` samples."""

    def __post_init__(self) -> None:
        """Fill in what depends on the controller, and validate."""
        if self.steps == 0:
            object.__setattr__(self, "steps", _STEPS.get(self.controller, 1))
        if self.assist is None:
            none = AssistLimits(max_force=0, max_torque=0)
            suits = AssistLimits() if self.controller == "assist" else none
            object.__setattr__(self, "assist", suits)
        if self.controller not in CONTROLLERS:
            raise SpecError(
                f"no controller '{self.controller}'",
                allowed=", ".join(CONTROLLERS),
                hint=nearest(self.controller, CONTROLLERS),
            )
        if not 10 <= self.rate <= 480:
            raise SpecError(f"{self.rate} moments per second", allowed="10 to 480")
        if not 1 <= self.steps <= 16 or not 60 <= self.rate * self.steps <= 2000:
            raise SpecError(f"{self.rate * self.steps:.0f} steps per second", allowed="60 to 2000")
        if not 0 <= self.smoothing <= 1:
            raise SpecError(f"smoothing over {self.smoothing} s", allowed="0 to 1 s")


def track(
    motion: DuetMotion,
    *,
    settings: TrackSettings | None = None,
    progress: Progress | None = None,
) -> Rollout:
    """Return what two simulated people did when asked to do a motion.

    The same motion and settings give the same rollout on the same machine. Where the physics
    diverges or the controller gives up, the rollout ends, and its :attr:`~Rollout.ended` says when
    and why.

    Args:
        motion: What to do.
        settings: How; the defaults if not given.
        progress: Told the share of the work that is done, 0 to 1.

    Raises:
        SimDiverged: The motion itself is absurd: its poses are not finite.
        SpecError: The people are not of human size.
    """
    settings = settings or TrackSettings()
    step_rate = settings.rate * settings.steps
    reference = make_reference(
        motion, rate=step_rate, smoothing=settings.smoothing, weights=settings.weights
    )
    reference = _whole_moments(reference, settings.steps)
    helped = settings.assist
    scene = build_scene(
        reference.bodies,
        timestep=1 / step_rate,
        assist=helped if helped and (helped.max_force or helped.max_torque) else None,
        self_collision=settings.self_collision,
    )
    controller = CONTROLLERS[settings.controller](settings)

    def run() -> Trace:
        return controller.run(scene, reference, progress, disturbance=settings.disturbance)

    trace = _as_far_as_possible(run, scene, reference)
    rollout = _rollout(motion, settings, reference, scene, trace)
    for person, time in rollout.fall_time.items():
        if time is not None:
            log.warning("person %s fell at %.2f s", person, time)
    if rollout.ended is not None:
        log.warning("%s", rollout.ended["why"])
    return rollout


def _as_far_as_possible(run: Callable[[], Trace], scene: Scene, reference: Reference) -> Trace:
    """Return the trace of a run, up to the state before the physics diverged if it does.

    A trace that is shorter than the reference says so by a fact ``ended``: ``time`` s and ``why``.
    """
    try:
        trace = run()
    except SimDiverged as error:
        trace = error.trace or _first_pose(scene, reference)
        if error.time is None or not np.isfinite(trace.qpos).all():
            raise
        ended = {"time": error.time, "why": error.what}
        return replace(trace, facts={**trace.facts, "ended": ended})
    if len(trace.qpos) < len(reference.root) and "ended" not in trace.facts:
        time = (len(trace.qpos) - 1) / reference.rate
        ended = {"time": time, "why": f"the controller gave up at {time:.3f} s"}
        return replace(trace, facts={**trace.facts, "ended": ended})
    return trace


def _first_pose(scene: Scene, reference: Reference) -> Trace:
    """Return the trace of a run that never began."""
    qpos = scene.qpos(reference.root[:1], reference.rotations[:1])
    none = np.zeros((1, scene.model.nu)), np.zeros((1, 2, 6))
    torque = np.zeros((1, *reference.rotations.shape[1:3]))[..., 1:]
    return Trace(qpos, np.zeros((1, scene.model.nv)), *none, torque)


def _at_moments(trace: Trace, steps: int) -> Trace:
    """Return a trace that ends at a kept moment; a first state without a second is held."""
    last = max((len(trace.qpos) - 1) // steps, 1) * steps
    index = np.minimum(np.arange(last + 1), len(trace.qpos) - 1)
    names = ("qpos", "qvel", "ctrl", "assist", "torque")
    return replace(trace, **{name: getattr(trace, name)[index] for name in names})


def _whole_moments(reference: Reference, steps: int) -> Reference:
    """Return the reference with its last pose held until the next kept moment."""
    missing = -(len(reference.root) - 1) % steps
    if not missing:
        return reference

    def held(values: NDArray) -> FloatArray:
        return np.concatenate([values, np.repeat(values[-1:], missing, axis=0)])

    return replace(
        reference,
        root=held(reference.root),
        rotations=held(reference.rotations),
        keypoints=held(reference.keypoints),
    )


def _rollout(
    motion: DuetMotion,
    settings: TrackSettings,
    reference: Reference,
    scene: Scene,
    trace: Trace,
) -> Rollout:
    """Return the rollout of a trace, thinned to the moments that are kept."""
    trace = _at_moments(trace, settings.steps)
    keep = slice(0, len(trace.qpos), settings.steps)
    qpos = trace.qpos[keep]
    frames, seconds = motion.frames, (len(qpos) - 1) / settings.rate
    if "ended" in trace.facts:
        frames = min(frames, max(2, int(seconds * motion.fps + 1e-9) + 1))
    metadata: dict[str, Any] = {
        "text": motion.text,
        "source": motion.source,
        "licence": motion.licence,
        "seed": motion.seed,
        "interaction": motion.interaction,
        "contacts": [asdict(c) for c in motion.contacts],
        "controller": settings.controller,
        "settings": plain(settings),
        "input_sha256": motion_sha256(motion),
        "duration_s": motion.duration,
        "mujoco_version": mujoco.__version__,
        "ground_shift": list(reference.ground_shift),
        "repairs": reference.repairs,
        **plain(trace.facts),
    }
    return Rollout(
        times=np.arange(len(qpos)) / settings.rate,
        qpos=qpos,
        qvel=trace.qvel[keep],
        ctrl=trace.ctrl[keep],
        assist=_means(trace.assist, settings.steps),
        torque=_means(trace.torque, settings.steps),
        keypoints=scene.keypoints(qpos),
        reference=reference.keypoints[keep],
        reference_qpos=scene.qpos(reference.root[keep], reference.rotations[keep]),
        offsets=np.stack([b.skeleton.offsets for b in scene.bodies]),
        stature=np.array([b.stature for b in scene.bodies]),
        weight=np.array([b.weight for b in scene.bodies]),
        xml=scene.xml,
        fps=motion.fps,
        frames=frames,
        metadata=metadata,
    )


def _means(values: NDArray, steps: int) -> FloatArray:
    """Return, per kept moment, the mean of ``values [N, ...]`` over the steps that led to it."""
    later = values[1:].reshape(-1, steps, *values.shape[1:]).mean(axis=1)
    return np.concatenate([later[:1], later])
