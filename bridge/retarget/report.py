"""How well a retargeting kept what matters, as numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from bridge.retarget.build import SIDES, Build
from bridge.retarget.human import Person
from bridge.retarget.stage import Stage
from bridge.retarget.touch import NEAR, Touch
from robots.skeleton import FloatArray

TOUCH_SLACK = 1.25
"""Robot hands touch if they are nearer than this times the human threshold, scaled by the arms."""


@dataclass(frozen=True, slots=True)
class RetargetReport:
    """Figures of one retargeting."""

    hand_error_percent: float
    """Mean over both robots, hands and time of the difference between shoulder-to-hand vectors,
    each divided by its own arm length; without touches, where hands are meant to deviate."""
    contact_gap_error_mm: float
    """Mean over hand touches and their time of |gap - intended gap|; 0 if there are none."""
    contact_gap_error_max_mm: float
    """The largest."""
    contact_recall: float
    """Share of the time of hand touches in which the robots' hands touch too; 1 without touches."""
    contact_precision: float
    """Share of the time in which those hands of the robots touch that the humans' do."""
    penetration_max_mm: float
    """Deepest overlap of one robot with the other."""
    penetration_share: float
    """Share of the time with more than 1 mm of it."""
    floor_penetration_mm: float
    """Deepest overlap of a robot with the floor."""
    peak_velocity_rad_s: float
    """Fastest joint, before slowing down."""
    jerk_rms_rad_s3: float
    """Root mean square jerk over joints and time, before slowing down."""
    slowed_by: float
    """Common factor on time, so that no servo exceeds its share of no-load speed."""
    limit_violations: int
    """Samples outside a joint's range. Always 0 in what is written."""

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON, rounded to what means something."""
        return {name: round(value, 4) for name, value in asdict(self).items()}


def hand_error(
    people: tuple[Person, Person],
    builds: tuple[Build, Build],
    landmarks: tuple[dict[str, FloatArray], dict[str, FloatArray]],
    headings: tuple[FloatArray, FloatArray],
    touching: list[Touch],
) -> float:
    """Return :attr:`RetargetReport.hand_error_percent`.

    Args:
        people: The humans.
        builds: The robots.
        landmarks: Paths of the robots' landmarks on the stage.
        headings: ``[T]`` rad per person: by how much the stage is turned against the world.
        touching: Touches, left out.
    """
    touch = np.max([t.weight for t in touching], axis=0) if touching else None
    errors = []
    for person, build, at, turn in zip(people, builds, landmarks, headings, strict=True):
        for side in SIDES:
            reach = person.motion.point(f"{side}_hand") - person.motion.point(f"{side}_shoulder")
            cosine, sine = np.cos(turn), np.sin(turn)
            seen = np.stack(
                [
                    cosine * reach[:, 0] - sine * reach[:, 1],
                    sine * reach[:, 0] + cosine * reach[:, 1],
                    reach[:, 2],
                ],
                axis=1,
            )
            own = at[f"{side}_hand"] - at[f"{side}_shoulder"]
            error = np.linalg.norm(own / build.arm_length - seen / person.arm_length, axis=1)
            errors.append(error if touch is None else error[touch == 0])
    together = np.concatenate(errors)
    return float(100 * together.mean()) if len(together) else 0.0


def gaps(
    touch: Touch, landmarks: tuple[dict[str, FloatArray], dict[str, FloatArray]]
) -> FloatArray:
    """Return the distance ``[T]`` m between the two landmarks of a touch."""
    return np.linalg.norm(landmarks[1][touch.b] - landmarks[0][touch.a], axis=1)


def contact_figures(
    touching: list[Touch],
    landmarks: tuple[dict[str, FloatArray], dict[str, FloatArray]],
    arm_scale: float,
) -> dict[str, float]:
    """Return the four contact figures of the report, over touches of hands."""
    errors, kept, robots, both = [], [], 0, 0
    pairs: dict[tuple[str, str], NDArray[np.bool_]] = {}
    for touch in touching:
        if touch.of_hands:
            distance = gaps(touch, landmarks)
            threshold = max(TOUCH_SLACK * arm_scale * NEAR, 1.5 * touch.gap)
            errors.append(np.abs(distance - touch.gap)[touch.active])
            kept.append(distance[touch.active] < threshold)
            # Easing in and out belongs to the touch: hands are near before they meet.
            meant = touch.weight > 0
            pair = (touch.a, touch.b)
            pairs[pair] = pairs.get(pair, np.zeros_like(meant)) | meant
    for touch in touching:
        pair = (touch.a, touch.b)
        if pair in pairs:
            near = gaps(touch, landmarks) < max(TOUCH_SLACK * arm_scale * NEAR, 1.5 * touch.gap)
            robots += int(near.sum())
            both += int((near & pairs[pair]).sum())
    if not errors:
        return {
            "contact_gap_error_mm": 0.0,
            "contact_gap_error_max_mm": 0.0,
            "contact_recall": 1.0,
            "contact_precision": 1.0,
        }
    every = np.concatenate(errors)
    return {
        "contact_gap_error_mm": float(1e3 * every.mean()),
        "contact_gap_error_max_mm": float(1e3 * every.max()),
        "contact_recall": float(np.concatenate(kept).mean()),
        "contact_precision": both / robots if robots else 1.0,
    }


def collision_figures(stage: Stage, qpos: NDArray) -> dict[str, float]:
    """Return the three penetration figures of the report, by MuJoCo's own collision."""
    model = stage.model
    data = mujoco.MjData(model)
    owner = model.body_rootid[model.geom_bodyid]
    depths = np.zeros((len(qpos), 2))
    for t, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for contact in data.contact[: data.ncon]:
            one, other = owner[contact.geom1], owner[contact.geom2]
            if one != other:
                floor = int(one == 0 or other == 0)
                depths[t, floor] = max(depths[t, floor], -contact.dist)
    return {
        "penetration_max_mm": float(1e3 * depths[:, 0].max()),
        "penetration_share": float((depths[:, 0] > 1e-3).mean()),
        "floor_penetration_mm": float(1e3 * depths[:, 1].max()),
    }
