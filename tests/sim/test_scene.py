import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generator.kinematics import forward_kinematics, to_wxyz
from robots.errors import SpecError
from robots.humanoid import HumanBody
from robots.skeleton import human_skeleton
from sim.metrics.penetration import overlap
from sim.scene import AssistLimits, build_scene, compile_model, load_scene


@pytest.fixture(scope="module")
def bodies():
    tall = human_skeleton().scaled(1.08)
    return HumanBody.of(human_skeleton()), HumanBody.of(tall)


@pytest.fixture(scope="module")
def scene(bodies):
    return build_scene(bodies, assist=AssistLimits())


def random_poses(count, spread, rng):
    root = rng.normal(size=(count, 2, 3)) * spread + [0, 0, 1]
    turns = Rotation.from_rotvec(rng.normal(size=(count * 2 * 22, 3)) * 0.7)
    return root, to_wxyz(turns).reshape(count, 2, 22, 4)


def test_qpos_from_rotations_reproduces_keypoints_in_mujoco(scene):
    root, rotations = random_poses(5, 1.0, np.random.default_rng(0))
    qpos = scene.qpos(root, rotations)
    own = scene.keypoints(qpos)
    data = mujoco.MjData(scene.model)
    for t, pose in enumerate(qpos):
        data.qpos[:] = pose
        mujoco.mj_kinematics(scene.model, data)
        for p, body in enumerate(scene.bodies):
            made = forward_kinematics(body.skeleton, root[:, p], rotations[:, p])[t]
            assert np.abs(data.xpos[scene.maps[p].bodies] - made).max() < 1e-9
            assert np.abs(own[t, p] - made).max() < 1e-12
    back = scene.poses(qpos)
    assert np.array_equal(back[0], root)
    assert np.array_equal(back[1], rotations)


def segment_distance(p, q, r, s):
    """Distance of segments pq and rs, by clamped closest points (Ericson, ch. 5)."""
    d1, d2, w = q - p, s - r, p - r
    a, e, f = d1 @ d1, d2 @ d2, d2 @ w
    c, b = d1 @ w, d1 @ d2
    denominator = a * e - b * b
    u = np.clip((b * f - c * e) / denominator, 0, 1) if denominator > 1e-12 else 0.0
    v = (b * u + f) / e
    if v < 0:
        v, u = 0.0, np.clip(-c / a, 0, 1)
    elif v > 1:
        v, u = 1.0, np.clip((b - c) / a, 0, 1)
    return np.linalg.norm(p + u * d1 - r - v * d2)


def capsule_depth(scene, qpos):
    """Depth of the deepest pair of capsules, without MuJoCo's collision detection."""
    data = mujoco.MjData(scene.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(scene.model, data)
    ends = []
    for at, body in zip(scene.maps, scene.bodies, strict=True):
        own = {}
        for name, b in zip(body.skeleton.names, at.bodies, strict=True):
            shape = body.shape(name)
            if not shape.is_box:
                turn = data.xmat[b].reshape(3, 3)
                own[name] = (
                    data.xpos[b] + turn @ shape.start,
                    data.xpos[b] + turn @ shape.end,
                    shape.radius,
                )
        ends.append(own)
    return max(
        r1 + r2 - segment_distance(p, q, r, s)
        for p, q, r1 in ends[0].values()
        for r, s, r2 in ends[1].values()
    )


def test_depths_agree_with_an_independent_capsule_distance(scene):
    rng = np.random.default_rng(4)
    root, rotations = random_poses(60, 0.12, rng)
    root[..., 2] += 5  # away from the floor
    qpos = scene.qpos(root, rotations)
    found = overlap(scene, qpos)
    checked = 0
    for t, pose in enumerate(qpos):
        names = scene.bodies[0].skeleton.names
        if found.pair[t, 0] >= 0 and not any(
            names[i].endswith(("ankle", "foot")) for i in found.pair[t]
        ):
            assert found.depth[t] == pytest.approx(capsule_depth(scene, pose), abs=1e-9)
            checked += 1
    assert checked > 30


def test_lowest_point_is_the_sole_of_a_standing_person(scene):
    root = np.array([[[0, 0, 0], [1.5, 0, 0]]], dtype=float)
    data = mujoco.MjData(scene.model)
    for p, at in enumerate(scene.maps):
        root[0, p, 2] = data.qpos[at.root_qpos + 2]
    still = np.zeros((1, 2, 22, 4))
    still[..., 0] = 1
    found = overlap(scene, scene.qpos(root, still))
    assert np.abs(found.lowest).max() < 1e-9
    assert found.depth[0] == 0
    assert (found.pair == -1).all()


def test_people_who_overlap_push_each_other_apart(bodies):
    scene = build_scene(bodies)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.maps[1].root_qpos] = 0.15
    mujoco.mj_forward(scene.model, data)
    start = data.xpos[scene.maps[1].bodies[0], 0] - data.xpos[scene.maps[0].bodies[0], 0]
    people = [set(at.geoms.tolist()) for at in scene.maps]
    force = np.zeros(6)
    between = 0.0
    for i in range(data.ncon):
        one, other = (int(g) for g in data.contact.geom[i])
        if (one in people[0] and other in people[1]) or (one in people[1] and other in people[0]):
            mujoco.mj_contactForce(scene.model, data, i, force)
            between += force[0]
    assert between > 100
    for _ in range(20):
        mujoco.mj_step(scene.model, data)
    after = data.xpos[scene.maps[1].bodies[0], 0] - data.xpos[scene.maps[0].bodies[0], 0]
    assert after > start + 0.02


