"""Fixtures that the generator's tests share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generator.io import write_motion
from generator.kinematics import continuous, forward_kinematics, to_wxyz
from generator.motion import Contact, DuetMotion, Motion
from robots.skeleton import human_skeleton

MakeDuet = Callable[..., DuetMotion]


def _person(rng: np.random.Generator, frames: int, fps: float, x: float, yaw: float) -> Motion:
    """A rigid body that stands near (x, 0), faces ``yaw`` and moves all its limbs smoothly."""
    skeleton = human_skeleton().scaled(float(rng.uniform(0.85, 1.1)))
    skeleton = skeleton.with_bone_lengths(
        skeleton.bone_lengths * rng.uniform(0.95, 1.05, len(skeleton))
    )
    times = np.arange(frames)[:, None, None] / fps
    speed = rng.uniform(1, 4, (len(skeleton), 3))
    phase = rng.uniform(0, 2 * np.pi, (len(skeleton), 3))
    turns = 0.35 * np.sin(speed * times + phase)
    turns[:, 0] *= 0.2
    local = Rotation.from_rotvec(turns.reshape(-1, 3))
    rotations = to_wxyz(local).reshape(frames, len(skeleton), 4)
    heading = Rotation.from_euler("z", yaw)
    rotations[:, 0] = to_wxyz(heading * Rotation.from_rotvec(turns[:, 0]))
    root = np.tile([x, 0.0, 0.0], (frames, 1)) + 0.05 * np.sin(times[:, :, 0])
    points = forward_kinematics(skeleton, root, rotations)
    root[:, 2] -= points[..., 2].min()
    points = forward_kinematics(skeleton, root, rotations)
    return Motion(fps, points, continuous(rotations), None, skeleton)


@pytest.fixture(scope="session")
def make_duet() -> MakeDuet:
    """Factory of plausible synthetic duets: two rigid bodies, face to face, all joints moving."""

    def make(frames: int = 12, fps: float = 30.0, seed: int = 0) -> DuetMotion:
        rng = np.random.default_rng(seed)
        a = _person(rng, frames, fps, -0.5, 0.0)
        b = _person(rng, frames, fps, 0.5, np.pi)
        contact = Contact("right_hand", "left_shoulder", 0.1, 0.2, 0.05)
        return DuetMotion(
            a,
            b,
            text="two people wave — “hello”",
            seed=seed,
            source="synthetic",
            licence="CC0",
            contacts=(contact,),
            interaction="wave",
        )

    return make


@pytest.fixture(scope="session")
def golden() -> Path:
    """Folder of reference vectors of the public InterGen release, beside a development checkout.

    They are not part of the project (their licence is not ours); tests that need them are skipped
    where they are not there.
    """
    folder = Path(__file__).parents[3] / "shared" / "golden" / "intergen"
    if not folder.is_dir():
        pytest.skip(f"no reference vectors at {folder}")
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, make_duet: MakeDuet) -> Path:
    """Three short duets, each with a sentence of its own, and room for their cache."""
    root = tmp_path_factory.mktemp("clips")
    for seed, text in enumerate(("two people wave", "they bow left", "a hug")):
        duet = replace(make_duet(frames=20, seed=seed), text=text)
        write_motion(duet, root / "duets" / f"{seed}.npz")
    return root
