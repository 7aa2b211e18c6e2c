"""The stage on which an interaction is written: a clock cut into phases, two roles, touches.

An interaction is a function of a :class:`Stage`. It says what happens in which phase; the stage
knows the style, draws the chance, and turns *touches* into reaches of both hands and into labels.
The function may run several times with the same seed and another :attr:`Stage.near`, because how
near people stand is solved from what their arms reach (:mod:`generator.choreographer.spacing`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from generator.choreographer.curves import drift, oscillation, rise, window
from generator.choreographer.role import ELBOW_DOWN, Build, Meeting, Role, Spot
from generator.choreographer.style import Side, Style
from generator.motion import Contact
from robots.skeleton import FloatArray

FPS = 30.0
CALM = 0.35
"""Time before the first and after the last phase in which people just stand, s."""
TOP_SPEED = 1.15
"""Fastest walking, m/s."""
PALM_TO_PALM = 0.06
"""Distance between the middle knuckles of two hands that touch, m: two hands 6 cm thick."""


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of time, s."""

    start: float
    end: float

    @property
    def length(self) -> float:
        """Duration, s."""
        return self.end - self.start

    def at(self, share: float) -> float:
        """Return the moment at a share 0..1 of the span, s."""
        return self.start + share * self.length


@dataclass(frozen=True, slots=True)
class Phases:
    """The six phases of an interaction, one after another; a phase may be empty."""

    approach: Span
    """People come within reach."""
    prepare: Span
    """Hands travel, weight shifts."""
    contact: Span
    """The touch begins, or the gesture proper."""
    hold: Span
    """It goes on, in its rhythm."""
    release: Span
    """Hands part."""
    depart: Span
    """People come to rest or step away."""

    @property
    def touch(self) -> Span:
        """Contact and hold together."""
        return Span(self.contact.start, self.hold.end)

    @property
    def end(self) -> float:
        """End of the performance, s."""
        return self.depart.end


