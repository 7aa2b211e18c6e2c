"""Jolts are taken out where they are, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generator.choreographer import choreograph
from generator.finishing import DRAWN, finish
from generator.finishing.apart import push_apart
from generator.finishing.calm import calm, calmed
from generator.finishing.corrections import runs
from generator.finishing.feet import plant_feet
from generator.finishing.figure import Figure, turn_about
from generator.finishing.settings import Finishing
from generator.kinematics import to_wxyz
from generator.motion import Motion
from robots.skeleton import human_skeleton

SKELETON = human_skeleton()
FPS = 30.0


def acceleration(points: np.ndarray) -> np.ndarray:
    """Return ``[T-2]`` m/s^2, the largest of all keypoints."""
    return np.linalg.norm(np.diff(points, 2, axis=0), axis=-1).max(axis=1) * FPS**2


@pytest.fixture(scope="module")
def punch() -> Motion:
    """Return a boxer: clean, with accents."""
    return choreograph("box", seed=2).a


def turned_round(motion: Motion, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Return root and rotations with the pelvis turned by 100 degrees for two frames."""
    assert motion.rotations is not None
    turns = motion.rotations.copy()
    wrong = Rotation.from_euler("z", 100, degrees=True)
    own = Rotation.from_quat(turns[at : at + 2, 0], scalar_first=True)
    turns[at : at + 2, 0] = to_wxyz(wrong * own)
    return motion.keypoints[:, 0].copy(), turns


def test_a_hip_that_is_turned_round_for_a_moment_is_calmed(punch: Motion) -> None:
    """A waltz came out of the network with hips that turned by 100 degrees in a frame."""
    root, turns = turned_round(punch, 60)
    assert acceleration(Figure(SKELETON, root, turns).points).max() > 300
    calmer, turned = calm(punch.skeleton, root, turns, FPS, 80.0)
    points = Figure(punch.skeleton, calmer, turned).points
    assert acceleration(points).max() <= 80.0
    away = np.linalg.norm(points - punch.keypoints, axis=-1).max(axis=1)
    assert away[:30].max() < 1e-9
    assert away[100:].max() < 1e-9


def test_accents_of_a_body_are_left_alone(punch: Motion) -> None:
    assert calmed(punch, Finishing().jolt) is punch
    gentle = calmed(punch, 8.0)
    assert acceleration(gentle.keypoints).max() < acceleration(punch.keypoints).max()


def test_a_motion_without_rotations_is_not_calmed(punch: Motion) -> None:
    bare = Motion(punch.fps, punch.keypoints, None, None, punch.skeleton)
    assert calmed(bare, 1.0) is bare


def standing(frames: int = 60) -> Figure:
    still = np.tile([1.0, 0.0, 0.0, 0.0], (frames, len(SKELETON), 1))
    return Figure(SKELETON, np.tile([0.0, 0.0, 0.95], (frames, 1)), still)


def test_a_step_between_two_stances_is_never_a_leap_of_one_frame() -> None:
    """A gap of one frame between two places lifted the foot by 5 cm for that frame."""
    figure = standing()
    move = np.zeros((60, 3))
    move[:, 0] = np.clip((np.arange(60) - 27) * 0.02, 0.0, 0.12)
    figure.shift(move)
    labels = np.ones((60, 4), dtype=bool)
    labels[30] = False
    stands, _ = plant_feet(figure, FPS, labels, Finishing())
    gaps = [gap.stop - gap.start for gap in runs(~stands[:, 1])]
    assert gaps
    assert min(gaps) >= 8
    assert acceleration(figure.points[:, [SKELETON.index("left_foot")]]).max() < 60


def test_a_foot_that_pivots_on_the_spot_keeps_its_heading() -> None:
    """Held askew for a whole stance, it whipped round by 100 degrees on the way to the next."""
    figure = standing(90)
    about = np.outer(np.linspace(0, np.pi, 90), (0.0, 0.0, 1.0))
    ball = figure.point("left_foot").copy()
    figure.bend("pelvis", turn_about(about))
    figure.shift(ball - figure.point("left_foot"))
    hop = np.zeros((90, 3))
    hop[42:48, 2] = 0.06 * np.sin(np.linspace(0, np.pi, 6))
    figure.shift(hop)
    labels = np.ones((90, 4), dtype=bool)
    labels[42:48] = False
    plant_feet(figure, FPS, labels, Finishing())
    frame = figure.frame("left_ankle")
    now = np.unwrap(np.arctan2(frame[:, 1, 0], frame[:, 0, 0]))
    assert np.abs(np.diff(now)).max() < np.radians(10)


def test_people_who_pass_through_each_other_are_not_thrown_to_and_fro() -> None:
    """Where two pelvises coincide there is no direction; it flipped from frame to frame."""
    a, b = standing(90), standing(90)
    way = np.linspace(-0.6, 0.6, 90)
    wobble = 0.002 * np.sin(np.arange(90))
    b.shift(np.column_stack([way, wobble, np.zeros(90)]))
    push_apart((a, b), FPS)
    assert max(acceleration(f.points).max() for f in (a, b)) < 60


def test_what_a_network_drew_is_as_smooth_as_what_it_learnt_from() -> None:
    clean = choreograph("waltz", seed=3)
    root, turns = turned_round(clean.a, 50)
    body = clean.a.skeleton
    points = Figure(body, root, turns).points
    spoilt = Motion(FPS, points, turns, clean.a.foot_contacts, body)
    made = finish(type(clean)(spoilt, clean.b), settings=DRAWN)
    assert acceleration(made.a.keypoints).max() <= 1.2 * DRAWN.jolt + 1e-6
