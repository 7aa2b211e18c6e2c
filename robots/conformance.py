"""What a robot folder promises beyond its schema, checked on the compiled model.

**The problem.** ``robot.toml`` and ``robot.xml`` describe one robot twice: as servos and as bodies.
Each can be valid by itself while together they are wrong: a range that differs, a landmark on a
body that was renamed, a model in degrees, a robot that hovers or starts inside itself. Nothing of
that raises when it is read; it shows on the table, as a limb that hits its stop. Each promise is
therefore one rule, and :func:`check_robot` reports every rule that is broken, not just the first.

What :class:`~robots.spec.RobotSpec` cannot hold at all (two servos of one id, a limit beyond the
servo's reach, a rest pose outside the limit) is refused by :mod:`robots.registry` before this.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robots.errors import SpecError, nearest
from robots.mjcf import load_mjspec
from robots.skeleton import FloatArray, human_skeleton
from robots.spec import RobotSpec
from robots.stance import DETECTION, compile_robot, measure_stance, posed, touches

if TYPE_CHECKING:
    import mujoco

RANGE_TOLERANCE = 1e-4
"""rad, between a limit in robot.toml and the range in the MJCF."""

FLOOR_TOLERANCE = 0.002
"""m, between the lowest points in the rest pose and the floor."""

MIRROR_TOLERANCE = 0.002
"""m, between a landmark and the mirror image of its twin, in the zero pose."""

LIMB_TOLERANCE = 0.05
"""Between a limb's direction in the zero pose and that of the T-pose, unit vectors."""

OVERLAP_TOLERANCE = 1e-4
"""m, depth of contact in the rest pose that is still rounding."""

SOLE_WIDTH = 0.002
"""m, from the middle of what carries a foot to its outline."""

BALANCE_MARGIN = 0.005
"""m, from the centre of mass, seen from above, to the edge of the soles."""

ARMED = (
    "chest",
    *(f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "hand")),
)
"""Landmarks every robot needs."""

LEGGED = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle", "foot")
)
"""Landmarks a robot on a free base needs besides."""

EXTRA_LANDMARKS = ("chest", "left_hand", "right_hand")
"""Names landmarks may have besides those of the human keypoints."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One broken promise."""

    rule: str
    """Name of the rule, one of :data:`RULES`."""
    what: str
    """What is wrong, with names and numbers."""
    hint: str = ""
    """What to do about it; empty if obvious."""

    def __str__(self) -> str:
        """Return the finding as one line."""
        return f"{self.rule}: {self.what}" + (f"; {self.hint}" if self.hint else "")


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """A robot, its model, and two of its poses."""

    robot: RobotSpec
    spec: mujoco.MjSpec
    model: Any
    zero: Any
    rest: Any

    def at(self, name: str) -> FloatArray:
        """Return where a landmark is in the zero pose, ``[3]`` m."""
        landmark = self.robot.landmarks[name]
        body = self.model.body(landmark.body).id
        return self.zero.xpos[body] + self.zero.xmat[body].reshape(3, 3) @ landmark.pos

    def placed(self, *names: str) -> bool:
        """Return whether all these landmarks are named and on bodies that exist."""
        marks = [self.robot.landmarks.get(name) for name in names]
        return all(mark is not None and _has(self.model, "body", mark.body) for mark in marks)


def check_robot(robot: RobotSpec) -> list[Finding]:
    """Return every promise that the robot breaks; an empty list if it keeps all.

    A model that MuJoCo refuses is one finding, and the rest stays unchecked.
    """
    try:
        spec = load_mjspec(robot)
        model = compile_robot(spec, robot)
    except SpecError as error:
        return [Finding("compiles", str(error))]
    zero = posed(robot, model, np.zeros(len(robot.joints)))
    body = _Body(robot, spec, model, zero, posed(robot, model, robot.rest))
    return [finding for rule in RULES.values() for finding in rule(body)]


def _names(model: Any, kind: str, count: int) -> list[str]:
    return [getattr(model, kind)(i).name for i in range(count)]


def _has(model: Any, kind: str, name: str) -> bool:
    count = {"body": model.nbody, "joint": model.njnt}[kind]
    return name in _names(model, kind, count)


def _mm(length: float) -> str:
    return f"{1000 * length:.1f} mm"


def _angles(body: _Body) -> Iterator[Finding]:
    """The MJCF says that its angles are radians."""
    if body.spec.compiler.degree:
        yield Finding(
            "radian", "the MJCF counts in degrees", 'write <compiler angle="radian"/> into it'
        )


