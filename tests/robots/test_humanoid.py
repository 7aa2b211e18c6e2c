import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.errors import SpecError
from robots.humanoid import (
    HumanBody,
    body_plan,
    humanoid_xml,
    neighbours,
    parse_body_plan,
    rest_positions,
)
from robots.skeleton import human_skeleton


def compiled(body: HumanBody):
    model = mujoco.MjModel.from_xml_string(humanoid_xml(body))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def plan_text() -> str:
    from importlib import resources

    return resources.files("robots").joinpath("human/body.toml").read_text("utf-8")


@settings(max_examples=15, deadline=None)
@given(scale=st.floats(0.6, 1.3), weight=st.floats(20, 150))
def test_masses_sum_to_the_weight_and_keypoints_are_body_origins(scale, weight):
    skeleton = human_skeleton().scaled(scale)
    model, data = compiled(HumanBody.of(skeleton, weight))
    assert model.body_mass.sum() == pytest.approx(weight, rel=1e-9)
    ids = [model.body(name).id for name in skeleton.names]
    at = data.xpos[ids] - data.xpos[ids[0]]
    assert np.abs(at - rest_positions(skeleton)).max() < 1e-9


def test_keypoints_follow_a_person_with_bones_of_their_own():
    rng = np.random.default_rng(1)
    base = human_skeleton()
    skeleton = base.with_bone_lengths(base.bone_lengths * rng.uniform(0.8, 1.25, len(base)))
    model, data = compiled(HumanBody.of(skeleton))
    ids = [model.body(name).id for name in skeleton.names]
    at = data.xpos[ids] - data.xpos[ids[0]]
    assert np.abs(at - rest_positions(skeleton)).max() < 1e-9


def test_the_default_person_is_of_ordinary_size():
    body = HumanBody.of(human_skeleton())
    assert body.stature == pytest.approx(1.70, abs=0.005)
    assert body.weight == pytest.approx(22 * 1.70**2, rel=0.01)


def test_left_and_right_mirror_each_other():
    model, _ = compiled(HumanBody.of(human_skeleton()))
    for name in human_skeleton().names:
        if name.startswith("left_"):
            left, right = model.body(name), model.body(name.replace("left_", "right_"))
            assert left.mass == pytest.approx(right.mass)
            assert left.inertia == pytest.approx(right.inertia)
            assert left.ipos == pytest.approx(right.ipos * [1, -1, 1], abs=1e-12)


def test_trunk_and_limb_masses_are_those_of_the_anthropometric_table():
    model, _ = compiled(HumanBody.of(human_skeleton(), 100.0))

    def mass(*names):
        return sum(float(model.body(n).mass[0]) for n in names)

    trunk = ("pelvis", "spine1", "spine2", "spine3", "left_collar", "right_collar")
    assert mass(*trunk) == pytest.approx(11.17 + 16.33 + 15.96)
    assert mass("neck", "head") == pytest.approx(6.94)
    assert mass("left_ankle", "left_foot") == pytest.approx(1.37)
    assert mass("right_hip") == pytest.approx(14.16)


def test_soles_stand_on_the_floor_on_four_corners_each():
    model, data = compiled(HumanBody.of(human_skeleton()))
    body = HumanBody.of(human_skeleton())
    heights = [
        data.xpos[model.body(name).id, 2] + body.sole_corners(name)[:, 2]
        for name in ("left_ankle", "left_foot", "right_ankle", "right_foot")
    ]
    assert np.abs(heights).max() < 1e-12


def test_a_passive_person_stands_for_a_second():
    """Springs hold the pose; nobody balances, so it would topple in the end, but not at once."""
    model, data = compiled(HumanBody.of(human_skeleton()))
    start = data.qpos[2]
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert data.qpos[2] > 0.95 * start
    assert np.linalg.norm(data.qpos[:2]) < 0.1


def test_floor_carries_the_whole_weight():
    body = HumanBody.of(human_skeleton())
    model, data = compiled(body)
    load = []
    force = np.zeros(6)
    for _ in range(120):
        mujoco.mj_step(model, data)
        if data.time > 0.3:
            total = 0.0
            for i in range(data.ncon):
                mujoco.mj_contactForce(model, data, i, force)
                total += force[0]
            load.append(total)
    assert np.mean(load) == pytest.approx(body.weight * 9.81, rel=0.03)


def test_gains_scale_with_weight_and_stature():
    light, heavy = (HumanBody.of(human_skeleton(), w) for w in (50.0, 100.0))
    assert heavy.stiffness("left_knee") == pytest.approx(2 * light.stiffness("left_knee"))
    model, _ = compiled(heavy)
    assert model.actuator("left_knee").gainprm[0] == pytest.approx(heavy.stiffness("left_knee"))
    assert heavy.effort("left_knee") == pytest.approx(250 * heavy.strength)


def test_neighbours_are_two_bones_apart():
    pairs = {frozenset(p) for p in neighbours(human_skeleton())}
    assert frozenset(("left_hip", "right_hip")) in pairs
    assert frozenset(("pelvis", "spine2")) in pairs
    assert frozenset(("left_hip", "left_knee")) not in pairs
    assert frozenset(("left_wrist", "right_wrist")) not in pairs


@pytest.mark.parametrize("stature_factor", [0.2, 2.0])
def test_people_of_inhuman_size_are_refused(stature_factor):
    with pytest.raises(SpecError, match="person of"):
        HumanBody.of(human_skeleton().scaled(stature_factor))


def test_the_plan_has_a_segment_for_every_keypoint():
    names = {body_plan().segment(k).name for k in human_skeleton().names}
    assert names == {s.name for s in body_plan().segments}
    with pytest.raises(SpecError, match="no body segment"):
        body_plan().segment("tail")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("mass = 15.33", "mass = 14.33", "sum to 99"),
        ("armature = 0.05", "armatur = 0.05", "did you mean 'armature'"),
        ('shape = "heel"', 'shape = "sphere"', "unknown shape"),
        ("radius = 0.105", "radius = 0.0", "lacks mass or sizes"),
        ("stature = 1.70", "", "incomplete"),
        ("[[segment]]", "[[segment", "not valid TOML"),
    ],
)
def test_a_wrong_plan_is_named(old, new, message):
    text = plan_text()
    assert old in text
    with pytest.raises(SpecError, match=message):
        parse_body_plan(text.replace(old, new, 1))
