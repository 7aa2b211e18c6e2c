"""Two people and a floor as one MuJoCo model, with the maps between its arrays and our names.

Contact bits: the floor meets both people, the people meet each other; a person meets itself only
with ``self_collision``. Contacts are soft at first touch (``solimp`` starts at 0), so that the
force grows from zero with depth and neither integration nor derivatives see a jump; the price is a
few millimetres of sinking.

The root assist is part of the model: six ``position`` actuators between each pelvis and its
reference, three translational in the world frame and three rotational in the frame of a mocap body
that turns with the reference. Being actuators, they are integrated implicitly (an external force of
the same stiffness is unstable at these time steps), ``forcerange`` bounds them, and the wrench they
gave is read from ``actuator_force``.
"""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from generator.kinematics import forward_kinematics
from robots.errors import SpecError
from robots.humanoid import HumanBody, add_humanoid, neighbours
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

PEOPLE = ("a", "b")
GRAVITY = 9.81
"""m/s2"""

FLOOR_BIT, PERSON_BITS, OWN_BITS = 1, (2, 4), (8, 16)
"""Contact bits of the floor, of persons a and b, and of their self-collision."""

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_OWN_TAGS = frozenset(
    (
        *("mujoco", "compiler", "option", "flag", "size", "default", "worldbody", "contact"),
        *("body", "freejoint", "joint", "geom", "site", "exclude"),
        *("actuator", "orientation", "position"),
    )
)
_HIDDEN = "4"
"""Geom and site group that pictures leave out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AssistLimits:
    """Strength of the hand that helps each pelvis along its reference."""

    max_force: float = 0.5
    """Bound per axis, in body weights; 0 leaves the people on their own feet."""
    max_torque: float = 0.15
    """Bound per axis, in body weight times stature."""
    frequency: float = 10.0
    """Natural frequency of the spring on the whole body, rad/s; critically damped."""

    def __post_init__(self) -> None:
        """Validate."""
        for name in ("max_force", "max_torque"):
            value = getattr(self, name)
            if not 0 <= value <= 10:
                raise SpecError(f"{value} body weights", where=f"assist.{name}", allowed="0 to 10")
        if not 0.1 <= self.frequency <= 30:
            raise SpecError(
                f"{self.frequency} rad/s", where="assist.frequency", allowed="0.1 to 30 rad/s"
            )


@dataclass(frozen=True, slots=True, eq=False)
class PersonMap:
    """Where one person's numbers lie in the arrays of the model."""

    bodies: NDArray[np.intp]
    """``[J]`` body ids, in keypoint order."""
    geoms: NDArray[np.intp]
    """``[J]`` geom ids, in keypoint order."""
    root_qpos: int
    """Address of the root position (3) in ``qpos``."""
    quats: NDArray[np.intp]
    """``[J, 4]`` addresses of the rotations in ``qpos``."""
    root_dof: int
    """Address of the root's linear velocity (3) in ``qvel``."""
    dofs: NDArray[np.intp]
    """``[J, 3]`` addresses of the angular velocities in ``qvel``."""
    targets: NDArray[np.intp]
    """``[J-1, 3]`` addresses of the joint targets in ``ctrl`` and ``actuator_force``."""
    assist: NDArray[np.intp]
    """``[6]`` addresses of the root assist in ``ctrl`` and ``actuator_force``; empty without."""
    mocap: int
    """Index of the assist's frame in ``mocap_quat``; -1 without."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The compiled model of two people, and its maps."""

    model: Any
    """``mujoco.MjModel``."""
    xml: str
    """MJCF that it was compiled from."""
    bodies: tuple[HumanBody, HumanBody]
    """Whom it holds."""
    maps: tuple[PersonMap, PersonMap]
    """Per person."""

    def qpos(self, root: NDArray, rotations: NDArray) -> FloatArray:
        """Return ``qpos [T, nq]`` of poses.

        Args:
            root: ``[T, 2, 3]`` m, world positions of the pelvis keypoints.
            rotations: ``[T, 2, J, 4]`` wxyz, root to world and others local.
        """
        out = np.zeros((len(root), self.model.nq))
        for p, at in enumerate(self.maps):
            out[:, at.root_qpos : at.root_qpos + 3] = root[:, p]
            out[:, at.quats] = rotations[:, p]
        return out

    def poses(self, qpos: NDArray) -> tuple[FloatArray, FloatArray]:
        """Return ``root [T, 2, 3]`` and ``rotations [T, 2, J, 4]`` of ``qpos [T, nq]``."""
        root = np.stack([qpos[:, m.root_qpos : m.root_qpos + 3] for m in self.maps], axis=1)
        return root, np.stack([qpos[:, m.quats] for m in self.maps], axis=1)

    def keypoints(self, qpos: NDArray) -> FloatArray:
        """Return the keypoints ``[T, 2, J, 3]`` m of ``qpos [T, nq]``."""
        root, rotations = self.poses(qpos)
        people = [
            forward_kinematics(body.skeleton, root[:, p], rotations[:, p])
            for p, body in enumerate(self.bodies)
        ]
        return np.stack(people, axis=1)


