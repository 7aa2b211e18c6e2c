"""From a rollout or a bare motion to a :class:`Report`.

The score is a product of terms, one per kind of fault, each 1 up to a value that nobody minds and
1/2 at a value that everybody sees (:func:`tolerance`), to the power of its weight. So one gross
fault spoils the score whatever else is good, every term can be read alone, and no term is ever 0.
The gate is separate: it asks of every threshold whether it is kept.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from generator.motion import DuetMotion
from robots.humanoid import HumanBody
from sim.footing import sole_corners
from sim.gate import KINEMATIC_TERMS, TRACKED_TERMS, Gate, Subject, Term
from sim.inverse import inverse_dynamics
from sim.metrics import contact, effort, ground, penetration, posture, smoothness, tracking
from sim.reference import make_reference
from sim.report import Metric, Report
from sim.rollout import Rollout, motion_sha256
from sim.scene import Scene, build_scene
from sim.sheet import PEOPLE, Sheet

TOUCH = 0.010
"""Two people deeper inside each other than this, m, collide; less is soft flesh."""


def tolerance(value: float, good: float, half: float) -> float:
    """Return how tolerable a value is: 1 at ``good`` or better, 1/2 at ``half``, towards 0 beyond.

    ``1 / (1 + x^2)`` with ``x = (value - good) / (half - good)``, or 1 for negative ``x``. With
    ``half < good`` smaller values are worse.
    """
    x = max(0.0, (value - good) / (half - good))
    return 1 / (1 + x * x)


def score(rollout: Rollout, gate: Gate | None = None) -> Report:
    """Return the report on a tracked duet.

    Args:
        rollout: What physics made of the motion.
        gate: Thresholds; the defaults if not given.

    Raises:
        SpecError: The rollout's scene is not one of this project.
    """
    gate, sheet = gate or Gate(), Sheet(rollout.times)
    keypoints, reference, rate = rollout.keypoints, rollout.reference, rollout.rate
    bodies = rollout.bodies
    sheet.fall(rollout)
    sheet.ended(rollout)
    error = tracking.mpjpe(keypoints, reference) * 1000
    sheet.people(
        ("mpjpe_global", "simulated", "mm", "mean keypoint distance from the reference"),
        error,
        threshold=gate.mpjpe_global_mm,
    )
    sheet.people(
        ("mpjpe_root", "simulated", "mm", "the same with the pelvises put together"),
        tracking.mpjpe_root(keypoints, reference) * 1000,
    )
    sheet.people(
        ("acceleration_error", "simulated", "mm/frame²", "mean error of accelerations, 1/30 s"),
        tracking.acceleration_error(keypoints, reference, rate) * 1000,
    )
    _assist(sheet, rollout, bodies, gate)
    _contacts(sheet, rollout, bodies)
    scene = rollout.scene()
    given = rollout.as_given(scene)  # judged as it is, not as it was repaired
    made, asked = (penetration.overlap(scene, qpos) for qpos in (rollout.qpos, given))
    _overlap(sheet, "simulated", made, gate.penetration_p95_mm, gate.floor_penetration_p95_mm)
    _feet(sheet, "simulated", scene, rollout.qpos, keypoints, rate)
    _overlap(sheet, "reference", asked, gate.reference_penetration_p95_mm, None)
    _feet(sheet, "reference", scene, given, reference, rate)
    _shift(sheet, rollout.metadata.get("ground_shift", (0.0, 0.0)))
    _body(sheet, reference, bodies, rate, gate)
    info = rollout.metadata
    return _report("tracked", sheet.metrics, TRACKED_TERMS, gate, info, float(rollout.times[-1]))


def score_motion(motion: DuetMotion, gate: Gate | None = None) -> Report:
    """Return the report on a motion alone, without asking physics to follow it.

    Raises:
        SpecError: The people are not of human size.
    """
    gate = gate or Gate()
    reference = make_reference(motion, rate=motion.fps, smoothing=0.0, repair=False)
    sheet = Sheet(reference.times)
    scene = build_scene(reference.bodies)
    qpos = scene.qpos(reference.root, reference.rotations)
    asked = penetration.overlap(scene, qpos)
    _overlap(
        sheet,
        "reference",
        asked,
        gate.reference_penetration_p95_mm,
        gate.reference_floor_p95_mm,
        gate.reference_float_mean_mm,
    )
    _feet(sheet, "reference", scene, qpos, reference.keypoints, motion.fps)
    _shift(sheet, reference.ground_shift)
    _body(sheet, reference.keypoints, reference.bodies, motion.fps, gate)
    residual = effort.force_share(inverse_dynamics(scene, reference).residual, reference.bodies)
    sheet.people(
        ("residual_force_mean", "reference", "% weight", "mean force that no floor could give"),
        residual * 100,
        threshold=gate.residual_force_mean_percent,
    )
    info = {
        "text": motion.text,
        "licence": motion.licence,
        "input_sha256": motion_sha256(motion),
    }
    return _report("kinematic", sheet.metrics, KINEMATIC_TERMS, gate, info, motion.duration)


def _assist(
    sheet: Sheet, rollout: Rollout, bodies: tuple[HumanBody, HumanBody], gate: Gate
) -> None:
    """Add how much the helping hand and the muscles had to give."""
    force = effort.force_share(rollout.assist, bodies) * 100
    unit = "% weight"
    sheet.people(
        ("assist_mean", "simulated", unit, "mean force of the helping hand"),
        force,
        threshold=gate.assist_mean_percent,
    )
    sheet.people(("assist_p95", "simulated", unit, "in 95 % of the time"), force, summary="p95")
    sheet.people(("assist_max", "simulated", unit, "at most"), force, summary="max")
    sheet.people(
        ("assist_torque_mean", "simulated", "% weight × stature", "mean torque of that hand"),
        effort.torque_share(rollout.assist, bodies) * 100,
    )
    sheet.people(
        ("effort_p95", "simulated", "% limit", "hardest working joint, in 95 % of the time"),
        effort.effort_ratio(rollout.torque, bodies) * 100,
        summary="p95",
    )


def _contacts(sheet: Sheet, rollout: Rollout, bodies: tuple[HumanBody, HumanBody]) -> None:
    """Add the share of intended touches that happened, if any were intended."""
    skeletons = (bodies[0].skeleton, bodies[1].skeleton)
    wanted, met = contact.wanted_and_met(
        rollout.times, rollout.keypoints, rollout.reference, skeletons, rollout.contacts
    )
    if not wanted.any():
        return
    missed = (wanted & ~met).any(axis=1)
    sheet.metrics.append(
        Metric(
            name="contact_recall",
            of="simulated",
            person="both",
            value=100 * float((wanted & met).sum() / wanted.sum()),
            unit="%",
            definition="wanted touches that happen, within 5 cm of what was wanted",
            sense="min",
            worst_time=float(sheet.times[np.argmax(missed)]) if missed.any() else None,
        )
    )


def _overlap(
    sheet: Sheet,
    of: Subject,
    found: penetration.Overlap,
    between: float | None,
    floor: float | None,
    floating: float | None = None,
) -> None:
    """Add how deep the people are in each other and in the floor, and how far above it."""
    depth = found.depth * 1000
    sheet.both(
        ("penetration_p95", of, "mm", "depth of the people in each other in 95 % of the time"),
        depth,
        summary="p95",
        threshold=between,
    )
    sheet.both(("penetration_max", of, "mm", "deepest"), depth, summary="max")
    sheet.both(
        ("penetration_share", of, "% time", "deeper than 10 mm"), (depth > TOUCH * 1000) * 100.0
    )
    sheet.people(
        ("floor_penetration_p95", of, "mm", "depth below the floor in 95 % of the time"),
        ground.floor_penetration(found.lowest) * 1000,
        summary="p95",
        threshold=floor,
    )
    sheet.people(
        ("float_mean", of, "mm", "mean height of the lowest point above the floor"),
        ground.floating(found.lowest) * 1000,
        threshold=floating,
    )


def _feet(
    sheet: Sheet, of: Subject, scene: Scene, qpos: NDArray, keypoints: NDArray, rate: float
) -> None:
    """Add how feet slide."""
    skeleton = scene.bodies[0].skeleton
    toes = keypoints[:, :, [skeleton.index(f"{side}_foot") for side in ("left", "right")]]
    sheet.people(
        ("skate_ratio", of, "% time", "toe keypoint below 5 cm and faster than 0.5 m/s"),
        ground.skating(toes, rate) * 100.0,
    )
    root, rotations = scene.poses(qpos)
    corners = [
        sole_corners(body, root[:, p], rotations[:, p]).reshape(len(qpos), -1, 3)
        for p, body in enumerate(scene.bodies)
    ]
    slides, speed = ground.sliding(np.stack(corners, axis=1), rate)
    sheet.people(
        ("slide_ratio", of, "% time", "a sole within 1 cm of the floor faster than 0.5 m/s"),
        slides * 100.0,
    )
    sheet.people(("slide_speed", of, "m/s", "mean speed of soles on the floor"), speed)


def _shift(sheet: Sheet, shifts: Sequence[float]) -> None:
    """Add how far each person was moved up or down to stand on the floor."""
    for person, shift in zip(PEOPLE, shifts, strict=True):
        sheet.metrics.append(
            Metric(
                name="ground_shift",
                of="reference",
                person=person,
                value=abs(float(shift)) * 1000,
                unit="mm",
                definition="moved up or down so that standing soles are on the floor",
            )
        )


def _body(
    sheet: Sheet,
    keypoints: NDArray,
    bodies: tuple[HumanBody, HumanBody],
    rate: float,
    gate: Gate,
) -> None:
    """Add whether the motion asked for is one of upright, rigid, unhurried people."""
    sheet.people(
        ("speed_max", "reference", "m/s", "speed of the fastest keypoint"),
        smoothness.speed(keypoints, rate),
        summary="max",
        threshold=gate.speed_max,
    )
    sheet.people(
        ("jerk_mean", "reference", "m/s³", "mean jerk of keypoints"),
        smoothness.jerk(keypoints, rate),
    )
    sheet.people(
        ("bone_deviation_p95", "reference", "%", "most that a bone changes its length"),
        smoothness.bone_deviation(keypoints, bodies[0].skeleton.parents) * 100,
        summary="p95",
        threshold=gate.bone_deviation_p95_percent,
    )
    sheet.people(
        ("bend_excess_p95", "reference", "°", "most that a joint is bent beyond what people can"),
        posture.bend_excess(keypoints, bodies[0].skeleton),
        summary="p95",
        threshold=gate.bend_excess_p95_degrees,
    )
    skeletons = (bodies[0].skeleton, bodies[1].skeleton)
    sheet.people(
        ("pelvis_height_min", "reference", "% standing", "lowest pelvis"),
        ground.pelvis_height(keypoints, skeletons) * 100,
        summary="min",
        threshold=gate.pelvis_height_min_percent,
    )


def _report(
    kind: Literal["tracked", "kinematic"],
    metrics: Sequence[Metric],
    terms: Sequence[Term],
    gate: Gate,
    info: dict[str, Any],
    duration: float,
) -> Report:
    total = 100.0
    for term in terms:
        for value in _worst(metrics, term):
            total *= tolerance(value, term.good, term.half) ** term.weight
    return Report(
        kind=kind,
        score=round(total, 2),
        metrics=tuple(metrics),
        text=str(info.get("text", "")),
        licence=str(info.get("licence", "")),
        duration=round(duration, 6),
        input_sha256=str(info.get("input_sha256", "")),
        versions=_versions(),
        gate=asdict(gate),
    )


def _worst(metrics: Sequence[Metric], term: Term) -> list[float]:
    """Return the worse of both people's values, or nothing if it was not measured."""
    values = [m.value for m in metrics if (m.name, m.of) == (term.name, term.of)]
    if not values:
        return []
    return [max(values) if term.half > term.good else min(values)]


def _versions() -> dict[str, str]:
    try:
        own = metadata.version("pasdedeux")
    except metadata.PackageNotFoundError:
        own = "unknown"
    return {
        "pasdedeux": own,
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