def crossed_arms(scene):
    turns = np.zeros((1, 2, 22, 3))
    names = scene.bodies[0].skeleton.names
    turns[:, :, names.index("left_shoulder"), 2] = -1.57
    turns[:, :, names.index("right_shoulder"), 2] = 1.57
    turns[:, :, names.index("left_elbow"), 2] = -1.2
    turns[:, :, names.index("right_elbow"), 2] = 1.2
    root = np.array([[[0, 0, 3], [5, 0, 3]]], dtype=float)
    quats = to_wxyz(Rotation.from_rotvec(turns.reshape(-1, 3))).reshape(1, 2, 22, 4)
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos(root, quats)[0]
    mujoco.mj_forward(scene.model, data)
    return data.ncon


def test_limbs_of_one_person_collide_only_on_request(bodies):
    assert crossed_arms(build_scene(bodies)) == 0
    assert crossed_arms(build_scene(bodies, self_collision=True)) > 0


def test_rest_pose_has_no_self_collision(bodies):
    scene = build_scene(bodies, self_collision=True)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.maps[1].root_qpos] = 3.0
    data.qpos[[m.root_qpos + 2 for m in scene.maps]] += 1.0
    mujoco.mj_forward(scene.model, data)
    assert data.ncon == 0


def test_bounds_of_the_assist_are_body_weights(scene):
    for person, body in zip("ab", scene.bodies, strict=True):
        bound = scene.model.actuator(f"{person}/assist/z").forcerange[1]
        assert bound == pytest.approx(0.5 * body.weight * 9.81)
    bare = build_scene(scene.bodies)
    assert bare.model.nu == scene.model.nu - 12
    assert bare.maps[0].mocap == -1


@pytest.mark.parametrize(
    ("evil", "message"),
    [
        ('<include file="/etc/passwd"/>', "<include>"),
        ('<asset><mesh file="x.obj"/></asset>', "<asset>"),
        ('<extension><plugin plugin="x"/></extension>', "<extension>"),
    ],
)
def test_scenes_from_files_may_not_open_other_files(scene, evil, message):
    xml = scene.xml.replace("<worldbody>", evil + "<worldbody>", 1)
    with pytest.raises(SpecError, match=message):
        load_scene(xml, scene.bodies)


@pytest.mark.parametrize(
    "xml",
    [
        "<!DOCTYPE x [<!ENTITY e 'x'>]><mujoco>&e;</mujoco>",
        "<mujoco>",
        "",
        "<mujoco/>",
        "<mujoco><worldbody><geom size='-1'/></worldbody></mujoco>",
    ],
)
def test_damaged_scenes_are_refused_by_name(scene, xml):
    with pytest.raises(SpecError):
        load_scene(xml, scene.bodies)
    with pytest.raises(SpecError):
        compile_model("<mujoco><worldbody><geom size='-1'/></worldbody></mujoco>")


def test_absurd_assist_is_refused():
    with pytest.raises(SpecError, match="max_force"):
        AssistLimits(max_force=-1)
    with pytest.raises(SpecError, match="frequency"):
        AssistLimits(frequency=1000)