def build_scene(
    bodies: tuple[HumanBody, HumanBody],
    *,
    timestep: float = 1 / 120,
    assist: AssistLimits | None = None,
    self_collision: bool = False,
) -> Scene:
    """Return the scene of two people.

    Args:
        bodies: Persons a and b.
        timestep: Of the integration, s.
        assist: Strength of the root assist; ``None`` builds the scene without one.
        self_collision: Whether a person's limbs collide with its own others.

    Raises:
        SpecError: MuJoCo refuses the model.
    """
    root, worldbody, actuators, contact = empty_scene(timestep)
    for p, (person, body) in enumerate(zip(PEOPLE, bodies, strict=True)):
        own = OWN_BITS[p] if self_collision else 0
        add_humanoid(
            worldbody,
            actuators,
            body,
            prefix=f"{person}/",
            contype=PERSON_BITS[p] | own,
            conaffinity=FLOOR_BIT | PERSON_BITS[1 - p] | own,
        )
        if self_collision:
            for one, other in neighbours(body.skeleton):
                names = {"body1": f"{person}/{one}", "body2": f"{person}/{other}"}
                ET.SubElement(contact, "exclude", names)
    if assist is not None:
        for person, body in zip(PEOPLE, bodies, strict=True):
            add_assist(worldbody, actuators, person, body, assist)
    for site in root.iter("site"):
        site.set("group", _HIDDEN)
    return _compiled(ET.tostring(root, encoding="unicode"), bodies)


def load_scene(xml: str, bodies: tuple[HumanBody, HumanBody]) -> Scene:
    """Return the scene of an MJCF text that came out of a file.

    MuJoCo opens whatever file an ``<include>`` or an asset names, so a text with any other element
    than those that :func:`build_scene` writes is refused.

    Raises:
        SpecError: The text is not a scene that :func:`build_scene` made for these bodies.
    """
    if "<!" in xml or "<?" in xml:
        raise SpecError("the scene contains XML declarations, which are not read")
    try:
        tags = {element.tag for element in ET.fromstring(xml).iter()}  # noqa: S314 - no DTD here
    except ET.ParseError as error:
        raise SpecError(f"the scene is not XML: {error}") from error
    if not tags <= _OWN_TAGS:
        raise SpecError(
            f"the scene contains <{min(tags - _OWN_TAGS)}>", allowed=", ".join(sorted(_OWN_TAGS))
        )
    try:
        return _compiled(xml, bodies)
    except KeyError as error:
        raise SpecError(f"the scene lacks a part: {error}") from error


def _compiled(xml: str, bodies: tuple[HumanBody, HumanBody]) -> Scene:
    model = compile_model(xml)
    a, b = (map_person(model, body, person) for body, person in zip(bodies, PEOPLE, strict=True))
    return Scene(model, xml, bodies, (a, b))


def compile_model(xml: str) -> Any:
    """Return the ``mujoco.MjModel`` of an MJCF text.

    Raises:
        SpecError: MuJoCo refuses it.
    """
    try:
        return mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        raise SpecError(f"MuJoCo refuses the scene: {error}") from error


