"""From the name of an interaction to a two-person motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from generator.choreographer.arms import pose_arms, slide_into_reach
from generator.choreographer.interaction import lookup
from generator.choreographer.pose import Pose
from generator.choreographer.role import Build
from generator.choreographer.spacing import USUAL, pose_trunks, solve
from generator.choreographer.stage import FPS, Stage
from generator.choreographer.style import Style
from generator.motion import Contact, DuetMotion, Motion
from robots.skeleton import Skeleton, human_skeleton

SOURCE = "pasdedeux choreographer 1"
LICENCE = "CC0-1.0"
"""Motions that the choreographer invents are free of rights."""


def choreograph(
    interaction: str,
    *,
    seed: int = 0,
    style: Style | None = None,
    skeletons: tuple[Skeleton, Skeleton] | None = None,
) -> DuetMotion:
    """Return a new two-person motion; the same arguments give the same motion.

    Args:
        interaction: A name from :func:`generator.choreographer.repertoire`.
        seed: Decides everything the style leaves open: timing, paths, sway.
        style: Manner of the performance; ordinary by default.
        skeletons: Bodies of person a and person b; the project's own human by default.

    Raises:
        PromptError: There is no such interaction.
        SpecError: A skeleton lacks a keypoint of the human body.
    """
    entry = lookup(interaction)
    style = style or Style()
    bodies = skeletons or (human_skeleton(), human_skeleton())
    builds = cast(bodies, style)
    salt = list(entry.name.encode())

    def attempt(near: float) -> tuple[Stage, tuple[Pose, Pose]]:
        rng = np.random.default_rng([seed, *salt])
        stage = Stage(builds, style, rng, near)
        entry.staging(stage)
        return stage, pose_trunks(stage)

    stage, pair = solve(entry.spacing, attempt)
    slide_into_reach(pair)
    pose_arms(pair)
    return DuetMotion(
        *finished(pair, style),
        seed=seed,
        source=SOURCE,
        licence=LICENCE,
        contacts=_labels(stage),
        interaction=entry.name,
    )


def touching(interaction: str, style: Style | None = None) -> tuple[tuple[str, str], ...]:
    """Return which points of a and b touch in an interaction, without performing it.

    Raises:
        PromptError: There is no such interaction.
    """
    entry = lookup(interaction)
    build = Build.of(human_skeleton())
    stage = Stage((build, build), style or Style(), np.random.default_rng(0), USUAL)
    entry.staging(stage)
    return tuple(dict.fromkeys((touch.a, touch.b) for touch in _labels(stage)))


def cast(bodies: tuple[Skeleton, Skeleton], style: Style) -> tuple[Build, Build]:
    """Return the builds of the leading and the answering role, as they are on stage."""
    leading, answering = bodies[::-1] if style.swap else bodies
    if style.handedness == "left":
        leading, answering = mirrored_skeleton(leading), mirrored_skeleton(answering)
    return Build.of(leading), Build.of(answering)


def finished(pair: tuple[Pose, Pose], style: Style) -> tuple[Motion, Motion]:
    """Return the motions of person a and person b, with the hands and roles of the style."""
    first, second = (pose.motion(FPS) for pose in pair)
    if style.handedness == "left":
        first, second = _mirrored(first), _mirrored(second)
    return (_turned(second), _turned(first)) if style.swap else (first, second)


def _labels(stage: Stage) -> tuple[Contact, ...]:
    """Return the touches of a stage by the sides of the style, and by who is a and b in it."""
    touches = tuple(stage.touches)
    if stage.style.handedness == "left":
        touches = tuple(replace(t, a=_other_side(t.a), b=_other_side(t.b)) for t in touches)
    if stage.style.swap:
        touches = tuple(Contact(t.b, t.a, t.start, t.end, t.gap) for t in touches)
    return touches


def _other_side(name: str) -> str:
    if name.startswith("left_"):
        return "right_" + name.removeprefix("left_")
    if name.startswith("right_"):
        return "left_" + name.removeprefix("right_")
    return name


def _swapped(skeleton: Skeleton) -> list[int]:
    return [skeleton.index(_other_side(name)) for name in skeleton.names]


def mirrored_skeleton(skeleton: Skeleton) -> Skeleton:
    """Return the skeleton as seen in a mirror: y is reflected and the sides change names."""
    offsets = skeleton.offsets[_swapped(skeleton)] * (1.0, -1.0, 1.0)
    return Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.hand_per_forearm)


def _mirrored(motion: Motion) -> Motion:
    """Return the motion reflected at the plane y = 0."""
    order = _swapped(motion.skeleton)
    rotations, contacts = _labelled(motion)
    return Motion(
        motion.fps,
        motion.keypoints[:, order] * (1.0, -1.0, 1.0),
        rotations[:, order] * (1.0, -1.0, 1.0, -1.0),
        contacts[:, [2, 3, 0, 1]],
        mirrored_skeleton(motion.skeleton),
    )


def _turned(motion: Motion) -> Motion:
    """Return the motion turned half round about the vertical through the origin."""
    rotations, contacts = _labelled(motion)
    turned = np.array(rotations)
    w, x, y, z = np.moveaxis(rotations[:, 0], -1, 0)
    turned[:, 0] = np.column_stack([-z, -y, x, w])
    return Motion(
        motion.fps,
        motion.keypoints * (-1.0, -1.0, 1.0),
        turned,
        contacts,
        motion.skeleton,
    )


def _labelled(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    if motion.rotations is None or motion.foot_contacts is None:
        raise TypeError("only motions with rotations and foot contacts are transformed")
    return motion.rotations, motion.foot_contacts


__all__ = [
    "LICENCE",
    "SOURCE",
    "cast",
    "choreograph",
    "finished",
    "mirrored_skeleton",
    "touching",
]
