"""The body of a simulated person as MJCF: bones from a skeleton, flesh from ``human/body.toml``.

One MuJoCo body per keypoint, with its frame on the keypoint and aligned with the world in the rest
pose; a free joint at the pelvis and ball joints elsewhere; capsules for limbs and trunk, two boxes
per foot so that it stands on corners instead of rolling. Joints are driven by ``orientation``
actuators: a spring on SO(3) towards a target rotation, with damping. Their effort is limited by
keeping targets near (see :mod:`sim.controllers.base`), not by ``forcerange``, because a saturated
actuator drops out of MuJoCo's implicit integration and light segments explode.
"""

from __future__ import annotations

import tomllib
import xml.etree.ElementTree as ET
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np

from robots.errors import SpecError, nearest
from robots.skeleton import FloatArray, Skeleton

SIDES = ("left_", "right_")


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """Flesh, mass and muscle of one keypoint's body."""

    name: str
    """Keypoint, without its side."""
    mass: float
    """Percent of body mass."""
    shape: Literal["capsule", "bone", "beyond", "heel", "toes"]
    """``capsule``: given points; ``bone``: along the bone to ``toward``; ``beyond``: continues the
    bone that ends here; ``heel`` and ``toes``: the two boxes of a foot."""
    sides: bool = False
    """Whether there is a left and a right one."""
    radius: float = 0.0
    """Capsules: m."""
    start: tuple[float, ...] = ()
    """``capsule``: one end, m, rest frame (key ``from``)."""
    end: tuple[float, ...] = ()
    """``capsule``: other end, m, rest frame (key ``to``)."""
    toward: str = ""
    """``bone``: the keypoint that the bone ends in, without its side."""
    span: tuple[float, ...] = (0.0, 1.0)
    """``bone`` and ``beyond``: ends of the capsule's axis as shares of the bone."""
    behind: float = 0.0
    """``heel``: distance from ankle back to the heel, m."""
    length: float = 0.0
    """``toes``: m."""
    width: float = 0.0
    """Boxes: m."""
    thickness: float = 0.0
    """Boxes: m."""
    kp: float = 0.0
    """Stiffness of the actuator, N m / rad; 0 for the pelvis, which has none."""
    effort: float = 0.0
    """Limit of the actuator, N m."""
    joint_damping: float = 0.0
    """Passive damping of the joint, N m s / rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyPlan:
    """What all bodies share, as ``human/body.toml`` gives it."""

    stature: float
    """Stature at which the plan's lengths hold, m."""
    body_mass_index: float
    """Default weight over stature squared, kg / m2."""
    sole: float
    """Sole below the toe keypoint, m."""
    crown: float
    """Crown above the head keypoint, m."""
    gain_weight: float
    """Weight at which gains and efforts hold, kg."""
    damping_ratio: float
    """Damping of an actuator over its stiffness, s."""
    armature: float
    """Rotor inertia at every joint, kg m2."""
    segments: tuple[Segment, ...]
    """One per keypoint or pair of keypoints."""

    def segment(self, keypoint: str) -> Segment:
        """Return the segment of a keypoint, with or without its side.

        Raises:
            SpecError: There is none.
        """
        for segment in self.segments:
            if keypoint == segment.name or (segment.sides and _bare(keypoint) == segment.name):
                return segment
        raise SpecError(f"no body segment for keypoint '{keypoint}'", where="human/body.toml")


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A capsule or a box, in the frame of its body."""

    start: FloatArray
    """Capsule: one end of the axis, m. Box: the centre, m."""
    end: FloatArray
    """Capsule: other end of the axis, m. Box: half sizes, m."""
    radius: float
    """Capsule: m. Box: 0."""

    @property
    def is_box(self) -> bool:
        """Whether this is a box."""
        return self.radius == 0.0


@cache
def body_plan() -> BodyPlan:
    """Return the plan of ``robots/human/body.toml``."""
    return parse_body_plan(resources.files("robots").joinpath("human/body.toml").read_text("utf-8"))


def parse_body_plan(text: str) -> BodyPlan:
    """Return the plan that a TOML text describes.

    Raises:
        SpecError: It is not TOML, a key is unknown or missing, or a number makes no sense.
    """
    where = "human/body.toml"
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SpecError(f"not valid TOML: {error}", where=where) from error
    raw = data.pop("segment", [])
    segments = tuple(_build(Segment, _renamed(s), f"{where} [[segment]]") for s in raw)
    plan = _build(BodyPlan, {**data, "segments": segments}, where)
    total = sum(s.mass * (2 if s.sides else 1) for s in segments)
    if abs(total - 100) > 1e-6:
        raise SpecError(f"segment masses sum to {total:.4f} %", where=where, allowed="100 %")
    for segment in segments:
        _check_segment(segment, where)
    return plan


def _renamed(table: dict[str, Any]) -> dict[str, Any]:
    names = {"from": "start", "to": "end"}
    return {names.get(k, k): tuple(v) if isinstance(v, list) else v for k, v in table.items()}


def _build(kind: type, table: dict[str, Any], where: str) -> Any:
    known = {f.name for f in fields(kind)}
    for key in table:
        if key not in known:
            raise SpecError(f"unknown key '{key}'", where=where, hint=nearest(key, known))
    try:
        return kind(**table)
    except TypeError as error:
        raise SpecError(f"incomplete: {error}", where=where) from error


def _check_segment(segment: Segment, where: str) -> None:
    """Raise if a segment lacks what its shape needs."""
    needs = {
        "capsule": segment.radius > 0 and len(segment.start) == 3 and len(segment.end) == 3,
        "bone": segment.radius > 0 and bool(segment.toward) and len(segment.span) == 2,
        "beyond": segment.radius > 0 and len(segment.span) == 2,
        "heel": min(segment.behind, segment.width, segment.thickness) > 0,
        "toes": min(segment.length, segment.width, segment.thickness) > 0,
    }
    if segment.shape not in needs:
        raise SpecError(
            f"unknown shape '{segment.shape}' of segment '{segment.name}'",
            where=where,
            allowed=", ".join(needs),
        )
    if segment.mass <= 0 or not needs[segment.shape]:
        raise SpecError(f"segment '{segment.name}' lacks mass or sizes", where=where)


def _bare(keypoint: str) -> str:
    for side in SIDES:
        if keypoint.startswith(side):
            return keypoint.removeprefix(side)
    return keypoint


@dataclass(frozen=True, slots=True, eq=False)
class HumanBody:
    """One person's body: own bone lengths, stature and weight.

    Raises:
        SpecError: Stature or weight are not those of a human.
    """

    skeleton: Skeleton
    """Names, parents, rest offsets; bone lengths are this person's."""
    stature: float
    """From sole to crown, m."""
    weight: float
    """Body mass, kg."""

    def __post_init__(self) -> None:
        """Validate."""
        if not 0.5 <= self.stature <= 2.6:
            raise SpecError(f"a person of {self.stature:.2f} m", allowed="0.5 to 2.6 m")
        if not 5 <= self.weight <= 300:
            raise SpecError(f"a person of {self.weight:.1f} kg", allowed="5 to 300 kg")

    @classmethod
    def of(cls, skeleton: Skeleton, weight: float | None = None) -> HumanBody:
        """Return the body with this skeleton; stature follows from it, weight from stature.

        Stature is the height of the keypoints in the rest pose plus what flesh adds above the head
        and below the toes in proportion. Weight defaults to the plan's body mass index.
        """
        plan = body_plan()
        heights = rest_positions(skeleton)[:, 2]
        share_of_flesh = (plan.sole + plan.crown) / plan.stature
        stature = float(heights.max() - heights.min()) / (1 - share_of_flesh)
        return cls(skeleton, stature, weight or plan.body_mass_index * stature**2)

    @property
    def size(self) -> float:
        """Stature relative to the plan's."""
        return self.stature / body_plan().stature

    @property
    def strength(self) -> float:
        """Factor on the plan's gains and efforts: weight times stature, as gravity's torques."""
        return self.weight / body_plan().gain_weight * self.size

    def effort(self, keypoint: str) -> float:
        """Return the torque limit of a keypoint's actuator, N m."""
        return body_plan().segment(keypoint).effort * self.strength

    def stiffness(self, keypoint: str) -> float:
        """Return the stiffness of a keypoint's actuator, N m / rad."""
        return body_plan().segment(keypoint).kp * self.strength

    def shape(self, keypoint: str) -> Shape:
        """Return the collision shape of a keypoint's body, in that body's frame."""
        segment = body_plan().segment(keypoint)
        side = keypoint.removesuffix(segment.name)
        offset = self.skeleton.offsets
        if segment.shape == "capsule":
            start, end = np.array(segment.start) * self.size, np.array(segment.end) * self.size
        elif segment.shape in ("bone", "beyond"):
            ends_in = side + segment.toward if segment.shape == "bone" else keypoint
            bone = offset[self.skeleton.index(ends_in)]
            start, end = bone * segment.span[0], bone * segment.span[1]
        else:
            return self._foot_box(segment, side)
        return Shape(start, end, segment.radius * self.size)

    def _foot_box(self, segment: Segment, side: str) -> Shape:
        """Return one of the two boxes of a foot; both stand on the plane of the sole."""
        plan = body_plan()
        toe = self.skeleton.offsets[self.skeleton.index(f"{side}foot")]
        if segment.shape == "heel":
            back, front = -segment.behind * self.size, max(float(toe[0]), 0.02)
            bottom, across = float(toe[2]) - plan.sole * self.size, float(toe[1]) / 2
        else:
            back, front = 0.0, segment.length * self.size
            bottom, across = -plan.sole * self.size, 0.0
        half = np.array([front - back, segment.width * self.size, segment.thickness * self.size])
        half /= 2
        return Shape(np.array([(front + back) / 2, across, bottom + half[2]]), half, 0.0)

    def sole_corners(self, keypoint: str) -> FloatArray:
        """Return the lower corners ``[4, 3]`` m of a foot box, in the frame of its body."""
        box = self.shape(keypoint)
        signs = np.array([[x, y, -1.0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
        return box.start + signs * box.end


def rest_positions(skeleton: Skeleton) -> FloatArray:
    """Return the keypoints ``[J, 3]`` m of the rest pose, root at the origin."""
    points = np.zeros((len(skeleton), 3))
    for j, parent in enumerate(skeleton.parents[1:], start=1):
        points[j] = points[parent] + skeleton.offsets[j]
    return points


def add_humanoid(
    worldbody: ET.Element,
    actuators: ET.Element,
    body: HumanBody,
    *,
    prefix: str = "",
    contype: int = 1,
    conaffinity: int = 1,
) -> None:
    """Add a person to a scene, standing on the plane z = 0 at the origin in the rest pose.

    Bodies, joints, geoms, actuators and the site on the pelvis are named prefix + keypoint; the
    free joint is prefix + ``root``.

    Args:
        worldbody: MJCF element that gets the body tree.
        actuators: MJCF element that gets one ``orientation`` actuator per ball joint.
        body: Whom to add.
        prefix: Put before every name.
        contype: Contact bits of the geoms.
        conaffinity: Contact bits that the geoms accept.
    """
    plan, skeleton = body_plan(), body.skeleton
    elements: list[ET.Element] = []
    ground = rest_positions(skeleton)[:, 2].min() - plan.sole * body.size
    for j, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents, strict=True)):
        segment, full = plan.segment(name), prefix + name
        at = skeleton.offsets[j] if j else np.array([0.0, 0.0, -ground])
        element = ET.SubElement(
            elements[parent] if j else worldbody, "body", name=full, pos=_text(at)
        )
        elements.append(element)
        if j == 0:
            ET.SubElement(element, "freejoint", name=f"{prefix}root")
            ET.SubElement(element, "site", name=full)
        else:
            ET.SubElement(
                element,
                "joint",
                name=full,
                type="ball",
                damping=_text(segment.joint_damping),
                armature=_text(plan.armature),
            )
            kp = body.stiffness(name)
            ET.SubElement(
                actuators,
                "orientation",
                name=full,
                joint=full,
                kp=_text(kp),
                kv=_text(kp * plan.damping_ratio),
            )
        geom = _geom(body.shape(name))
        geom.update(name=full, mass=_text(body.weight * segment.mass / 100))
        geom.update(contype=str(contype), conaffinity=str(conaffinity))
        ET.SubElement(element, "geom", geom)


def neighbours(skeleton: Skeleton) -> list[tuple[str, str]]:
    """Return pairs of keypoints two bones apart, whose flesh overlaps in any pose.

    MuJoCo leaves out parent and child by itself.
    """
    names, parents = skeleton.names, skeleton.parents
    pairs = []
    for j in range(1, len(names)):
        up = parents[j]
        if parents[up] >= 0:
            pairs.append((names[parents[up]], names[j]))
        pairs += [(names[i], names[j]) for i in range(1, j) if parents[i] == up]
    return pairs


def humanoid_xml(body: HumanBody) -> str:
    """Return a complete MJCF model of one person and a floor.

    The joints' springs are stiff for the segments they move, so integration must be implicit.
    """
    root = ET.Element("mujoco", model="human")
    ET.SubElement(root, "compiler", angle="radian")
    ET.SubElement(root, "option", integrator="discrete", timestep="0.005", cone="elliptic")
    worldbody = ET.SubElement(root, "worldbody")
    ET.SubElement(worldbody, "geom", name="floor", type="plane", size="10 10 0.1")
    add_humanoid(worldbody, ET.SubElement(root, "actuator"), body, contype=2, conaffinity=1)
    return ET.tostring(root, encoding="unicode")


def _geom(shape: Shape) -> dict[str, str]:
    if shape.is_box:
        return {"type": "box", "pos": _text(shape.start), "size": _text(shape.end)}
    ends = np.concatenate([shape.start, shape.end])
    return {"type": "capsule", "fromto": _text(ends), "size": _text(shape.radius)}


def _text(values: FloatArray | float) -> str:
    return " ".join(repr(float(v)) for v in np.atleast_1d(values))