class Stage:
    """Two roles in front of each other on a clock.

    Attributes:
        style: Manner of the performance.
        rng: Source of chance; the same draws in the same order for each run of one seed.
        near: Distance between the two pelvises when together, m.
        wait: Time that the first phase is put off, s.
        until: The clock goes on at least so long, s.
        first: Leading role; starts on the -x side, facing +x.
        second: Answering role.
        touches: Labels, with points of the first role under ``a``.
    """

    def __init__(
        self,
        builds: tuple[Build, Build],
        style: Style,
        rng: np.random.Generator,
        near: float,
        *,
        wait: float = 0.0,
        until: float = 0.0,
    ) -> None:
        """Prepare a stage; roles exist once the clock is set by :meth:`phases`."""
        self.builds, self.style, self.rng, self.near = builds, style, rng, near
        self.wait, self.until = wait, until
        self.scale = 0.5 * (builds[0].scale + builds[1].scale)
        self.touches: list[Contact] = []
        self.times: FloatArray = np.zeros(0)
        self.first: Role
        self.second: Role

    def phases(
        self,
        *,
        approach: float = 0.0,
        prepare: float = 0.0,
        contact: float = 0.0,
        hold: float = 0.0,
        release: float = 0.0,
        depart: float = 0.0,
        restless: float = 0.0,
    ) -> Phases:
        """Set the clock from durations in seconds at ordinary tempo, varied by chance by 8 %.

        A short time of standing goes before and after. ``restless`` is how far the weight wanders
        from foot to foot, m at 1.70 m; who is restless also looks away now and then.
        """
        moment, spans = CALM + self.wait, []
        for seconds in (approach, prepare, contact, hold, release, depart):
            length = seconds * self.rng.uniform(0.92, 1.08) / self.style.speed
            spans.append(Span(moment, moment + length))
            moment += length
        end = max(moment + CALM, self.until)
        self.times = np.arange(round(end * FPS) + 1) / FPS
        self.first, self.second = (Role(build, self.times) for build in self.builds)
        for role in self.people:
            self._liven(role)
            if restless:
                self._fidget(role, restless)
        return Phases(*spans)

    @property
    def people(self) -> tuple[Role, Role]:
        """``(first, second)``."""
        return (self.first, self.second)

    def answer(self, seconds: float = 0.0) -> float:
        """Return the delay of the second role, s: its own, plus the style's, at the tempo."""
        return (seconds + self.style.lag) / self.style.speed

    def pick(self, low: float, high: float) -> float:
        """Return a random number between two."""
        return float(self.rng.uniform(low, high))

    def _liven(self, role: Role) -> None:
        """Give a role what living bodies do: sway, breath, small asymmetries."""
        times, rng, scale = self.times, self.rng, role.build.scale
        role.first_step = "left" if rng.random() < 0.5 else "right"
        role.stance *= rng.uniform(0.95, 1.15)
        role.arm_swing = float(rng.uniform(0.8, 1.15)) * (0.6 + 0.4 * self.style.energy)
        role.lean += rng.normal(0.03, 0.01) + drift(times, rng, 0.006)
        breath = rng.uniform(0.22, 0.3), rng.uniform(0, 2 * np.pi)
        role.lean -= 0.006 * np.sin(2 * np.pi * breath[0] * times + breath[1])
        role.tilt += drift(times, rng, 0.008)
        role.twist += drift(times, rng, 0.012)
        role.heading += drift(times, rng, 0.008, (0.05, 0.2))
        role.crouch += (0.003 + np.abs(drift(times, rng, 0.002))) * scale

    def _fidget(self, role: Role, restless: float) -> None:
        """Let the weight wander from foot to foot, and the eyes wander off for a moment."""
        times, rng = self.times, self.rng
        wander = drift(times, rng, restless, (0.08, 0.22))
        role.shift[:, 1] += np.clip(wander, -2.0 * restless, 2.0 * restless)
        role.tilt -= 1.2 * role.shift[:, 1]
        role.nod += drift(times, rng, 0.02, (0.1, 0.4))
        away = rng.uniform(0.6, float(times[-1]))
        role.gaze -= rng.uniform(0.2, 0.5) * window(times, away, away + 0.4, away + 0.6, away + 1.0)

    def face_to_face(self, arrive: float, travel: tuple[float, float] = (0.3, 0.7)) -> None:
        """Let both walk from afar to within :attr:`near` of each other along x.

        Args:
            arrive: Moment both are there, s.
            travel: Range from which each one's walk is drawn, m.
        """
        longest = TOP_SPEED * (arrive - CALM) / 1.875
        come = 1.0 - rise(self.times, CALM, arrive)
        for role, sign in zip(self.people, (-1.0, 1.0), strict=True):
            walk = min(self.pick(*travel), longest) * come
            role.path[:, 0] += sign * (0.5 * self.near + walk)
            role.path[:, 1] += sign * 0.04 * self.rng.normal() * come
        self.second.heading += np.pi

    def step_back(self, span: Span, far: float = 0.3) -> None:
        """Let both step back from each other."""
        go = rise(self.times, span.start, max(span.at(0.75), span.start + 0.8))
        for role in self.people:
            away = min(self.pick(0.5 * far, far), 0.5 * span.length / 1.875)
            role.path -= away * go[:, None] * _forward(role)

    def couple(self, centre: NDArray, angle: NDArray, aside: float = 0.0) -> None:
        """Let both face each other across a centre that travels and turns.

        Args:
            centre: ``[T, 2]`` m.
            angle: ``[T]`` rad, direction from the first role to the second.
            aside: How far each stands to the own left of the common line, m at 1.70 m.
        """
        ahead = np.column_stack([np.cos(angle), np.sin(angle)])
        left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
        for role, sign in zip(self.people, (-1.0, 1.0), strict=True):
            role.path += centre + sign * (0.5 * self.near * ahead - aside * self.scale * left)
            role.heading += angle + (np.pi if sign > 0 else 0.0)

    def meet(
        self,
        sides: tuple[Side, Side],
        *,
        on: Span,
        start: float,
        end: float,
        height: float,
        apart: ArrayLike,
        shift: NDArray | None = None,
        elbow: ArrayLike = ELBOW_DOWN,
    ) -> None:
        """Let two hands touch, and label it.

        Args:
            sides: Hand of the first role, hand of the second.
            on: Time of the touch.
            start: Hands leave, s.
            end: Hands are back, s.
            height: Above the mean height of the shoulders, m at 1.70 m.
            apart: ``[3]``, direction along, left, up from the first hand to the second; its length
                is the labelled gap, m.
            shift: ``[T, 3]`` m along, left, up: how the place of the touch moves.
            elbow: Where elbows point: forward, outward, up.
        """
        gap = np.asarray(apart, dtype=float)
        moved = np.zeros((len(self.times), 3)) if shift is None else shift
        meeting = Meeting(sides, height, moved, gap, (on.start, on.end))
        weight = window(self.times, start, on.start, on.end, end)
        for role, side in zip(self.people, sides, strict=True):
            role.reach(side, meeting, weight, elbow=elbow, exact=(on.start, on.end))
        self.label(f"{sides[0]}_hand", f"{sides[1]}_hand", on, float(np.linalg.norm(gap)))

    def lay_on(
        self,
        role: Role,
        side: Side,
        point: str,
        offset: ArrayLike,
        *,
        on: Span,
        start: float,
        end: float,
        elbow: ArrayLike = ELBOW_DOWN,
    ) -> None:
        """Let a hand lie on the partner's body, and label it.

        Args:
            role: Whose hand.
            side: Which hand.
            point: Keypoint of the partner.
            offset: ``[3]`` m from it, forward, left, up in the partner's own frame; or
                ``[T, 3]`` of constant length, for a hand that moves over the place.
            on: Time of the touch.
            start: Hand leaves, s.
            end: Hand is back, s.
            elbow: Where the elbow points: forward, outward, up.
        """
        away = np.asarray(offset, dtype=float)
        weight = window(self.times, start, on.start, on.end, end)
        spot = Spot("partner", away, point)
        role.reach(side, spot, weight, elbow=elbow, exact=(on.start, on.end))
        partner = self.second if role is self.first else self.first
        radius = np.linalg.norm(away) if away.ndim == 1 else np.linalg.norm(away, axis=1).mean()
        gap = float(radius) * partner.build.scale
        hand = f"{side}_hand"
        names = (hand, point) if role is self.first else (point, hand)
        self.label(*names, on, gap)

    def label(self, first: str, second: str, on: Span, gap: float) -> None:
        """Say that two points touch, without moving anything."""
        end = min(on.end, float(self.times[-1]))
        self.touches.append(Contact(first, second, float(on.start), float(end), float(gap)))

    def rhythm(self, on: Span, hertz: float, size: float) -> FloatArray:
        """Return a swing ``[T]`` of the given size about 0 within a span, at the style's tempo."""
        hertz *= self.style.speed * (0.8 + 0.2 * self.style.energy)
        return size * self.style.amplitude * oscillation(self.times, on.start, on.end, hertz)


def _forward(role: Role) -> FloatArray:
    return np.column_stack([np.cos(role.heading), np.sin(role.heading)])