def map_person(model: Any, body: HumanBody, person: str) -> PersonMap:
    """Return where a person's numbers lie in a model's arrays."""
    names = [f"{person}/{n}" for n in body.skeleton.names]
    root = model.joint(f"{person}/root")
    joints = [model.joint(n) for n in names[1:]]
    quats = [int(root.qposadr[0]) + 3, *(int(j.qposadr[0]) for j in joints)]
    dofs = [int(root.dofadr[0]) + 3, *(int(j.dofadr[0]) for j in joints)]
    targets = [_control(model, n) for n in names[1:]]
    with_assist = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"{person}/assist") >= 0
    assist = [_control(model, f"{person}/assist/{x}") for x in _AXES] if with_assist else []
    return PersonMap(
        bodies=np.array([model.body(n).id for n in names]),
        geoms=np.array([model.geom(n).id for n in names]),
        root_qpos=int(root.qposadr[0]),
        quats=np.array(quats)[:, None] + np.arange(4),
        root_dof=int(root.dofadr[0]),
        dofs=np.array(dofs)[:, None] + np.arange(3),
        targets=np.array(targets)[:, None] + np.arange(3),
        assist=np.array(assist, dtype=np.intp),
        mocap=int(model.body(f"{person}/assist").mocapid[0]) if with_assist else -1,
    )


def _control(model: Any, actuator: str) -> int:
    return int(model.actuator_ctrladr[model.actuator(actuator).id])


def empty_scene(timestep: float) -> tuple[ET.Element, ET.Element, ET.Element, ET.Element]:
    """Return MJCF with options, contact parameters and the floor, and nobody on it.

    Returns:
        The ``mujoco``, ``worldbody``, ``actuator`` and ``contact`` elements.
    """
    root = ET.Element("mujoco", model="duet")
    ET.SubElement(root, "compiler", angle="radian")
    option = ET.SubElement(
        root,
        "option",
        timestep=repr(timestep),
        gravity=f"0 0 {-GRAVITY}",
        integrator="discrete",
        cone="elliptic",
        impratio="1",
        iterations="30",
        tolerance="1e-10",
    )
    # A silent reset on NaN would pass for a motion; the tracker looks for NaN itself.
    ET.SubElement(option, "flag", autoreset="disable")
    ET.SubElement(root, "size", memory="32M")
    default = ET.SubElement(root, "default")
    ET.SubElement(
        default,
        "geom",
        friction="1 0.005 0.0001",
        condim="3",
        solref="0.01 1",
        solimp="0 0.95 0.007 0.5 2",
    )
    worldbody, actuators = ET.SubElement(root, "worldbody"), ET.SubElement(root, "actuator")
    contact = ET.SubElement(root, "contact")
    ET.SubElement(
        worldbody,
        "geom",
        name="floor",
        type="plane",
        size="20 20 0.1",
        contype=str(FLOOR_BIT),
        conaffinity=str(PERSON_BITS[0] | PERSON_BITS[1]),
    )
    ET.SubElement(worldbody, "site", name="world", group=_HIDDEN)
    return root, worldbody, actuators, contact


def add_assist(
    worldbody: ET.Element,
    actuators: ET.Element,
    person: str,
    body: HumanBody,
    limits: AssistLimits,
) -> None:
    """Add the six actuators that help one pelvis along its reference."""
    frame = ET.SubElement(worldbody, "body", name=f"{person}/assist", mocap="true")
    ET.SubElement(frame, "site", name=f"{person}/assist")
    # Radius of gyration of a standing person about the pelvis, about 0.25 of stature.
    inertia = body.weight * (0.25 * body.stature) ** 2
    for i, axis in enumerate(_AXES):
        turning = i >= 3
        mass = inertia if turning else body.weight
        weight = body.weight * GRAVITY
        bound = weight * body.stature * limits.max_torque if turning else weight * limits.max_force
        attributes = {
            "name": f"{person}/assist/{axis}",
            "site": f"{person}/pelvis",
            "refsite": f"{person}/assist" if turning else "world",
            "gear": " ".join("1" if k == i else "0" for k in range(6)),
            "kp": repr(mass * limits.frequency**2),
            "kv": repr(2 * mass * limits.frequency),
        }
        if bound > 0:
            attributes["forcerange"] = f"{-bound!r} {bound!r}"
        else:
            attributes["kp"] = attributes["kv"] = "0"
        ET.SubElement(actuators, "position", attributes)
