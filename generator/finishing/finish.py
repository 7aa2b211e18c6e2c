"""One call that makes a generated motion clean."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from generator.finishing.apart import push_apart
from generator.finishing.approach import step_nearer
from generator.finishing.bends import unbend
from generator.finishing.bones import fit_bones
from generator.finishing.calm import calm, calmed
from generator.finishing.denoise import denoise
from generator.finishing.feet import plant_feet
from generator.finishing.figure import Figure
from generator.finishing.hands import close_touches, missed_by
from generator.finishing.resample import resample, resample_labels, resample_rotations
from generator.finishing.settings import Finishing
from generator.finishing.touches import (
    Meeting,
    Pair,
    find_touches,
    nearest_touches,
    settled,
    without_conflicts,
)
from generator.kinematics import continuous
from generator.motion import Contact, DuetMotion, Motion
from robots.errors import MotionError
from robots.skeleton import FloatArray, Skeleton

log = logging.getLogger(__name__)

_USUAL = 0.0004
"""Noise that clean keypoints seem to have, m: quick movement looks like it."""
_USUAL_TURN = 0.001
"""The same of quaternions."""
_AFTER = 1.2
"""How much larger a jolt is allowed to be when feet and hands have their places, which it moves."""


@dataclass(frozen=True, slots=True)
class Changes:
    """What finishing did to a duet; lengths are the largest over time and both people."""

    moved: float
    """Mean distance of keypoints from where they were, m."""
    smoothed: float
    """Mean distance by which jitter was taken out, m."""
    bones: float
    """Largest deviation of a bone from its length before, as a share."""
    unbent: float
    """How far a joint was turned back into the range that joints have, degrees."""
    raised: float
    """How far a person was moved up or down, m."""
    followed: float
    """How far a pelvis was moved along the floor with its feet, m."""
    sunk: float
    """How far a pelvis was lowered for a leg to reach, m."""
    planted: float
    """How far a standing foot was moved, m."""
    gliding: int
    """Feet that at some time slide too far to be held."""
    overlap: float
    """Deepest overlap of the two people before, m; negative is room."""
    pushed: float
    """How far a person was moved out of the other, m."""
    stepped: float
    """How far each person was moved along the floor towards touches, all the time alike, m."""
    touches: int
    """Touches that were closed."""
    given_up: int
    """Touches that missed by too much, or that hands have no part in."""
    missed: float
    """Largest miss of a touch before, m."""
    missing: float
    """Largest miss of a closed touch after, m."""


def finish(
    motion: DuetMotion,
    *,
    fps: float = 30.0,
    settings: Finishing | None = None,
    skeletons: tuple[Skeleton, Skeleton] | None = None,
    expected: Sequence[Meeting | Pair] = (),
) -> DuetMotion:
    """Return the motion as two bodies could have moved it; see :func:`finish_with_changes`."""
    return finish_with_changes(
        motion, fps=fps, settings=settings, skeletons=skeletons, expected=expected
    )[0]


def finish_with_changes(
    motion: DuetMotion,
    *,
    fps: float = 30.0,
    settings: Finishing | None = None,
    skeletons: tuple[Skeleton, Skeleton] | None = None,
    expected: Sequence[Meeting | Pair] = (),
) -> tuple[DuetMotion, Changes]:
    """Return the motion as two bodies could have moved it, and what was changed.

    Jitter is taken out, bones get constant lengths, the frame rate is made ``fps``, joints are
    turned back that are bent further than joints go, people who are too far apart for what they are
    meant to touch are moved nearer, people who overlap apart, standing feet are held on the floor,
    touches are closed.

    Args:
        motion: Two people, with or without rotations, labels of foot contacts and touches.
        fps: Frames per second of the result.
        settings: Bounds; the defaults if not given.
        skeletons: Bodies of a and b, if they are known; fitted to the motion otherwise.
        expected: Points of a and b that are meant to touch somewhere in the motion, for example
            ``[("right_hand", "right_hand")]``, or also when. Touches of two hands are looked for
            besides, where the motion has no labelled contacts.

    Raises:
        MotionError: The frame rate is absurd.
        SpecError: An expected point does not exist.
    """
    settings = settings or Finishing()
    if not 1 <= fps <= 1000:
        raise MotionError(f"{fps} frames per second", allowed="1 to 1000")
    before, figures, smoothed, unbent = [], [], [], []
    for i, person in enumerate(motion.people):
        figure, change = _body(person, fps, settings, skeletons[i] if skeletons else None)
        figures.append(figure)
        unbent.append(unbend(figure))
        before.append(resample(person.keypoints, motion.fps, fps))
        smoothed.append(change)
    pair = figures[0], figures[1]
    meetings = tuple(m if isinstance(m, Meeting) else Meeting(*m) for m in expected)
    facts = _put_in_place(motion, pair, fps, settings, meetings)
    feet, labels = [], []
    for figure, person in zip(figures, motion.people, strict=True):
        said = person.foot_contacts
        said = None if said is None else resample_labels(said, motion.fps, fps)
        down, fact = plant_feet(figure, fps, said, settings) if settings.feet else (said, {})
        feet.append(fact)
        labels.append(down)
    contacts = _contacts(motion, pair, fps, settings, meetings)
    facts |= close_touches(pair, fps, contacts, settings) if settings.hands else {}
    if not motion.contacts:  # what nobody labelled and does not meet is no touch
        contacts = tuple(c for c in contacts if missed_by(pair, fps, c) <= settings.max_gap)
    a, b = (
        calmed(f.motion(fps, down), _AFTER * settings.jolt)
        for f, down in zip(figures, labels, strict=True)
    )
    done = replace(motion, a=a, b=b, contacts=contacts)
    moved = [
        np.linalg.norm(person.keypoints - was, axis=-1).mean()
        for person, was in zip(done.people, before, strict=True)
    ]
    changes = Changes(
        moved=float(np.mean(moved)),
        smoothed=float(np.mean(smoothed)),
        unbent=max(unbent),
        bones=max(_breathing(motion.a, a.skeleton), _breathing(motion.b, b.skeleton)),
        **{key: max(f.get(key, 0.0) for f in feet) for key in ("raised", "followed", "sunk")},
        planted=max(f.get("planted", 0.0) for f in feet),
        gliding=int(sum(f.get("gliding", 0) for f in feet)),
        overlap=float(facts["overlap"]),
        pushed=float(facts["pushed"]),
        stepped=float(facts["stepped"]),
        touches=int(facts.get("touches", 0)),
        given_up=int(facts.get("given_up", 0)),
        missed=float(facts.get("missed", 0.0)),
        missing=float(facts.get("missing", 0.0)),
    )
    log.info("finished %d frames: %s", done.frames, changes)
    return done, changes


def _body(
    person: Motion, fps: float, settings: Finishing, skeleton: Skeleton | None
) -> tuple[Figure, float]:
    """Return a person with constant bones at the new rate, and how far smoothing moved it, m."""
    points = denoise(person.keypoints, settings.smoothing, _USUAL)
    turns = person.rotations
    if turns is not None:
        turns = denoise(continuous(turns), settings.smoothing, _USUAL_TURN)
        turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    keep = skeleton is not None
    fitted, root, rotations = fit_bones(
        skeleton or person.skeleton, points, turns, keep=keep, share=settings.rotations
    )
    root = resample(root, person.fps, fps)
    rotations = resample_rotations(rotations, person.fps, fps)
    root, rotations = calm(fitted, root, rotations, fps, settings.jolt)
    change = float(np.linalg.norm(points - person.keypoints, axis=-1).mean())
    return Figure(fitted, root, rotations), change


def _put_in_place(
    motion: DuetMotion,
    figures: tuple[Figure, Figure],
    fps: float,
    settings: Finishing,
    meetings: Sequence[Meeting],
) -> dict[str, float]:
    """Bring people nearer for touches that are meant, and out of each other; say how far."""
    stepped = 0.0
    if settings.hands:
        meant = motion.contacts or nearest_touches(figures, fps, meetings)
        stepped = step_nearer(figures, fps, meant, settings)
    facts = push_apart(figures, fps) if settings.apart else {"overlap": np.nan, "pushed": 0.0}
    return {**facts, "stepped": stepped}


def _contacts(
    motion: DuetMotion,
    figures: tuple[Figure, Figure],
    fps: float,
    settings: Finishing,
    meetings: Sequence[Meeting],
) -> tuple[Contact, ...]:
    """Return the touches that are meant: labelled, else expected and found ones."""
    if motion.contacts:
        return motion.contacts
    found = find_touches(figures, fps, settings) if settings.hands and settings.detect else ()
    certain = settled(figures, fps, meetings)
    missing = [m for m in certain if not any(m.met_by(touch) for touch in found)]
    return without_conflicts([*nearest_touches(figures, fps, missing), *found])


def _breathing(person: Motion, skeleton: Skeleton) -> float:
    """Return the largest deviation of a bone from its final length, as a share of 5 cm or more."""
    lengths: FloatArray = np.linalg.norm(
        person.keypoints[:, 1:] - person.keypoints[:, list(skeleton.parents[1:])], axis=-1
    )
    final = skeleton.bone_lengths[1:]
    return float((np.abs(lengths - final) / np.maximum(final, 0.05)).max())
