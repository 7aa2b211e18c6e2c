"""What is taken out of a reference before control, and what is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.tracking.corruption import Corruption, corrupt
from generator.choreographer import choreograph
from generator.kinematics import forward_kinematics, from_wxyz, to_wxyz
from generator.motion import Contact, DuetMotion
from robots.humanoid import HumanBody
from sim.footing import sole_corners
from sim.metrics.contact import gap
from sim.metrics.penetration import overlap
from sim.reference import Reference, make_reference
from sim.repair.apart import push_apart
from sim.repair.legs import move_foot
from sim.repair.lowpass import LONGEST, low_pass, noise_level
from sim.repair.planting import MAX_PLANT, find_stance, level_drift, plant_feet
from sim.scene import build_scene


def depth(reference: Reference) -> np.ndarray:
    """Return how deep the people of a reference are in each other ``[N]`` m."""
    scene = build_scene(reference.bodies)
    return overlap(scene, scene.qpos(reference.root, reference.rotations)).depth


def points(reference: Reference) -> np.ndarray:
    """Return the keypoints ``[N, 2, J, 3]`` m of the poses of a reference."""
    people = [
        forward_kinematics(body.skeleton, reference.root[:, p], reference.rotations[:, p])
        for p, body in enumerate(reference.bodies)
    ]
    return np.stack(people, axis=1)


def shaken(rotations: np.ndarray, degrees: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(*rotations.shape[:2], 3)) * np.radians(degrees)
    own = from_wxyz(rotations.reshape(-1, 4))
    return to_wxyz(own * Rotation.from_rotvec(turns.reshape(-1, 3))).reshape(rotations.shape)


@pytest.fixture(scope="module")
def handshake() -> DuetMotion:
    return choreograph("handshake", seed=0)


@pytest.fixture(scope="module")
def dirty(handshake) -> DuetMotion:
    return corrupt(handshake, seed=1)


@pytest.fixture(scope="module")
def repaired(dirty) -> Reference:
    return make_reference(dirty)


def test_the_noise_of_a_clip_is_measured(make_sway):
    rotations = make_sway(3.0).rotations
    assert noise_level(rotations) < np.radians(0.05)
    assert noise_level(shaken(rotations, 0.5)) == pytest.approx(np.radians(0.5), rel=0.15)


def test_clean_clips_keep_their_low_pass_and_noisy_ones_get_a_longer(make_sway):
    rotations = make_sway(3.0).rotations
    assert low_pass(rotations, 30.0, 0.02) == 0.02
    assert 0.04 < low_pass(shaken(rotations, 0.5), 30.0, 0.02) <= LONGEST
    assert low_pass(shaken(rotations, 5.0), 30.0, 0.02) == LONGEST


def test_a_clip_too_short_to_judge_counts_as_clean(make_sway):
    assert low_pass(make_sway(0.1).rotations, 30.0, 0.02) == 0.02


@pytest.mark.parametrize("interaction", ["handshake", "hug", "waltz"])
@pytest.mark.slow
def test_clean_choreography_barely_changes(interaction):
    reference = make_reference(choreograph(interaction, seed=0))
    assert np.linalg.norm(points(reference) - reference.keypoints, axis=-1).mean() < 0.003
    assert depth(reference).max() < 0.01


def test_standing_feet_of_a_spoilt_motion_stand_still(handshake, dirty, repaired):
    """Truth is the clean motion: where its feet stand, those of the repaired one must too."""
    clean = make_reference(handshake)
    raw = make_reference(dirty, repair=False)
    for p in range(2):
        stances = find_stance(clean.bodies[p], clean.root[:, p], clean.rotations[:, p], 60.0)
        for side in range(2):
            stands = np.convolve(stances[side].standing, np.ones(13), "same") == 13
            speed, height = [], []
            for reference in (raw, repaired):
                corners = sole_corners(
                    reference.bodies[p], reference.root[:, p], reference.rotations[:, p]
                )[:, 2 * side : 2 * side + 2].reshape(len(stands), -1, 3)
                steps = np.linalg.norm(np.gradient(corners[..., :2], axis=0), axis=-1)[stands]
                speed.append(steps.mean() * 60)
                height.append(np.abs(corners[stands, :, 2]).mean())
            assert speed[0] > 0.2
            assert speed[1] < 0.05
            assert height[1] < min(0.005, height[0] / 3)


def test_repairs_stay_small_beside_the_spoiling(repaired):
    assert np.linalg.norm(points(repaired) - repaired.keypoints, axis=-1).mean() < 0.03


def test_what_was_changed_is_told_per_person_and_kind(repaired):
    kinds = {
        *("ground_shift", "low_pass_s", "limb_stretch", "height_drift"),
        *("push_apart", "foot_plant", "foot_lift"),
    }
    for person in ("a", "b"):
        repairs = repaired.repairs[person]
        assert set(repairs) == kinds
        assert all(0 <= change["mean"] <= change["max"] for change in repairs.values())
        assert repairs["foot_plant"]["max"] <= MAX_PLANT + 1e-6
        assert repairs["low_pass_s"]["max"] > 0.03


def test_without_repair_poses_are_the_motion_s_own(handshake):
    reference = make_reference(handshake, rate=30.0, smoothing=0.0, repair=False)
    assert np.abs(points(reference) - reference.keypoints).max() < 0.005
    assert set(reference.repairs["a"]) == {"ground_shift", "low_pass_s", "limb_stretch"}


def test_errors_are_measured_against_the_motion_itself(make_duet):
    """Repairs must not hide in the ground truth: only a constant height may differ."""
    motion = corrupt(make_duet(1.0, distance=0.3), seed=0)
    reference = make_reference(motion, rate=motion.fps)
    for p, person in enumerate(motion.people):
        off = reference.keypoints[:, p] - person.keypoints
        assert off == pytest.approx(np.broadcast_to(off[0, 0], off.shape), abs=1e-9)
        assert off[0, 0] == pytest.approx([0, 0, reference.ground_shift[p]], abs=1e-9)


def test_a_moved_foot_arrives_and_keeps_its_orientation(make_sway):
    person = make_sway()
    body = HumanBody.of(person.skeleton)
    root = person.keypoints[:, 0]
    shift = np.tile([0.03, -0.02, 0.05], (person.frames, 1))
    made = move_foot(body, root, person.rotations, "left", shift)
    before, after = (forward_kinematics(body.skeleton, root, r) for r in (person.rotations, made))
    for name in ("left_ankle", "left_foot"):
        j = body.skeleton.index(name)
        assert after[:, j] - before[:, j] == pytest.approx(shift, abs=1e-3)


def drifting(person, height):
    root = person.keypoints[:, 0] + np.outer(height, [0.0, 0.0, 1.0])
    return HumanBody.of(person.skeleton), root, np.array(person.rotations)


def test_slow_floating_is_taken_out(make_sway):
    person = make_sway(4.0)
    times = np.arange(person.frames) / 30
    body, root, rotations = drifting(person, 0.03 + 0.02 * np.sin(2 * np.pi * times / 3))
    always, drift = level_drift(find_stance(body, root, rotations, 30.0), 30.0)
    assert always == pytest.approx(-0.03, abs=0.01)
    assert root[:, 2] + drift == pytest.approx(person.keypoints[:, 0, 2], abs=0.005)


def test_people_who_really_float_stay_so(make_sway):
    person = make_sway(2.0)
    body, root, rotations = drifting(person, np.full(person.frames, 0.5))
    stances = find_stance(body, root, rotations, 30.0)
    assert not level_drift(stances, 30.0)[1].any()
    _, moved = plant_feet(body, root, rotations, stances, 30.0)
    assert moved.max() < 1e-6


def test_a_jump_stays_a_jump(make_sway):
    person = make_sway(3.0)
    times = np.arange(person.frames) / 30
    flight = np.clip((times - 1.2) * (1.8 - times) * 9.81 / 2, 0, None)
    body, root, rotations = drifting(person, flight)
    _, drift = level_drift(find_stance(body, root, rotations, 30.0), 30.0)
    assert flight.max() > 0.4
    assert np.abs(drift).max() < 0.01


def test_a_hand_in_the_partner_s_chest_comes_out_and_goes_on_touching(make_duet):
    """One hand reaches 5 cm into the chest; the arm yields, nobody steps aside."""
    reference = close_hand(make_duet, 0.05)
    before = depth(reference)
    assert before.max() > 0.03
    root, rotations = push_apart(
        reference.bodies, reference.root, reference.rotations, (), reference.rate
    )
    made = replace(reference, root=root, rotations=rotations)
    assert np.percentile(depth(made), 95) < 0.006
    assert np.abs(root - reference.root).max() < 0.02


def close_hand(make_duet, inside: float) -> Reference:
    """Return two people who stand so close that a's stretched right arm reaches into b's chest."""
    reference = make_reference(make_duet(1.0, distance=2.0), repair=False)
    rotations = np.array(reference.rotations)
    names = reference.bodies[0].skeleton.names
    forward = to_wxyz(Rotation.from_euler("z", np.pi / 2))
    rotations[:, 0, names.index("right_shoulder")] = forward
    rotations[:, 0, names.index("right_elbow")] = [1.0, 0.0, 0.0, 0.0]
    reference = replace(reference, rotations=rotations)
    made, body = points(reference), reference.bodies[0]
    shape = body.shape("right_wrist")
    wrist = names.index("right_wrist")
    tip = made[0, 0, wrist] + (made[0, 0, wrist] - made[0, 0, names.index("right_elbow")]) * 0.245
    chest = made[:, 1, names.index("spine3")].mean(axis=0)
    surface = body.shape("spine3").radius + shape.radius
    root = np.array(reference.root)
    root[:, 1] += [tip[0] + surface - inside - chest[0], tip[1] - chest[1], 0.0]
    return replace(reference, root=root)


def test_trunks_in_each_other_are_moved_apart_smoothly(make_duet):
    reference = make_reference(make_duet(1.5, distance=0.17), repair=False)
    assert depth(reference).max() > 0.03
    root, rotations = push_apart(
        reference.bodies, reference.root, reference.rotations, (), reference.rate
    )
    assert np.percentile(depth(replace(reference, root=root, rotations=rotations)), 95) < 0.01
    accelerations = np.diff(root - reference.root, 2, axis=0) * reference.rate**2
    assert np.abs(accelerations).max() < 5.0


def test_people_who_do_not_overlap_are_left_alone(duet):
    reference = make_reference(duet, repair=False)
    root, rotations = push_apart(
        reference.bodies, reference.root, reference.rotations, (), reference.rate
    )
    assert np.array_equal(root, reference.root)
    assert np.array_equal(rotations, reference.rotations)


def test_labelled_hands_that_miss_are_brought_together(handshake):
    wide = Corruption(drift=0.03, turn=0.0, shake=0.0)
    motion = corrupt(handshake, seed=3, amount=wide)
    reference = make_reference(motion)
    contact: Contact = motion.contacts[0]
    held = (reference.times >= contact.start) & (reference.times <= contact.end)
    skeletons = (reference.bodies[0].skeleton, reference.bodies[1].skeleton)
    asked = gap(reference.keypoints, skeletons, contact.a, contact.b)[held]
    made = gap(points(reference), skeletons, contact.a, contact.b)[held]
    assert asked.max() > contact.gap + 0.03
    assert made.max() < contact.gap + 0.025


def test_a_reference_repeats_exactly(make_duet):
    motion = corrupt(make_duet(1.0, distance=0.3), seed=0)
    one, other = make_reference(motion), make_reference(motion)
    assert np.array_equal(one.root, other.root)
    assert np.array_equal(one.rotations, other.rotations)
