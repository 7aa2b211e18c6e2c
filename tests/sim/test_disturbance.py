import json
from dataclasses import asdict

import mujoco
import numpy as np
import pytest

from robots.errors import SpecError
from sim.disturbance import (
    NONE,
    Disturbance,
    Payload,
    Push,
    parse_payload,
    parse_push,
)
from sim.reference import make_reference
from sim.scene import GRAVITY, build_scene
from sim.simulation import Simulation
from sim.track import TrackSettings, track


@pytest.fixture(scope="module")
def reference(make_duet):
    return make_reference(make_duet(0.5), rate=120)


@pytest.fixture(scope="module")
def scene(reference):
    return build_scene(reference.bodies)


def mass_of(model, person):
    return sum(
        float(model.body_mass[i])
        for i in range(model.nbody)
        if model.body(i).name.startswith(f"{person}/")
    )


def test_a_push_is_read_from_text():
    assert parse_push("b 100 -5 0 at 1.5 for 0.2") == Push(
        person="b", force=(100.0, -5.0, 0.0), start=1.5, duration=0.2, body="spine3"
    )
    assert parse_push("a 0 0 1e2 at 0 for 0.2 on head").body == "head"


def test_a_payload_is_read_from_text():
    payload = Payload(person="a", body="right_wrist", mass=2.0)
    assert parse_payload("a right_wrist 2") == payload


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no push.*PERSON X Y Z"),
        ("a 100 0 0", "is no push.*such as"),
        ("a 100 0 0 at 1 for 0.2 on", "is no push"),
        ("a 100 0 0 for 1 at 0.2", "is no push"),
        ("a 100 0 zero at 1 for 0.2", "'zero' is no number"),
        ("c 100 0 0 at 1 for 0.2", "no person 'c'.*a or b"),
        ("a 100 0 0 at 1 for 0.2 on hed", "no body 'hed'.*did you mean 'head'"),
        ("a 9000 0 0 at 1 for 0.2", "9000 N.*-5000 to 5000 N"),
        ("a nan 0 0 at 1 for 0.2", "push.force: nan"),
        ("a 100 0 0 at -1 for 0.2", "push.start: -1 s"),
        ("a 100 0 0 at 1 for 0", "push.duration: 0 s"),
    ],
)
def test_a_push_that_makes_no_sense_is_refused_with_a_way_out(text, message):
    with pytest.raises(SpecError, match=message):
        parse_push(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a right_wrist", "is no payload.*KILOGRAMS"),
        ("a right_wrist two", "'two' is no number"),
        ("a right_hand 2", "no body 'right_hand'.*right_wrist"),
        ("a right_wrist -2", "0 to 100 kg"),
    ],
)
def test_a_payload_that_makes_no_sense_is_refused_with_a_way_out(text, message):
    with pytest.raises(SpecError, match=message):
        parse_payload(text)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"friction": 0.0}, "friction: 0 .*0.05 to 3"),
        ({"latency": -0.1}, "latency: -0.1 s"),
        ({"latency": float("nan")}, "latency: nan"),
        ({"mass_error": 2.0}, "mass_error: 2"),
    ],
)
def test_values_out_of_range_are_refused(values, message):
    with pytest.raises(SpecError, match=message):
        Disturbance(**values)


def test_a_disturbance_is_plain_json():
    made = Disturbance(
        pushes=(parse_push("a 100 0 0 at 1.0 for 0.2"),),
        payloads=(parse_payload("a right_wrist 2"),),
        friction=0.6,
    )
    read = json.loads(json.dumps(asdict(made)))
    assert read["pushes"][0]["force"] == [100.0, 0.0, 0.0]
    assert read["friction"] == 0.6


def test_nothing_is_copied_if_nothing_is_changed(scene):
    assert NONE.applied_to(scene.model) is scene.model


def test_the_controller_keeps_the_nominal_model(scene):
    before = scene.model.body_mass.copy(), scene.model.geom_friction.copy()
    payload = Payload(person="a", body="right_wrist", mass=2)
    Disturbance(payloads=(payload,), friction=0.4, mass_error=0.1).applied_to(scene.model)
    assert np.array_equal(scene.model.body_mass, before[0])
    assert np.array_equal(scene.model.geom_friction, before[1])


