"""Servo robots as data: joints, servos, buses and landmarks, read from a folder.

A robot is a folder with ``robot.toml`` (this schema) and an MJCF file. Nothing about a robot is
code: a new one is a new folder, built in (below ``robots/``) or anywhere on disk. The format is
described in ``docs/robots.md``; reading it is :mod:`robots.registry`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from robots.errors import SpecError, nearest
from robots.servos import ServoModel, servo_model
from robots.skeleton import FloatArray

NAME = re.compile(r"[a-z0-9_]+")
"""What names of robots, joints, buses and landmarks look like."""

MODES = ("position", "extended_position", "current_based_position")
"""Operating modes that follow a goal position."""

BASES = ("free", "fixed")


def check_name(name: str, what: str, where: str) -> None:
    """Refuse names that could not be a file name, a TOML key and a column alike.

    Raises:
        SpecError: The name has other characters than ``a-z``, ``0-9`` and ``_``.
    """
    if not NAME.fullmatch(name):
        raise SpecError(
            f"{what} name '{name}' is not allowed", where=where, allowed="letters a-z, 0-9 and _"
        )


@dataclass(frozen=True, slots=True)
class BusSpec:
    """One serial line with servos on it."""

    name: str
    """As used by :attr:`ServoSpec.bus`."""
    port: str
    """Device of the adapter, for example ``/dev/ttyUSB0``; the command line may override it."""
    baud: int
    """Bits per second."""
    protocol: float = 2.0
    """Dynamixel protocol version."""

    def __post_init__(self) -> None:
        """Validate."""
        check_name(self.name, "bus", "bus")
        where = f"bus.{self.name}"
        if not 9600 <= self.baud <= 10_500_000:
            raise SpecError(f"baud {self.baud}", where=where, allowed="9600 to 10500000")
        if self.protocol not in (1.0, 2.0):
            raise SpecError(f"protocol {self.protocol}", where=where, allowed="1.0 or 2.0")


@dataclass(frozen=True, slots=True)
class ServoSpec:
    """The servo that drives a joint, and how its ticks relate to the joint's angle.

    ``tick = zero + direction * ratio * angle * ticks_per_turn / 2 pi``, in software: the servo's
    own homing offset and reverse bit stay at zero.
    """

    id: int
    """Bus id, 0 to 252."""
    model: str
    """The maker's name, for example ``XM430-W350``."""
    bus: str
    """Name of the bus it hangs on."""
    direction: int = 1
    """+1 if ticks grow with the joint angle, -1 if they fall."""
    zero: int = 2048
    """Tick at joint angle 0."""
    ratio: float = 1.0
    """Turns of the servo per turn of the joint."""
    mode: str = "position"
    """Operating mode, one of :data:`MODES`."""
    p: int | None = None
    """Position P gain, register units; ``None`` leaves the servo's own."""
    i: int | None = None
    """Position I gain, register units."""
    d: int | None = None
    """Position D gain, register units."""

    def __post_init__(self) -> None:
        """Validate."""
        where = f"servo {self.id}"
        model = servo_model(self.model, where=where)
        if not 0 <= self.id <= 252:
            raise SpecError(f"id {self.id}", where=where, allowed="0 to 252")
        if self.direction not in (-1, 1):
            raise SpecError(f"direction {self.direction}", where=where, allowed="1 or -1")
        if not model.first <= self.zero <= model.last:
            allowed = f"{model.first} to {model.last}"
            raise SpecError(f"zero {self.zero}", where=where, allowed=allowed)
        if not (math.isfinite(self.ratio) and 0.01 <= self.ratio <= 100):
            raise SpecError(f"ratio {self.ratio}", where=where, allowed="0.01 to 100")
        if self.mode not in MODES:
            raise SpecError(
                f"mode '{self.mode}'",
                where=where,
                allowed=", ".join(MODES),
                hint=nearest(self.mode, MODES),
            )
        for name in ("p", "i", "d"):
            gain = getattr(self, name)
            if gain is not None and not 0 <= gain <= 16383:
                raise SpecError(f"gain {name} = {gain}", where=where, allowed="0 to 16383")

    @property
    def hardware(self) -> ServoModel:
        """What this model can do."""
        return servo_model(self.model)

    @property
    def reach(self) -> tuple[float, float]:
        """Joint angles (lowest, highest) rad that the servo can be sent to in its mode."""
        if self.mode == "position":
            first, last = self.hardware.first, self.hardware.last
        else:  # the extended modes turn 256 times either way
            last = 256 * self.hardware.ticks - 1
            first = -last
        per_tick = 2 * math.pi / self.hardware.ticks / self.ratio * self.direction
        ends = ((first - self.zero) * per_tick, (last - self.zero) * per_tick)
        return min(ends), max(ends)