def _joints(body: _Body) -> Iterator[Finding]:
    """Joints of robot.toml and hinges of the MJCF are the same, with the same ranges."""
    import mujoco

    model = body.model
    hinges = [
        model.joint(j).name
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
    ]
    for joint in body.robot.joints:
        if joint.name not in hinges:
            hint = nearest(joint.name, hinges)
            yield Finding("joints", f"the MJCF has no hinge '{joint.name}'", hint)
            continue
        index = model.joint(joint.name).id
        if not model.jnt_limited[index]:
            yield Finding("joints", f"hinge '{joint.name}' has no range in the MJCF")
            continue
        low, high = model.jnt_range[index]
        if max(abs(low - joint.lower), abs(high - joint.upper)) > RANGE_TOLERANCE:
            yield Finding(
                "joints",
                f"range of '{joint.name}' is {low:.6g} to {high:.6g} rad in the MJCF and"
                f" {joint.lower:.6g} to {joint.upper:.6g} rad in robot.toml",
            )
    for name in hinges:
        if name not in body.robot.joint_names:
            yield Finding("joints", f"no servo drives hinge '{name}'")
    for j in range(model.njnt):
        name, kind = model.joint(j).name, model.jnt_type[j]
        if name not in hinges and kind != mujoco.mjtJoint.mjJNT_FREE:
            what = f"joint '{name}' is neither a hinge nor a free base"
            yield Finding("joints", what)


