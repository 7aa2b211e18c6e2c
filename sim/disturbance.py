"""What goes otherwise than the controller believes: pushes, loads, a slippery floor, slow nerves.

The controller plans with the people as the scene has them. Only the model that is simulated is
changed, so that a run tells how much error the controller bears.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from robots.errors import SpecError, nearest
from robots.skeleton import human_skeleton
from sim.scene import PEOPLE

CHEST = "spine3"
"""Body that a push meets if none is named."""
PUSH_FORM = "PERSON X Y Z at SECONDS for SECONDS [on BODY], such as 'a 100 0 0 at 1.0 for 0.2'"
PAYLOAD_FORM = "PERSON BODY KILOGRAMS, such as 'a right_wrist 2'"


@dataclass(frozen=True, slots=True, kw_only=True)
class Push:
    """A constant force at the centre of mass of a body, for a while.

    Raises:
        SpecError: Nobody has that body, or a number makes no sense.
    """

    person: str
    """Who is pushed, ``a`` or ``b``."""
    force: tuple[float, float, float]
    """N, world."""
    start: float
    """s."""
    duration: float
    """s."""
    body: str = CHEST
    """Keypoint of the body that is pushed."""

    def __post_init__(self) -> None:
        """Validate."""
        _require_body(self.person, self.body, "push")
        if len(self.force) != 3:
            raise SpecError(f"a force of {len(self.force)} numbers", where="push", allowed="3")
        for value in self.force:
            _require_range(value, "push.force", -5000, 5000, "N")
        _require_range(self.start, "push.start", 0, 3600, "s")
        _require_range(self.duration, "push.duration", 0.001, 10, "s")

    def share(self, start: float, duration: float) -> float:
        """Return for which share of a span of time the push lasts, 0 to 1.

        The force of a step is scaled by this, so that the impulse is right at any step length.
        """
        end = min(self.start + self.duration, start + duration)
        return max(end - max(self.start, start), 0.0) / duration


@dataclass(frozen=True, slots=True, kw_only=True)
class Payload:
    """A point mass at the centre of mass of a body.

    Raises:
        SpecError: Nobody has that body, or nobody could carry that mass.
    """

    person: str
    """Who carries it, ``a`` or ``b``."""
    body: str
    """Keypoint of the body that carries it; ``right_wrist`` is the right hand."""
    mass: float
    """kg."""

    def __post_init__(self) -> None:
        """Validate."""
        _require_body(self.person, self.body, "payload")
        _require_range(self.mass, "payload.mass", 0, 100, "kg")


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """All that goes otherwise in one run.

    Raises:
        SpecError: A number makes no sense.
    """

    pushes: tuple[Push, ...] = ()
    payloads: tuple[Payload, ...] = ()
    friction: float | None = None
    """Sliding friction coefficient of the floor and the people; ``None`` keeps the scene's."""
    latency: float = 0.0
    """Delay between a joint's target and its actuator, s; rounded to whole ticks of control."""
    mass_error: float = 0.0
    """Fraction by which both people are heavier, everywhere, than the controller believes."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.friction is not None:
            _require_range(self.friction, "friction", 0.05, 3, "")
        _require_range(self.latency, "latency", 0, 0.5, "s")
        _require_range(self.mass_error, "mass_error", -0.5, 1, "")

    def ticks_late(self, rate: float) -> int:
        """Return the latency in whole ticks of control.

        Args:
            rate: Ticks per second.
        """
        return round(self.latency * rate)

    def applied_to(self, model: Any) -> Any:
        """Return the ``mujoco.MjModel`` to simulate: the given one, or a changed copy."""
        if not self.payloads and self.friction is None and self.mass_error == 0:
            return model
        model = copy(model)
        for person in PEOPLE if self.mass_error else ():
            for body in range(model.nbody):
                if model.body(body).name.startswith(f"{person}/"):
                    model.body_mass[body] *= 1 + self.mass_error
                    model.body_inertia[body] *= 1 + self.mass_error
        for payload in self.payloads:
            model.body_mass[model.body(f"{payload.person}/{payload.body}").id] += payload.mass
        if self.friction is not None:
            model.geom_friction[:, 0] = self.friction
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def push(self, data: Any, start: float, duration: float) -> None:
        """Set the external forces for one step of a simulated model.

        Args:
            data: ``mujoco.MjData``, whose ``xfrc_applied`` is set.
            start: Time at the start of the step, s.
            duration: Length of the step, s.
        """
        if not self.pushes:
            return
        data.xfrc_applied[:] = 0.0
        for push in self.pushes:
            body = data.body(f"{push.person}/{push.body}").id
            data.xfrc_applied[body, :3] += np.multiply(push.force, push.share(start, duration))


def parse_push(text: str) -> Push:
    """Return the push that a text such as ``a 100 0 0 at 1.0 for 0.2 on spine3`` describes.

    Person, force in N (world), start and duration in s; the body is the chest if not named.

    Raises:
        SpecError: The text is not of that form, or says what cannot be.
    """
    words = text.split()
    form = [*("at", "for"), *(["on"] if len(words) > 8 else [])]
    if len(words) not in (8, 10) or words[4::2] != form:
        raise SpecError(f"'{text}' is no push", where="push", allowed=PUSH_FORM)
    x, y, z, start, duration = (_number(words[i], "push", PUSH_FORM) for i in (1, 2, 3, 5, 7))
    return Push(
        person=words[0],
        force=(x, y, z),
        start=start,
        duration=duration,
        body=words[9] if len(words) > 8 else CHEST,
    )


def parse_payload(text: str) -> Payload:
    """Return the payload that a text such as ``a right_wrist 2`` describes: who, where, kg.

    Raises:
        SpecError: The text is not of that form, or says what cannot be.
    """
    words = text.split()
    if len(words) != 3:
        raise SpecError(f"'{text}' is no payload", where="payload", allowed=PAYLOAD_FORM)
    mass = _number(words[2], "payload", PAYLOAD_FORM)
    return Payload(person=words[0], body=words[1], mass=mass)


def _number(word: str, where: str, form: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise SpecError(f"'{word}' is no number", where=where, allowed=form) from None


def _require_body(person: str, body: str, where: str) -> None:
    if person not in PEOPLE:
        raise SpecError(f"no person '{person}'", where=where, allowed=" or ".join(PEOPLE))
    names = human_skeleton().names
    if body not in names:
        raise SpecError(
            f"no body '{body}'", where=where, allowed=", ".join(names), hint=nearest(body, names)
        )


def _require_range(value: float, where: str, least: float, most: float, unit: str) -> None:
    if not (math.isfinite(value) and least <= value <= most):
        raise SpecError(
            f"{value:g} {unit}".strip(),
            where=where,
            allowed=f"{least:g} to {most:g} {unit}".strip(),
        )


NONE = Disturbance()
"""Everything goes as the controller believes."""
