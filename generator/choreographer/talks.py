"""Talking: a chat, a quarrel, a whisper, a tap on the shoulder."""

from __future__ import annotations

import numpy as np

from generator.choreographer.curves import rise, window
from generator.choreographer.formations import in_file
from generator.choreographer.gestures import follow, hand_on_hip, nod_along, pat, talk
from generator.choreographer.interaction import interaction
from generator.choreographer.spacing import Apart, ByReach
from generator.choreographer.stage import Span, Stage


@interaction(Apart(1.2, least=1.0))
def chat(stage: Stage) -> None:
    """Both stand and talk, first one and then the other underlining the words with the hands."""
    beat = stage.phases(approach=0.8, prepare=0.4, hold=4.8, depart=0.6, restless=0.022)
    stage.face_to_face(arrive=beat.prepare.end, travel=(0.1, 0.4))
    lag = min(stage.answer(), 0.6 / stage.style.speed)
    middle = beat.hold.at(stage.pick(0.44, 0.52))
    turns = (Span(beat.hold.start, middle), Span(middle + 0.25 + lag, beat.hold.end - 0.2))
    for role, other, turn, angle in zip(
        stage.people, stage.people[::-1], turns, (0.22, 0.12), strict=True
    ):
        role.heading += angle
        talk(stage, role, turn)
        role.lean += (
            0.04
            * stage.style.energy
            * window(stage.times, turn.start - 0.2, turn.start + 0.3, turn.end, turn.end + 0.5)
        )
        nod_along(stage, other, turn)
    listening = turns[0]
    hip = window(
        stage.times,
        listening.start - 0.2,
        listening.start + 0.5,
        listening.end - 0.5,
        listening.end + 0.1,
    )
    hand_on_hip(stage.second, "left", hip)


@interaction(Apart(0.95, least=0.9))
def argue(stage: Stage) -> None:
    """Both quarrel: one shakes a hand at the other, who throws up the arms and answers back."""
    beat = stage.phases(
        approach=0.9, prepare=0.4, hold=4.0, release=0.7, depart=0.6, restless=0.015
    )
    stage.face_to_face(arrive=beat.prepare.end, travel=(0.2, 0.5))
    times, energy, size = stage.times, stage.style.energy, stage.style.amplitude
    lag = min(stage.answer(), 0.5 / stage.style.speed)
    turns = (
        Span(beat.hold.start, beat.hold.at(0.42)),
        Span(beat.hold.at(0.42) + lag, beat.hold.at(0.85)),
    )
    for role, other, turn, sign in zip(
        stage.people, stage.people[::-1], turns, (1.0, -1.0), strict=True
    ):
        on = window(times, turn.start - 0.3, turn.start + 0.3, turn.end, turn.end + 0.6)
        jab = np.abs(stage.rhythm(turn, 0.8, 0.13))
        finger = np.column_stack([0.30 + 0.8 * jab, np.full(len(jab), 0.10), 0.20 - 0.7 * jab])
        role.gesture("right", finger, on, elbow=(-0.2, 0.6, -1.0))
        hand_on_hip(role, "left", on)
        role.lean += (0.10 * on + 0.25 * jab) * energy
        role.nod += 0.6 * jab
        role.path[:, 0] += sign * 0.10 * size * on
        # Whoever is shouted at leans away, and throws up the hands at what is said.
        other.lean -= 0.08 * energy * on
        other.heading += 0.15 * on
        fling = turn.at(0.55)
        arms = window(times, fling - 0.45, fling, fling + 0.25, turn.end + 0.15)
        for side in ("left", "right"):
            high = 0.02 + 0.12 * size
            other.gesture(side, (0.20, 0.34, high), arms, elbow=(-0.5, 0.6, -1.0))
        shake = Span(turn.start + 0.1, turn.end)
        other.twist += stage.rhythm(shake, 0.9, 0.07)
    for role in stage.people:
        role.gaze -= 0.5 * rise(times, beat.release.start, beat.release.end)
        role.heading += 0.35 * rise(times, beat.release.start, beat.depart.end)