def test_a_payload_adds_its_mass_to_its_person(scene):
    payload = Payload(person="a", body="right_wrist", mass=2)
    model = Disturbance(payloads=(payload,)).applied_to(scene.model)
    assert mass_of(model, "a") == pytest.approx(mass_of(scene.model, "a") + 2)
    assert mass_of(model, "b") == pytest.approx(mass_of(scene.model, "b"))
    pelvis = model.body("a/pelvis").id
    assert model.body_subtreemass[pelvis] == pytest.approx(mass_of(model, "a"))


def test_a_mass_error_makes_both_people_heavier_and_harder_to_turn(scene):
    model = Disturbance(mass_error=0.1).applied_to(scene.model)
    for person in "ab":
        assert mass_of(model, person) == pytest.approx(1.1 * mass_of(scene.model, person))
    thigh = model.body("b/left_knee").id
    assert model.body_inertia[thigh] == pytest.approx(1.1 * scene.model.body_inertia[thigh])


def test_a_slippery_floor_lets_a_pushed_foot_slide(scene, reference):
    """Coulomb: with friction mu nothing below ``mu m g`` moves what stands."""
    slid = {}
    push = Push(person="a", body="pelvis", force=(0, 200, 0), start=0, duration=0.3)
    for friction in (0.05, 1.0):
        run = Simulation(scene, reference, Disturbance(pushes=(push,), friction=friction))
        ankle = scene.model.body("a/left_ankle").id
        start = run.data.xpos[ankle, 1]
        for _ in range(36):
            run.step()
        slid[friction] = run.data.xpos[ankle, 1] - start
    assert slid[0.05] > 2 * abs(slid[1.0])


@pytest.mark.parametrize("rate", [60, 75])
def test_a_push_gives_its_impulse_whatever_the_steps(make_duet, rate):
    """0.1 s are 7.5 steps at 75 Hz; the force of the last is halved instead of forgotten."""
    reference = make_reference(make_duet(0.5), rate=rate)
    scene = build_scene(reference.bodies, timestep=1 / rate)
    push = Push(person="a", force=(60, 0, 0), start=0.0, duration=0.1)
    momenta = []
    for disturbance in (NONE, Disturbance(pushes=(push,))):
        run = Simulation(scene, reference, disturbance)
        run.data.qpos[2] += 1  # nobody touches the floor
        run.data.qpos[scene.maps[1].root_qpos + 2] += 1
        while run.tick * 1.0 / rate < 0.15:
            run.step()
        mujoco.mj_subtreeVel(scene.model, run.data)
        body = scene.model.body("a/pelvis").id
        momenta.append(run.data.subtree_linvel[body] * scene.model.body_subtreemass[body])
    assert momenta[1] - momenta[0] == pytest.approx([6.0, 0, 0], abs=0.1)


def test_a_push_ends(scene, reference):
    push = Push(person="a", force=(60, 0, 0), start=0.1, duration=0.1)
    run = Simulation(scene, reference, Disturbance(pushes=(push,)))
    pushed = []
    while not run.done:
        run.step()
        pushed.append(float(np.abs(run.data.xfrc_applied).max()))
    assert pushed == pytest.approx([0] * 12 + [60] * 12 + [0] * (len(pushed) - 24), abs=1e-9)


def test_a_tracked_motion_says_what_disturbed_it_and_feels_it(make_duet):
    push = parse_push("a 0 150 0 at 0.1 for 0.2")
    settings = TrackSettings(controller="assist", disturbance=Disturbance(pushes=(push,)))
    motion = make_duet(0.4)
    calm = track(motion, settings=TrackSettings(controller="assist"))
    pushed = track(motion, settings=settings)
    said = json.loads(json.dumps(pushed.metadata["settings"]))["disturbance"]
    assert said["pushes"][0]["person"] == "a"
    assert pushed.error[-1, 0] > calm.error[-1, 0] + 0.005
    assert pushed.error[-1, 1] == pytest.approx(calm.error[-1, 1], abs=1e-6)


def test_more_weight_needs_more_help(make_duet):
    motion = make_duet(0.6)
    load = Payload(person="a", body="spine3", mass=20)
    lifts = []
    for disturbance in (NONE, Disturbance(payloads=(load,))):
        rollout = track(
            motion, settings=TrackSettings(controller="assist", disturbance=disturbance)
        )
        lifts.append(rollout.assist[10:, 0, 2].mean())
    assert 1 < lifts[1] - lifts[0] < 20 * GRAVITY
