from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generator.io import read_motion
from generator.io.acclaim import read_amc, skeleton_path
from generator.io.acclaim_pose import bone_starts
from generator.io.acclaim_skeleton import read_asf
from robots.errors import MotionFileError

UNIT = 0.0254 / 0.45
"""Metres per unit of CMU's files."""

# name, parent, vector in metres (y up, x left, z forward), degrees of freedom
BODY = [
    ("lhipjoint", "root", (0.09, -0.09, 0.02), ""),
    ("lfemur", "lhipjoint", (0.0, -0.42, 0.0), "rx ry rz"),
    ("ltibia", "lfemur", (0.0, -0.42, -0.02), "rx"),
    ("lfoot", "ltibia", (0.0, -0.06, 0.13), "rx rz"),
    ("ltoes", "lfoot", (0.0, 0.0, 0.06), ""),
    ("lowerback", "root", (0.0, 0.115, 0.0), "rx ry rz"),
    ("upperback", "lowerback", (0.0, 0.115, 0.0), ""),
    ("thorax", "upperback", (0.0, 0.115, 0.0), ""),
    ("lowerneck", "thorax", (0.0, 0.09, 0.0), ""),
    ("upperneck", "lowerneck", (0.0, 0.09, 0.0), ""),
    ("head", "upperneck", (0.0, 0.09, 0.0), ""),
    ("lclavicle", "thorax", (0.19, 0.05, 0.0), ""),
    ("lhumerus", "lclavicle", (0.28, 0.0, 0.0), "rx ry rz"),
    ("lradius", "lhumerus", (0.19, 0.0, 0.0), "rx"),
    ("lwrist", "lradius", (0.09, 0.0, 0.0), "ry"),
    ("lhand", "lwrist", (0.04, 0.0, 0.0), ""),
]


def asf_text() -> str:
    body = list(BODY)
    for name, parent, (x, y, z), dof in BODY:
        if name.startswith("l") and not name.startswith("lower"):
            mother = "r" + parent[1:] if parent[0] == "l" and parent != "lowerback" else parent
            body.append(("r" + name[1:], mother, (-x, y, z), dof))
    lines = [":version 1.10", ":units", " mass 1.0", " length 0.45", " angle deg", ":root"]
    lines += [" order TX TY TZ RX RY RZ", " axis XYZ", " position 0 0 0", " orientation 0 0 0"]
    lines += [":bonedata"]
    for i, (name, _, vector, dof) in enumerate(body):
        size = np.linalg.norm(vector)
        unit = " ".join(f"{c / size:.9f}" for c in vector)
        lines += [" begin", f"  id {i + 1}", f"  name {name}", f"  direction {unit}"]
        lines += [f"  length {size / UNIT:.9f}", "  axis 10 20 -90 XYZ"]
        lines += ([f"  dof {dof}", "  limits (-90 90)"] if dof else []) + [" end"]
    lines += [":hierarchy", " begin"]
    for parent in dict.fromkeys(p for _, p, _, _ in body):
        lines.append(f"  {parent} " + " ".join(n for n, p, _, _ in body if p == parent))
    return "\n".join([*lines, " end"]) + "\n"


