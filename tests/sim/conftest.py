"""Small synthetic duets: people who stand, sway, step and reach."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generator.kinematics import forward_kinematics, to_wxyz
from generator.motion import DuetMotion, Motion
from robots.humanoid import HumanBody, body_plan, rest_positions
from robots.skeleton import human_skeleton


def sway(
    seconds: float = 1.2,
    fps: float = 30.0,
    *,
    at: tuple[float, float] = (0.0, 0.0),
    facing: float = 0.0,
    scale: float = 1.0,
    with_rotations: bool = True,
) -> Motion:
    """Return a person who stands at a place, arms lowered, and sways arms and trunk."""
    skeleton = human_skeleton().scaled(scale)
    times = np.arange(round(seconds * fps) + 1) / fps
    count = len(times)
    turns = np.zeros((count, len(skeleton), 3))
    swing = np.sin(2 * np.pi * times)
    turns[:, skeleton.index("left_shoulder"), 0] = -1.2
    turns[:, skeleton.index("right_shoulder"), 0] = 1.2
    turns[:, skeleton.index("left_elbow"), 2] = -0.5 - 0.4 * swing
    turns[:, skeleton.index("right_elbow"), 2] = 0.5 + 0.4 * swing
    turns[:, skeleton.index("spine1"), 1] = 0.1 * swing
    rotations = to_wxyz(Rotation.from_rotvec(turns.reshape(-1, 3))).reshape(count, -1, 4)
    rotations[:, 0] = to_wxyz(Rotation.from_euler("z", facing))
    low = rest_positions(skeleton)[:, 2].min() - body_plan().sole * HumanBody.of(skeleton).size
    root = np.tile([at[0], at[1], -low], (count, 1))
    points = forward_kinematics(skeleton, root, rotations)
    return Motion(fps, points, rotations if with_rotations else None, skeleton=skeleton)


def standing_duet(seconds: float = 1.2, distance: float = 1.2, **kwargs) -> DuetMotion:
    """Return two people who face each other."""
    return DuetMotion(
        sway(seconds, **kwargs),
        sway(seconds, at=(distance, 0.0), facing=np.pi, **kwargs),
        text="two people stand and sway",
        seed=3,
        source="test",
        licence="Apache-2.0",
    )


def moved(person: Motion, change) -> Motion:
    """Return a person with changed keypoints and no rotations."""
    return Motion(person.fps, change(person.keypoints.copy()), skeleton=person.skeleton)


@pytest.fixture(scope="session")
def duet() -> DuetMotion:
    """Two people who stand and sway, 1.2 s."""
    return standing_duet()


@pytest.fixture(scope="session")
def make_sway():
    """Return :func:`sway`."""
    return sway


@pytest.fixture(scope="session")
def make_duet():
    """Return :func:`standing_duet`."""
    return standing_duet


@pytest.fixture(scope="session")
def move():
    """Return :func:`moved`."""
    return moved