def _base(body: _Body) -> Iterator[Finding]:
    """One body carries all others, and it is free exactly if robot.toml says so."""
    import mujoco

    model, robot = body.model, body.robot
    roots = [model.body(b).name for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    if len(roots) != 1:
        what = f"{len(roots)} bodies stand in the world: {', '.join(roots) or 'none'}"
        yield Finding("base", what, "one base must carry all of the robot, so that it can be moved")
    loose = int(np.sum(model.geom_bodyid == 0))
    if loose:
        what = f"{loose} shapes lie in the world, outside any body"
        yield Finding("base", what, "leave the floor out, and put shapes into the base")
    free = any(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if free != (robot.base == "free"):
        has = "a" if free else "no"
        yield Finding("base", f"base is '{robot.base}' but the MJCF has {has} free joint")


def _masses(body: _Body) -> Iterator[Finding]:
    """Whatever carries a landmark or a joint weighs something, and the whole can be lifted."""
    model = body.model
    for b in range(1, model.nbody):
        if model.body_subtreemass[b] <= 0 or (
            model.body_parentid[b] == 0 and model.body_mass[b] <= 0
        ):
            yield Finding("masses", f"body '{model.body(b).name}' has no mass")
    total = float(model.body_subtreemass[0])
    if not 0.05 <= total <= 100:
        yield Finding("masses", f"the robot weighs {total:.4g} kg", "masses are in kg")


def _shapes(body: _Body) -> Iterator[Finding]:
    """Every body with a landmark has a shape that can touch something."""
    model = body.model
    solid = (model.geom_contype != 0) & (model.geom_conaffinity != 0)
    for name in dict.fromkeys(mark.body for mark in body.robot.landmarks.values()):
        if _has(model, "body", name) and not solid[model.geom_bodyid == model.body(name).id].any():
            what = f"body '{name}' carries a landmark but has no shape that collides"
            yield Finding("shapes", what, "give it a simple one: collisions are found with these")


def _rest_pose(body: _Body) -> Iterator[Finding]:
    """In the rest pose no part of the robot is inside another."""
    deepest: dict[tuple[str, str], float] = {}
    for touch in touches(body.model, body.rest):
        pair = touch.bodies
        deepest[pair] = min(deepest.get(pair, 0.0), touch.distance)
    for (one, other), distance in deepest.items():
        if distance < -OVERLAP_TOLERANCE:
            yield Finding(
                "rest pose",
                f"'{one}' and '{other}' overlap by {_mm(-distance)}",
                "change rest, or exclude neighbours that overlap by construction",
            )


def _standing(body: _Body) -> Iterator[Finding]:
    """In the rest pose the robot stands on the floor, level and over its feet."""
    robot = body.robot
    try:
        stance = measure_stance(robot)
    except SpecError as error:
        yield Finding("standing", f"cannot be put on a floor: {error}")
        return
    for name, height in stance.heights.items():
        if height < -FLOOR_TOLERANCE:
            yield Finding("standing", f"'{name}' is {_mm(-height)} inside the floor at rest")
    walks = robot.base == "free"
    feet = [mark.body for name, mark in robot.landmarks.items() if name.endswith("_foot")]
    bases = [body.model.body(b).name for b in range(1, min(body.model.nbody, 2))]
    for name in dict.fromkeys(feet if walks else bases):
        height = stance.heights.get(name, np.inf)
        if height > FLOOR_TOLERANCE:
            far = _mm(height) if height < DETECTION else f"more than {_mm(DETECTION)}"
            hint = "set the height of the base in the MJCF"
            yield Finding("standing", f"'{name}' is {far} above the floor at rest", hint)
        elif stance.widths[name] < SOLE_WIDTH:
            what = f"'{name}' stands on an edge at rest, not on a level sole"
            yield Finding("standing", what)
    if walks and stance.balance < BALANCE_MARGIN:
        side = "inside" if stance.balance >= 0 else "outside"
        what = f"the centre of mass is {_mm(abs(stance.balance))} {side} the soles' outline at rest"
        yield Finding("standing", what, f"{_mm(BALANCE_MARGIN)} inside, or it tips over")


def _landmarks(body: _Body) -> Iterator[Finding]:
    """Landmarks are named after human points, complete, and on bodies that exist."""
    robot, model = body.robot, body.model
    known = (*human_skeleton(), *EXTRA_LANDMARKS)
    bodies = _names(model, "body", model.nbody)
    for name, mark in robot.landmarks.items():
        if name not in known:
            what = f"'{name}' is no point of a human"
            yield Finding("landmarks", what, nearest(name, known))
        if mark.body not in bodies[1:]:
            what = f"'{name}' is on body '{mark.body}', which the MJCF does not have"
            yield Finding("landmarks", what, nearest(mark.body, bodies[1:]))
    for name in ARMED + (LEGGED if robot.base == "free" else ()):
        if name not in robot.landmarks:
            yield Finding("landmarks", f"'{name}' is missing")


def _symmetry(body: _Body) -> Iterator[Finding]:
    """In the zero pose left and right landmarks mirror each other."""
    for name, mark in body.robot.landmarks.items():
        if name.startswith("right_"):
            continue
        twin = name.replace("left_", "right_")
        if not body.placed(name, twin):
            continue
        mirrored = body.at(twin) * (1, -1, 1)
        apart = float(np.linalg.norm(body.at(name) - mirrored))
        if apart > MIRROR_TOLERANCE:
            other = f"the mirror image of '{twin}'" if twin != name else "its own mirror image"
            yield Finding("symmetry", f"'{name}' is {_mm(apart)} from {other} in the zero pose")
        if abs(mark.radius - body.robot.landmarks[twin].radius) > MIRROR_TOLERANCE:
            yield Finding("symmetry", f"'{name}' and '{twin}' have different radii")


def _t_pose(body: _Body) -> Iterator[Finding]:
    """In the zero pose arms are stretched sideways, legs hang straight and the head is on top."""
    limbs = [("chest", "head", (0, 0, 1))]
    for side, out in (("left", 1), ("right", -1)):
        arm, leg = (0, out, 0), (0, 0, -1)
        limbs += [
            (f"{side}_shoulder", f"{side}_elbow", arm),
            (f"{side}_elbow", f"{side}_hand", arm),
            (f"{side}_hip", f"{side}_knee", leg),
            (f"{side}_knee", f"{side}_ankle", leg),
        ]
        if body.placed(f"{side}_ankle", f"{side}_foot"):
            ahead = body.at(f"{side}_foot") - body.at(f"{side}_ankle")
            if ahead[0] <= 0:
                yield Finding("t-pose", f"the {side} foot does not point along +x at zero")
    for start, end, direction in limbs:
        if not body.placed(start, end):
            continue
        bone = body.at(end) - body.at(start)
        length = float(np.linalg.norm(bone))
        tolerance = LIMB_TOLERANCE if end != "head" else 0.5
        if length == 0 or np.linalg.norm(bone / length - direction) > tolerance:
            axis = "xyz"[int(np.flatnonzero(direction)[0])]
            sign = "+" if sum(direction) > 0 else "-"
            what = f"'{start}' to '{end}' does not point along {sign}{axis} in the zero pose"
            yield Finding("t-pose", what)


def _pair(body: _Body) -> Iterator[Finding]:
    """Two copies fit one scene as a/ and b/, and stay what they are in it."""
    import mujoco

    scene = mujoco.MjSpec()
    scene.compiler.degree = False
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            for prefix in ("a/", "b/"):
                child = load_mjspec(body.robot)
                child.option.timestep = scene.option.timestep  # the scene's own affair
                child.option.integrator = scene.option.integrator
                for key in list(child.keys):
                    child.delete(key)
                scene.attach(child, prefix=prefix, frame=scene.worldbody.add_frame())
            both = scene.compile()
    except (SpecError, ValueError, RuntimeError) as error:
        yield Finding("pair", f"two copies do not fit one scene: {' '.join(str(error).split())}")
        return
    for text in dict.fromkeys(" ".join(str(warning.message).split()) for warning in warned):
        hint = "leave <option> and <size> to the scene"
        yield Finding("pair", f"a scene of two drops what the MJCF sets: {text}", hint)
    for joint in body.robot.joints:
        if not _has(body.model, "joint", joint.name):
            continue
        alone = body.model.jnt_range[body.model.joint(joint.name).id]
        for prefix in ("a/", "b/"):
            there = both.jnt_range[both.joint(prefix + joint.name).id]
            if np.abs(alone - there).max() > RANGE_TOLERANCE:
                yield Finding("pair", f"'{joint.name}' has another range in a scene of two")


RULES: dict[str, Callable[[_Body], Iterator[Finding]]] = {
    "radian": _angles,
    "joints": _joints,
    "base": _base,
    "masses": _masses,
    "shapes": _shapes,
    "rest pose": _rest_pose,
    "standing": _standing,
    "landmarks": _landmarks,
    "symmetry": _symmetry,
    "t-pose": _t_pose,
    "pair": _pair,
}
"""Rules by name; before them all comes ``compiles``."""