@dataclass(frozen=True, slots=True)
class JointSpec:
    """One degree of freedom and its servo."""

    name: str
    """Name of the hinge in the MJCF."""
    lower: float
    """rad."""
    upper: float
    """rad."""
    rest: float
    """rad, pose in which the robot waits and to which it returns."""
    max_velocity: float
    """rad/s, no-load speed of the joint."""
    max_effort: float
    """N m, stall torque at the joint."""
    servo: ServoSpec
    """The servo that drives it."""

    def __post_init__(self) -> None:
        """Validate."""
        check_name(self.name, "joint", "joint")
        where = f"joint.{self.name}"
        if not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise SpecError("limit is not finite", where=where)
        if not self.lower < self.upper:
            raise SpecError(f"limit {self.lower:.4g} to {self.upper:.4g} rad is empty", where=where)
        if not self.lower <= self.rest <= self.upper:
            raise SpecError(
                f"rest {self.rest:.4g} rad lies outside the limit",
                where=where,
                allowed=f"{self.lower:.4g} to {self.upper:.4g} rad",
            )
        for name in ("max_velocity", "max_effort"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise SpecError(f"{name} {value}", where=where, allowed="more than 0")
        low, high = self.servo.reach
        if self.lower < low - 1e-9 or self.upper > high + 1e-9:
            raise SpecError(
                f"limit {self.lower:.4g} to {self.upper:.4g} rad is beyond what servo"
                f" {self.servo.id} reaches",
                where=where,
                allowed=f"{low:.4g} to {high:.4g} rad",
                hint="move zero, or use mode extended_position",
            )


@dataclass(frozen=True, slots=True)
class Landmark:
    """A named point of the robot that corresponds to a point of the human."""

    name: str
    """Name of the human point (``left_hand``, ``pelvis``, ...) or ``chest``."""
    body: str
    """MuJoCo body that carries it."""
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m, in the body's frame."""
    radius: float = 0.0
    """m, how thick the robot is there: two landmarks touch at the sum of their radii."""

    def __post_init__(self) -> None:
        """Validate."""
        check_name(self.name, "landmark", "landmark")
        where = f"landmark.{self.name}"
        if len(self.pos) != 3 or not all(math.isfinite(x) and abs(x) < 10 for x in self.pos):
            raise SpecError(f"pos {list(self.pos)}", where=where, allowed="three lengths in m")
        if not 0 <= self.radius < 1:
            raise SpecError(f"radius {self.radius}", where=where, allowed="0 to 1 m")


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """A servo robot.

    Raises:
        SpecError: Names or ids are not unique, or something refers to a bus that is not there.
    """

    name: str
    """Name of the robot, ``[a-z0-9_]+``."""
    folder: Path
    """Where it was read from."""
    model: Path
    """Its MJCF file, inside :attr:`folder`."""
    base: Literal["free", "fixed"]
    """``free`` if the base moves (a walking robot), ``fixed`` if it is bolted to the stage."""
    joints: tuple[JointSpec, ...]
    """Joints in the order in which trajectories carry them."""
    buses: dict[str, BusSpec]
    """Buses by name."""
    landmarks: dict[str, Landmark]
    """Landmarks by name."""
    cycle_ms: float = 10.0
    """Time between two commands to the servos, ms."""
    title: str = ""
    """One line for people."""

    def __post_init__(self) -> None:
        """Validate."""
        check_name(self.name, "robot", "name")
        where = self.name
        if self.base not in BASES:
            raise SpecError(f"base '{self.base}'", where=where, allowed=", ".join(BASES))
        if not self.joints:
            raise SpecError("a robot needs at least one joint", where=where)
        if not (math.isfinite(self.cycle_ms) and 1 <= self.cycle_ms <= 1000):
            raise SpecError(f"cycle_ms {self.cycle_ms}", where=where, allowed="1 to 1000 ms")
        _require_unique(self.joint_names, "joint", where)
        ids: dict[tuple[str, int], str] = {}
        for joint in self.joints:
            servo = joint.servo
            if servo.bus not in self.buses:
                raise SpecError(
                    f"no bus '{servo.bus}'",
                    where=f"{where}: joint.{joint.name}",
                    allowed=", ".join(self.buses),
                    hint=nearest(servo.bus, self.buses),
                )
            other = ids.setdefault((servo.bus, servo.id), joint.name)
            if other != joint.name:
                raise SpecError(
                    f"servo id {servo.id} on bus '{servo.bus}' is also that of joint.{other}",
                    where=f"{where}: joint.{joint.name}",
                )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def lower(self) -> FloatArray:
        """``[D]`` rad, lower limits."""
        return np.array([joint.lower for joint in self.joints])

    @property
    def upper(self) -> FloatArray:
        """``[D]`` rad, upper limits."""
        return np.array([joint.upper for joint in self.joints])

    @property
    def rest(self) -> FloatArray:
        """``[D]`` rad, rest pose."""
        return np.array([joint.rest for joint in self.joints])

    @property
    def max_velocity(self) -> FloatArray:
        """``[D]`` rad/s, no-load speeds."""
        return np.array([joint.max_velocity for joint in self.joints])

    @property
    def max_effort(self) -> FloatArray:
        """``[D]`` N m, stall torques."""
        return np.array([joint.max_effort for joint in self.joints])

    def joint(self, name: str) -> JointSpec:
        """Return a joint by name.

        Raises:
            SpecError: There is no such joint.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise SpecError(
            f"{self.name} has no joint '{name}'",
            allowed=", ".join(self.joint_names),
            hint=nearest(name, self.joint_names),
        )

    def landmark(self, name: str) -> Landmark:
        """Return a landmark by name.

        Raises:
            SpecError: There is no such landmark.
        """
        try:
            return self.landmarks[name]
        except KeyError:
            raise SpecError(
                f"{self.name} has no landmark '{name}'",
                allowed=", ".join(self.landmarks),
                hint=nearest(name, self.landmarks),
            ) from None


def _require_unique(names: Iterable[str], what: str, where: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise SpecError(f"two {what}s are named '{name}'", where=where)
        seen.add(name)