@interaction(ByReach(0.66, room=0.06))
def whisper(stage: Stage) -> None:
    """One leans over, a hand beside the mouth, and whispers into the other's ear."""
    beat = stage.phases(
        approach=1.3, prepare=0.7, contact=0.3, hold=1.6, release=0.8, depart=0.9, restless=0.006
    )
    stage.face_to_face(arrive=beat.prepare.at(0.3), travel=(0.3, 0.6))
    times, size = stage.times, stage.style.amplitude
    first, second = stage.people
    taller = stage.builds[0].scale / stage.builds[1].scale
    for role in stage.people:  # past each other: mouth beside ear
        role.path[:, 1] += (0.12 if role is first else -0.12) * stage.scale
    on = window(times, beat.prepare.start, beat.contact.end, beat.hold.end, beat.release.end)
    first.lean += (0.16 + 0.25 * max(taller - 1.0, 0.0)) * on
    first.crouch += 0.18 * max(taller - 1.0, 0.0) * on
    first.tilt += 0.08 * on
    first.nod += 0.03 * np.sin(2 * np.pi * 1.1 * times) * on
    hand = (0.12, 0.08, -0.06 + 0.01 * size)
    first.gesture("left", hand, on, point="head", elbow=(0.0, 1.0, -0.5))
    late = min(stage.answer(stage.pick(0.0, 0.2)), 0.8 / stage.style.speed)
    ear = window(times, beat.prepare.at(0.3) + late, beat.contact.end + late, *_out(beat, late))
    second.lean += (0.08 + 0.2 * max(1.0 / taller - 1.0, 0.0)) * ear
    second.tilt += 0.10 * ear
    second.gaze -= 0.95 * ear
    second.nod += 0.10 * ear
    stage.lay_on(
        first,
        "right",
        "left_collar",
        (0.05, 0.08, 0.05),
        on=Span(beat.contact.end, beat.hold.end),
        start=beat.prepare.at(0.2),
        end=beat.release.end,
        elbow=(-0.3, 0.9, -0.8),
    )
    # The listener is amused by what it hears.
    laugh = Span(beat.release.start + late, beat.depart.at(0.8))
    second.lean -= np.abs(stage.rhythm(laugh, 1.2, 0.03)) * stage.style.energy
    mouth = window(times, laugh.start - 0.2, laugh.start + 0.4, laugh.end - 0.3, beat.end + 0.1)
    second.gesture("right", (0.13, 0.0, -0.05), mouth, point="head", elbow=(0.0, 0.6, -1.0))


def _out(beat, late: float) -> tuple[float, float]:
    """Return when the listener straightens up again."""
    return beat.hold.end, beat.release.end + 0.3 * late


@interaction(ByReach(0.78, room=0.16))
def tap_shoulder(stage: Stage) -> None:
    """One comes up from behind and taps the other on the shoulder, who turns round."""
    beat = stage.phases(
        approach=1.5, prepare=0.4, contact=0.7, hold=1.5, release=0.9, depart=1.0, restless=0.008
    )
    in_file(stage, arrive=beat.prepare.at(0.3), travel=(0.5, 0.9))
    times, size = stage.times, stage.style.amplitude
    first, second = stage.people
    moments = [beat.contact.start, beat.contact.start + 0.34 / min(stage.style.speed, 1.1)]
    pat(
        stage,
        first,
        "right",
        "right_collar",
        (-0.06, -0.05, 0.10),
        moments=moments,
        start=beat.approach.at(0.8),
        end=moments[-1] + 0.9,
        lift=(-0.05, 0.0, 0.06 * size),
        elbow=(-0.2, 0.7, -1.0),
    )
    notice = moments[-1] + 0.15 + min(stage.answer(), 0.6)
    second.heading -= np.pi * rise(times, notice, notice + 1.5 / stage.style.speed)
    second.gaze *= rise(times, notice - 0.1, notice + 0.5)
    first.path[:, 0] -= 0.25 * rise(times, notice, notice + 1.0)
    hello = notice + 1.1 / stage.style.speed
    up = window(times, hello - 0.3, hello + 0.4, beat.release.at(0.5), beat.depart.at(0.7))
    swing = stage.rhythm(Span(hello + 0.2, beat.release.end), 1.3, 0.07)
    greet = np.column_stack([np.full(len(times), 0.22), 0.24 + swing, np.full(len(times), 0.26)])
    first.gesture("right", greet, up, elbow=(-0.1, 0.6, -1.0))
    start = hello - 0.1
    surprise = window(times, start, start + 0.4, start + 0.7, beat.depart.at(0.6))
    for side in ("left", "right"):
        knots = [(start, (0.2, 0.2, -0.2)), (start + 0.5, (0.22, 0.30, 0.0 + 0.08 * size))]
        follow(stage, second, side, knots, surprise, elbow=(-0.4, 0.6, -1.0))
    second.lean -= 0.07 * stage.style.energy * surprise
