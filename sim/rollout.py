"""The result of tracking: what two simulated people did, and what they were asked to do."""

from __future__ import annotations

import hashlib
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from generator.kinematics import continuous, fit_rotations, forward_kinematics
from generator.motion import Contact, DuetMotion, Motion
from robots.errors import DuetError, MotionFileError
from robots.files import read_archive, write_archive
from robots.humanoid import HumanBody
from robots.skeleton import FloatArray, human_skeleton, read_only
from sim.scene import PEOPLE, Scene, load_scene

SCHEMA = "pasdedeux.rollout/1"

FALL_DISTANCE = 0.5
"""A person whose keypoints are further than this, m, from the reference on average has fallen.
Z. Luo et al., "Perpetual Humanoid Control for Real-time Simulated Avatars", ICCV 2023."""

_ARRAYS = (
    "times",
    "qpos",
    "qvel",
    "ctrl",
    "assist",
    "torque",
    "keypoints",
    "reference",
    "reference_qpos",
    "offsets",
    "stature",
    "weight",
)


@dataclass(frozen=True, slots=True, eq=False)
class Rollout:
    """States of a simulated duet over time, with its reference and its scene.

    Raises:
        MotionFileError: Shapes do not fit each other, times do not increase, or a number is not
            finite.
    """

    times: FloatArray
    """``[N]`` s, strictly increasing from 0."""
    qpos: FloatArray
    """``[N, nq]``."""
    qvel: FloatArray
    """``[N, nv]``."""
    ctrl: FloatArray
    """``[N, nu]``, set at each moment."""
    assist: FloatArray
    """``[N, 2, 6]``: force N (world) and torque N m on each pelvis that no muscle gave; mean over
    the time since the moment before."""
    torque: FloatArray
    """``[N, 2, J-1]`` N m: size of each joint's torque; mean over the time since the moment
    before."""
    keypoints: FloatArray
    """``[N, 2, J, 3]`` m, world: where the simulated keypoints were."""
    reference: FloatArray
    """``[N, 2, J, 3]`` m, world: where the motion had them, on the floor of the simulation."""
    reference_qpos: FloatArray
    """``[N, nq]``: the poses that were tracked."""
    offsets: FloatArray
    """``[2, J, 3]`` m: rest offsets of the two skeletons."""
    stature: FloatArray
    """``[2]`` m."""
    weight: FloatArray
    """``[2]`` kg."""
    xml: str
    """MJCF of the scene."""
    fps: float
    """Frame rate of the motion that was tracked."""
    frames: int
    """Number of its frames that were simulated."""
    metadata: dict[str, Any] = field(default_factory=dict)
    """Plain JSON: ``text``, ``source``, ``licence``, ``seed``, ``interaction``, ``contacts``,
    ``controller``, ``settings``, ``input_sha256``, ``duration_s`` (of the motion),
    ``mujoco_version``, ``ground_shift``, ``repairs``; what the controller says of the run, such
    as ``recoveries`` and ``ended``."""

    def __post_init__(self) -> None:
        """Validate and freeze."""
        count, joints = len(np.asarray(self.times)), len(human_skeleton())
        shapes = {
            "times": (count,),
            "qpos": (count, -1),
            "qvel": (count, -1),
            "ctrl": (count, -1),
            "assist": (count, 2, 6),
            "torque": (count, 2, joints - 1),
            "keypoints": (count, 2, joints, 3),
            "reference": (count, 2, joints, 3),
            "reference_qpos": (count, -1),
            "offsets": (2, joints, 3),
            "stature": (2,),
            "weight": (2,),
        }
        for name, shape in shapes.items():
            array = np.asarray(getattr(self, name))
            fits = array.ndim == len(shape) and all(
                want in (-1, got) for want, got in zip(shape, array.shape, strict=True)
            )
            if not fits or array.dtype.kind not in "fiu":
                raise MotionFileError(
                    f"has shape {array.shape}", where=f"rollout.{name}", allowed=str(shape)
                )
            if not np.isfinite(array).all():
                raise MotionFileError("is not finite", where=f"rollout.{name}")
            object.__setattr__(self, name, read_only(array))
        if count < 2 or self.times[0] != 0 or (np.diff(self.times) <= 0).any():
            raise MotionFileError("times must increase from 0", where="rollout.times")
        if self.qpos.shape != self.reference_qpos.shape:
            raise MotionFileError("differs from qpos in shape", where="rollout.reference_qpos")
        if not (1 <= self.fps <= 1000 and self.frames >= 2):
            raise MotionFileError(f"{self.frames} frames at {self.fps}", where="rollout")

    @property
    def rate(self) -> float:
        """Moments per second."""
        return (len(self.times) - 1) / float(self.times[-1])

    @property
    def bodies(self) -> tuple[HumanBody, HumanBody]:
        """The two people."""
        a, b = (_body(self.offsets[p], self.stature[p], self.weight[p]) for p in range(2))
        return a, b

    @property
    def error(self) -> FloatArray:
        """``[N, 2]`` m: mean distance of a person's keypoints from the reference."""
        return np.linalg.norm(self.keypoints - self.reference, axis=-1).mean(axis=-1)

    @property
    def fall_time(self) -> dict[str, float | None]:
        """When each person first was further off than :data:`FALL_DISTANCE`, s; else ``None``."""
        out: dict[str, float | None] = {}
        for p, person in enumerate(PEOPLE):
            far = self.error[:, p] > FALL_DISTANCE
            out[person] = float(self.times[int(np.argmax(far))]) if far.any() else None
        return out

    @property
    def fell(self) -> dict[str, bool]:
        """Whether each person fell."""
        return {person: time is not None for person, time in self.fall_time.items()}

    @property
    def ended(self) -> dict[str, Any] | None:
        """``time`` s and ``why`` the run ended before the motion did; ``None`` if it did not."""
        ended = self.metadata.get("ended")
        if ended is None:
            return None
        return {"time": float(ended["time"]), "why": str(ended["why"])}

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Touches that the motion labels."""
        return tuple(Contact(**c) for c in self.metadata.get("contacts", ()))

    def scene(self) -> Scene:
        """Return the scene, compiled anew.

        Raises:
            SpecError: The MJCF is not one that this project makes.
        """
        return load_scene(self.xml, self.bodies)

    def as_given(self, scene: Scene) -> FloatArray:
        """Return the poses ``[N, nq]`` of the motion's own keypoints, before any repair."""
        rotations = [
            fit_rotations(body.skeleton, self.reference[:, p]) for p, body in enumerate(self.bodies)
        ]
        return scene.qpos(self.reference[:, :, 0], np.stack(rotations, axis=1))

    def as_motion(self) -> DuetMotion:
        """Return what was simulated as a motion of the original frame rate."""
        scene, meta = self.scene(), self.metadata
        root, rotations = scene.poses(self.qpos)
        times = np.minimum(np.arange(self.frames) / self.fps, self.times[-1])
        people = []
        for p, body in enumerate(self.bodies):
            path = _interpolate(self.times, root[:, p], times)
            turns = _interpolate(self.times, continuous(rotations[:, p]), times)
            turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
            points = forward_kinematics(body.skeleton, path, turns)
            people.append(Motion(self.fps, points, rotations=turns, skeleton=body.skeleton))
        return DuetMotion(
            people[0],
            people[1],
            text=meta.get("text", ""),
            seed=meta.get("seed"),
            source=meta.get("source", ""),
            licence=meta.get("licence", ""),
            contacts=self.contacts,
            interaction=meta.get("interaction", ""),
            kind="simulated",
        )

    def save(self, path: str | Path) -> None:
        """Write as npz with a JSON header.

        Raises:
            MotionFileError: The file cannot be written.
        """
        header = {
            "schema": SCHEMA,
            "keypoint_names": list(human_skeleton().names),
            "people": list(PEOPLE),
            "fps": self.fps,
            "frames": self.frames,
            "xml": self.xml,
            "metadata": self.metadata,
        }
        write_archive(path, header, {name: getattr(self, name) for name in _ARRAYS})

    @classmethod
    def load(cls, path: str | Path) -> Rollout:
        """Read what :meth:`save` wrote.

        Raises:
            MotionFileError: The file is not such a rollout.
        """
        where = str(path)
        header, arrays = read_archive(path)
        if header is None or header.get("schema") != SCHEMA:
            raise MotionFileError(
                "this is not a rollout", where=where, hint="make one with 'track'"
            )
        if header.get("keypoint_names") != list(human_skeleton().names):
            raise MotionFileError("keypoints are not those of this version", where=where)
        try:
            rollout = cls(
                **{name: arrays[name] for name in _ARRAYS},
                xml=str(header["xml"]),
                fps=float(header["fps"]),
                frames=int(header["frames"]),
                metadata=dict(header["metadata"]),
            )
            _ = rollout.contacts, rollout.bodies, rollout.ended
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise MotionFileError(f"incomplete rollout: {error!r}", where=where) from error
        except DuetError as error:
            raise MotionFileError(str(error), where=where) from error
        return rollout


def motion_sha256(motion: DuetMotion) -> str:
    """Return a hash, in hex, of what tracking looks at.

    That is the frame rate, the labelled touches, and both people's keypoints, rotations and bones.
    """
    digest = hashlib.sha256(repr((motion.fps, [astuple(c) for c in motion.contacts])).encode())
    for person in motion.people:
        turns = () if person.rotations is None else person.rotations
        for array in (person.keypoints, turns, person.skeleton.offsets):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


def _body(offsets: NDArray, stature: float, weight: float) -> HumanBody:
    base = human_skeleton()
    skeleton = type(base)(base.names, base.parents, offsets, base.hand_per_forearm)
    return HumanBody(skeleton, float(stature), float(weight))


def _interpolate(times: NDArray, values: NDArray, at: NDArray) -> FloatArray:
    return make_interp_spline(times, values, k=1, axis=0)(at)
