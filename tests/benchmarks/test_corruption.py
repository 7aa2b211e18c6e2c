from dataclasses import replace

import numpy as np
import pytest

from benchmarks.tracking.corruption import Corruption, corrupt
from generator.choreographer import choreograph
from generator.kinematics import forward_kinematics, from_wxyz
from generator.motion import DuetMotion
from sim.fitting import fit_person


@pytest.fixture(scope="module")
def waltz() -> DuetMotion:
    return choreograph("waltz", seed=1)


def turns_of(motion: DuetMotion, seed: int, **amount: float) -> np.ndarray:
    """Turns ``[T, 2, 22, 3]`` rad that a corruption added."""
    spoilt = corrupt(motion, seed, Corruption(**amount))
    turns = []
    for before, after in zip(motion.people, spoilt.people, strict=True):
        assert after.rotations is not None
        clean = from_wxyz(fit_person(before)[1].reshape(-1, 4))
        turn = (clean.inv() * from_wxyz(after.rotations.reshape(-1, 4))).as_rotvec()
        turns.append(turn.reshape(before.frames, -1, 3))
    return np.stack(turns, axis=1)


def test_pelvises_drift_by_two_centimetres_and_slowly(waltz):
    spoilt = [corrupt(waltz, seed) for seed in range(30)]
    drifts = [(motion.keypoints - waltz.keypoints)[:, :, 0] for motion in spoilt]
    assert np.std(drifts) == pytest.approx(0.02, rel=0.1)
    # A Gaussian of 0.5 s leaves noise whose rate of change is sigma / (sqrt(2) 0.5 s).
    speed = np.std(np.diff(drifts, axis=1)) * waltz.fps
    assert speed == pytest.approx(0.02 / (np.sqrt(2) * 0.5), rel=0.15)


def test_every_rotation_is_off_by_two_degrees_slowly_and_half_a_degree_per_frame(waltz):
    slow = turns_of(waltz, 0, shake=0.0)
    assert np.degrees(np.std(slow)) == pytest.approx(2.0, rel=0.1)
    assert np.degrees(np.std(slow, axis=(0, 1, 3)).min()) > 1.0
    fast = turns_of(waltz, 0, turn=0.0)
    assert np.degrees(np.std(fast)) == pytest.approx(0.5, rel=0.05)
    steps = np.degrees(np.std(np.diff(fast, axis=0)))
    assert steps == pytest.approx(0.5 * np.sqrt(2), rel=0.05)


def test_bones_keep_their_lengths_and_rotations_give_the_keypoints(waltz):
    spoilt = corrupt(waltz, 3)
    for person in spoilt.people:
        assert person.rotations is not None
        made = forward_kinematics(person.skeleton, person.keypoints[:, 0], person.rotations)
        np.testing.assert_allclose(made, person.keypoints, atol=1e-9)


def test_labels_stay_though_hands_now_miss(waltz):
    spoilt = corrupt(waltz, 3)
    assert spoilt.contacts == waltz.contacts
    assert spoilt.interaction == "waltz"
    touch = waltz.contacts[0]
    wanted = (waltz.a.times >= touch.start) & (waltz.a.times <= touch.end)
    assert spoilt.gap(touch)[wanted].max() > waltz.gap(touch)[wanted].max() + 0.02


def test_a_motion_without_rotations_is_corrupted_too(waltz):
    bare = replace(
        waltz,
        a=replace(waltz.a, rotations=None),
        b=replace(waltz.b, rotations=None),
    )
    spoilt = corrupt(bare, 0)
    assert spoilt.a.rotations is not None
    error = np.linalg.norm(spoilt.keypoints - waltz.keypoints, axis=-1)
    assert 0.01 < error.mean() < 0.1


def test_the_same_seed_spoils_alike_and_another_one_otherwise(waltz):
    first, again, other = (corrupt(waltz, seed) for seed in (5, 5, 6))
    assert np.array_equal(first.keypoints, again.keypoints)
    assert not np.allclose(first.keypoints, other.keypoints)
    assert not np.allclose(
        *(
            p.keypoints[:, 0] - q.keypoints[:, 0]
            for p, q in zip(first.people, waltz.people, strict=True)
        )
    )
