"""The model one person plans with: itself, the floor, and the partner as a moving ghost.

**The problem.** Derivatives of the whole scene cost four times those of one person, and a plan for
both at once would let each count on the other's obedience. So each person plans alone. The partner
is there as 22 kinematic bodies that replay the partner's last plan: solid, so that a hand can lean
on it, and not to be pushed away.

People who bear each other's weight do push each other away, and who reckons with a wall instead
takes the own ankles to be without effect: leaning at 15 degrees, a tenth of a radian there moves
the centre of mass by 5 cm within half a second, of which a plan against a wall sees 1 cm. A ghost
that *yields* is a carriage of the partner's weight that slides along the floor; in it the 22 bodies
replay the partner's plan. The force that the partner plans to push with holds it in place, so that
it moves only by what the partner has not reckoned with.

The model is cut out of the scene's own MJCF, so that contacts, gains, self-collision and root
assist are those of the simulation.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.humanoid import HumanBody
from robots.skeleton import FloatArray
from sim.scene import PEOPLE, PERSON_BITS, PersonMap, Scene, compile_model, map_person

GHOST, CARRIAGE = "ghost/", "carriage"


@dataclass(frozen=True, slots=True, eq=False)
class PersonModel:
    """One person's planning model, with the maps between it and the scene."""

    model: Any
    """``mujoco.MjModel``: the person is all that moves, and a ghost that yields."""
    at: PersonMap
    """Where the person's numbers lie in it."""
    body: HumanBody
    """Whom it holds."""
    ghost: NDArray[np.intp]
    """``[J]`` mocap indices of the partner's bodies, in keypoint order, or body ids where the ghost
    yields; empty without a ghost."""
    yielding: int
    """Degrees of freedom of a ghost that yields, behind those of the person: 2, or 0."""
    qpos: slice
    """Where the person's ``qpos`` lies in the scene's."""
    qvel: slice
    """Where the person's ``qvel`` lies in the scene's."""
    targets: NDArray[np.intp]
    """``[3 (J-1)]`` addresses of the joint targets in this model's ``ctrl``."""

    @property
    def nv(self) -> int:
        """Degrees of freedom, with those of a ghost that yields."""
        return self.model.nv

    @property
    def nu(self) -> int:
        """Controls that are planned: three per joint."""
        return len(self.targets)

    def padded(self, values: NDArray) -> NDArray:
        """Return ``values [..., n]`` of the person with zeros behind for a ghost that yields."""
        if not self.yielding:
            return values
        return np.concatenate([values, np.zeros((*values.shape[:-1], self.yielding))], axis=-1)

    def set_ghost(self, data: Any, positions: NDArray, turns: NDArray, push: NDArray) -> None:
        """Put the ghost where the partner's bodies are.

        Args:
            data: ``mujoco.MjData`` of this model.
            positions: ``[J, 3]`` m.
            turns: ``[J, 4]`` wxyz.
            push: ``[2]`` N, level force on this person that the partner reckons with.
        """
        if self.yielding:
            # Bodies within a carriage have their places in the model, whose only user plans alone.
            self.model.body_pos[self.ghost], self.model.body_quat[self.ghost] = positions, turns
            data.qfrc_applied[-self.yielding :] = push
        else:
            data.mocap_pos[self.ghost], data.mocap_quat[self.ghost] = positions, turns

    def poses(self, qpos: NDArray) -> tuple[FloatArray, FloatArray]:
        """Return positions ``[H, J, 3]`` m and orientations ``[H, J, 4]`` wxyz of all bodies."""
        data = mujoco.MjData(self.model)
        positions = np.empty((len(qpos), len(self.at.bodies), 3))
        turns = np.empty((len(qpos), len(self.at.bodies), 4))
        for h, pose in enumerate(qpos):
            data.qpos[: len(pose)] = pose
            mujoco.mj_kinematics(self.model, data)
            positions[h] = data.xpos[self.at.bodies]
            turns[h] = data.xquat[self.at.bodies]
        return positions, turns


def person_model(scene: Scene, p: int, *, ghost: bool | Literal["yielding"] = True) -> PersonModel:
    """Return the planning model of person ``p`` (0 or 1) of a scene."""
    yields = ghost == "yielding"
    me, other = PEOPLE[p] + "/", PEOPLE[1 - p] + "/"
    root = ET.fromstring(scene.xml)  # noqa: S314 - our own text
    worldbody = _part(root, "worldbody")
    partner = [b for b in worldbody.findall("body") if b.get("name", "").startswith(other)]
    flesh = [element for tree in partner for element in tree.iter("body")]
    for tree in partner:
        worldbody.remove(tree)
    for part in (_part(root, "actuator"), _part(root, "contact")):
        for element in list(part):
            owner = element.get("name") or element.get("body1") or ""
            if owner.startswith(other):
                part.remove(element)
    if ghost:
        _add_ghost(worldbody, flesh, other, p, yields=yields)
    model = compile_model(ET.tostring(root, encoding="unicode"))
    body = scene.bodies[p]
    at, there = map_person(model, body, PEOPLE[p]), scene.maps[p]
    names = [GHOST + n for n in scene.bodies[1 - p].skeleton.names] if ghost else []
    _require_same_order(at, there, me)
    yielding = 2 if yields else 0
    places = [model.body(n).id if yields else int(model.body(n).mocapid[0]) for n in names]
    return PersonModel(
        model=model,
        at=at,
        body=body,
        ghost=np.array(places, dtype=np.intp),
        yielding=yielding,
        qpos=slice(there.root_qpos, there.root_qpos + model.nq - yielding),
        qvel=slice(there.root_dof, there.root_dof + model.nv - yielding),
        targets=at.targets.reshape(-1),
    )


def _part(root: ET.Element, tag: str) -> ET.Element:
    found = root.find(tag)
    return ET.SubElement(root, tag) if found is None else found


def _add_ghost(
    worldbody: ET.Element, flesh: list[ET.Element], other: str, p: int, *, yields: bool
) -> None:
    """Add the partner's flesh as bodies that only person ``p`` touches: mocap, or on a carriage."""
    place, kind = worldbody, {"mocap": "true"}
    if yields:
        place, kind = ET.SubElement(worldbody, "body", name=CARRIAGE), {}
        for axis in ("1 0 0", "0 1 0"):
            ET.SubElement(place, "joint", type="slide", axis=axis)
    for element in flesh:
        geom = element.find("geom")
        if geom is None:  # the frame of the root assist
            continue
        name = GHOST + element.get("name", "").removeprefix(other)
        body = ET.SubElement(place, "body", kind, name=name)
        geom.set("name", name)
        geom.set("contype", "0")  # the floor would hold a carriage
        geom.set("conaffinity", str(PERSON_BITS[p]))
        body.append(geom)


def _require_same_order(own: PersonMap, scene: PersonMap, name: str) -> None:
    """Raise if a person's numbers are not one block, in the same order, in both models."""
    shift = scene.root_qpos - own.root_qpos, scene.root_dof - own.root_dof
    if (own.quats + shift[0] != scene.quats).any() or (own.dofs + shift[1] != scene.dofs).any():
        raise RuntimeError(f"{name} lies in the scene in another order than in its own model")