def amc_text(x: float, yaw: float, frames: int = 4, elbow: float = 20.0) -> str:
    lines = ["# made for a test", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(frames):
        lines += [str(frame + 1), f"root {x / UNIT:.6f} {1.0 / UNIT:.6f} 0 0 {yaw} 0"]
        for side in "lr":
            lines += [f"{side}femur {frame} 0 0", f"{side}tibia 5", f"{side}foot 0 0"]
            lines += [f"{side}humerus 0 0 0", f"{side}radius {elbow}", f"{side}wrist 30"]
        lines.append("lowerback 5 0 0")
    return "\n".join(lines) + "\n"


def save_pair(folder, first="18", second="19", trial="01"):
    for subject, x, yaw in ((first, -0.6, 90), (second, 0.6, -90)):
        (folder / f"{subject}.asf").write_text(asf_text())
        (folder / f"{subject}_{trial}.amc").write_text(amc_text(x, yaw))
    return folder / f"{first}_{trial}.amc"


@pytest.mark.parametrize(
    ("first", "second", "fps"),
    [("18", "19", 120), ("22", "23", 120), ("33", "34", 60), ("60", "61", 60)],
)
def test_the_database_pairs_are_found_and_have_their_rates(tmp_path, first, second, fps):
    path = save_pair(tmp_path, first, second)
    motion = read_motion(path)
    assert motion.fps == fps
    assert "mocap.cs.cmu.edu" in motion.licence
    # CMU's y is up and z is our x: the two stand along our y, a at -0.6 m.
    np.testing.assert_allclose(motion.a.keypoints[:, 0], [[0, -0.6, 1.0]] * 4, atol=1e-5)
    np.testing.assert_allclose(motion.b.keypoints[:, 0], [[0, 0.6, 1.0]] * 4, atol=1e-5)
    back = read_motion(path.with_name(f"{second}_01.amc"))
    np.testing.assert_array_equal(back.keypoints, motion.keypoints)


def test_partners_in_one_folder_a_subject_are_found(tmp_path):
    for subject, x, yaw in (("20", -0.6, 90), ("21", 0.6, -90)):
        folder = tmp_path / "subjects" / subject
        folder.mkdir(parents=True)
        (folder / f"{subject}.asf").write_text(asf_text())
        (folder / f"{subject}_05.amc").write_text(amc_text(x, yaw))
    assert read_motion(tmp_path / "subjects" / "21" / "21_05.amc").fps == 120


def test_bone_lengths_are_in_metres(tmp_path):
    motion = read_motion(save_pair(tmp_path))
    skeleton = motion.a.skeleton
    for name, length in (("left_knee", 0.42), ("right_elbow", 0.28), ("left_wrist", 0.28)):
        assert skeleton.bone_lengths[skeleton.index(name)] == pytest.approx(length, abs=5e-4)


def test_degrees_of_freedom_turn_about_the_bones_own_axes(tmp_path):
    """The elbow has one degree of freedom, about the x of an axis frame turned by (10, 20, -90)."""
    path = save_pair(tmp_path)
    skeleton = read_asf(tmp_path / "18.asf")
    values = read_amc(path, skeleton)
    wanted = [skeleton.names.index(n) for n in ("lradius", "lwrist")]
    starts = bone_starts(skeleton, values, wanted)
    forearm = (starts[0, 1] - starts[0, 0]) * UNIT
    x, y, z = (Rotation.from_euler(axis, angle, degrees=True) for axis, angle in
               (("x", 10), ("y", 20), ("z", -90)))  # fmt: skip
    own = z * y * x  # x first, about fixed axes
    bend = Rotation.from_rotvec(own.apply([np.radians(20), 0, 0]))
    spine = own * Rotation.from_euler("x", 5, degrees=True) * own.inv()
    heading = Rotation.from_euler("y", 90, degrees=True)
    np.testing.assert_allclose(forearm, (heading * spine * bend).apply([0.19, 0, 0]), atol=1e-6)


def test_other_names_need_the_rate_and_the_axis(tmp_path):
    save_pair(tmp_path)
    for old, new in (("18", "x_a"), ("19", "x_b")):
        (tmp_path / f"{old}_01.amc").rename(tmp_path / f"{new}.amc")
    (tmp_path / "19.asf").unlink()
    with pytest.raises(MotionFileError, match="--fps"):
        read_motion(tmp_path / "x_a.amc")
    with pytest.raises(MotionFileError, match="--up"):
        read_motion(tmp_path / "x_a.amc", fps=120)
    motion = read_motion(tmp_path / "x_a.amc", fps=100, up="y")
    assert (motion.fps, motion.licence) == (100, "")


def test_another_unit_must_be_said(tmp_path):
    path = save_pair(tmp_path)
    for subject in ("18", "19"):
        asf = tmp_path / f"{subject}.asf"
        asf.write_text(asf.read_text().replace("length 0.45\n", "length 1.0\n"))
    with pytest.raises(MotionFileError, match=r"--scale 0\.056444"):
        read_motion(path)
    assert read_motion(path, scale=UNIT).frames == 4


def test_the_skeleton_is_found_by_name_or_when_it_is_the_only_one(tmp_path):
    amc = tmp_path / "18_01.amc"
    with pytest.raises(MotionFileError, match=r"18\.asf or 18_01\.asf"):
        skeleton_path(amc)
    (tmp_path / "other.asf").touch()
    assert skeleton_path(amc).name == "other.asf"
    (tmp_path / "more.asf").touch()
    with pytest.raises(MotionFileError, match="2 other"):
        skeleton_path(amc)
    (tmp_path / "18_01.asf").touch()
    assert skeleton_path(amc).name == "18_01.asf"
    (tmp_path / "18.asf").touch()
    assert skeleton_path(amc).name == "18.asf"


def test_a_trial_without_its_partner_says_which_file_is_missing(tmp_path):
    path = save_pair(tmp_path)
    (tmp_path / "19_01.amc").unlink()
    with pytest.raises(MotionFileError, match=r"19_01\.amc is not there"):
        read_motion(path)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("root -", "root x-", "expected numbers"),
        ("lfemur 0 0 0", "lfemur 0 0", r"'lfemur' has 2 numbers \(allowed: 3\)"),
        ("lfemur 0 0 0", "lfemur 0 0 inf", "not finite"),
        ("lfemur 0 0 0\n", "", "frame 0 has no 'lfemur'"),
        ("lfemur 0 0 0", "tail 0 0 0", "'tail' does not move"),
        ("lfemur 0 0 0", "ltibia 0", "'ltibia' appears twice"),
        (":DEGREES", ":RADIANS", "contradicts"),
        ("1\nroot", "root", "number of a frame"),
        ("2\nroot", "2\n3\nroot", "frame 1 has no"),
    ],
)
def test_a_damaged_motion_says_where(tmp_path, old, new, match):
    path = save_pair(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(MotionFileError, match=match):
        read_motion(path)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (" length 0.45\n", "", "no 'length' under :units"),
        (" length 0.45\n", " length -1\n", "no 'length' under :units"),
        ("angle deg", "angle gon", "allowed: deg, rad"),
        ("order TX TY TZ RX RY RZ", "order TX TY", "six-number"),
        ("axis XYZ\n", "axis XXZ\n", "root's axis"),
        ("position 0 0 0", "position 0 1 0", "position is not zero"),
        (" end\n", "", "begins inside a bone"),
        ("begin\n", "", "expected 'begin'"),
        ("  name lfemur\n", "", "no name of its own"),
        ("name lfemur", "name ltibia", "no name of its own"),
        ("name lfemur", "name root", "no name of its own"),
        ("dof rx ry rz", "dof rx rx", "degrees of freedom"),
        ("dof rx ry rz", "dof l", "degrees of freedom"),
        ("axis 10 20 -90 XYZ", "axis 10 20 -90", "needs 'axis'"),
        ("axis 10 20 -90 XYZ", "axis 10 20 -90 XYW", "axis order"),
        ("direction ", "direction 1 ", "needs 'direction'"),
        ("lhipjoint lfemur\n", "lhipjoint lfemur lfemur\n", "repeated bone 'lfemur'"),
        ("lhipjoint lfemur\n", "lhipjoint root\n", "repeated bone 'root'"),
        ("lhipjoint lfemur\n", "lhipjoint tail\n", "unknown"),
        ("lhipjoint lfemur\n", "lhipjoint lfemur\n lhipjoint ltoes\n", "listed twice"),
    ],
)
def test_a_damaged_skeleton_says_where(tmp_path, old, new, match):
    path = save_pair(tmp_path)
    text = asf_text()
    assert old in text
    (tmp_path / "18.asf").write_text(text.replace(old, new, 1))
    with pytest.raises(MotionFileError, match=match):
        read_motion(path)


def test_a_skeleton_in_radians_is_the_same_skeleton(tmp_path):
    path = save_pair(tmp_path)
    degrees = read_motion(path)
    for subject in ("18", "19"):
        asf = tmp_path / f"{subject}.asf"
        turned = "axis " + " ".join(f"{np.radians(a):.9f}" for a in (10, 20, -90)) + " XYZ"
        text = asf.read_text().replace("angle deg", "angle rad")
        asf.write_text(text.replace("axis 10 20 -90 XYZ", turned))
        amc = tmp_path / f"{subject}_01.amc"
        lines = []
        for line in amc.read_text().replace(":DEGREES", ":RADIANS").splitlines():
            words = line.split()
            first = 4 if words[0] == "root" else 1
            if len(words) > 1 and words[0] != "#":
                words[first:] = [f"{np.radians(float(w)):.9f}" for w in words[first:]]
            lines.append(" ".join(words))
        amc.write_text("\n".join(lines) + "\n")
    np.testing.assert_allclose(read_motion(path).keypoints, degrees.keypoints, atol=1e-6)
