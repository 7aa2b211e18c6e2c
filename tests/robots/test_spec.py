"""Robot folders: what is read, and what is refused with which words."""

from __future__ import annotations

import contextlib
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.errors import SpecError
from robots.mjcf import load_mjspec, scan_mjcf
from robots.registry import load_robot, read_robot, robot_names
from robots.servos import SERVO_MODELS
from robots.spec import ServoSpec

TOML = """
schema = 1
name = "twig"
base = "fixed"
[defaults]
servo = "XL330-M288"
p = 400
[bus.main]
port = "/dev/ttyUSB0"
baud = 1_000_000
[joint]
shoulder = { id = 1, limit = ["-90deg", 1.0], rest = "45deg" }
elbow = { id = 2, limit = [0, "135deg"], direction = -1, zero = 3072, ratio = 1.0, p = 200 }
[landmark]
chest = "root"
left_hand = { body = "arm", pos = [0.1, 0, 0], radius = 0.01 }
"""
XML = """<mujoco><compiler angle="radian"/><worldbody><body name="root"><geom size=".01"/>
<joint name="shoulder" axis="0 0 1"/><body name="arm" pos=".1 0 0"><joint name="elbow"/>
<geom size=".01"/></body></body></worldbody></mujoco>"""


def folder(tmp_path: Path, toml: str = TOML, xml: str = XML) -> Path:
    (tmp_path / "robot.toml").write_text(toml, "utf-8")
    (tmp_path / "robot.xml").write_text(xml, "utf-8")
    return tmp_path


def test_a_folder_becomes_a_robot(tmp_path: Path):
    robot = load_robot(folder(tmp_path))
    assert robot.joint_names == ("shoulder", "elbow")
    shoulder, elbow = robot.joints
    assert (shoulder.lower, shoulder.upper) == pytest.approx((-math.pi / 2, 1.0))
    assert shoulder.rest == pytest.approx(math.pi / 4)
    assert shoulder.servo == ServoSpec(1, "XL330-M288", "main", p=400)
    assert (elbow.servo.direction, elbow.servo.zero, elbow.servo.p) == (-1, 3072, 200)
    assert elbow.max_velocity == pytest.approx(103 * 2 * math.pi / 60)
    assert elbow.max_effort == pytest.approx(0.52)
    assert robot.buses["main"].baud == 1_000_000
    assert robot.landmark("left_hand").pos == (0.1, 0.0, 0.0)
    assert load_mjspec(robot).compile().nq == 2


def test_a_robot_may_be_named_by_its_file(tmp_path: Path):
    assert load_robot(folder(tmp_path) / "robot.toml").name == "twig"


def test_a_gear_trades_speed_for_torque(tmp_path: Path):
    text = TOML.replace("ratio = 1.0", "ratio = 0.5").replace("zero = 3072", "zero = 2048")
    geared = load_robot(folder(tmp_path, text)).joint("elbow")
    hardware = SERVO_MODELS["XL330-M288"]
    assert geared.max_velocity == pytest.approx(2 * hardware.no_load_speed)
    assert geared.max_effort == pytest.approx(0.5 * hardware.stall_torque)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('base = "fixed"', 'bsae = "fixed"', "did you mean 'base'"),
        ("schema = 1", "schema = 2", "schema 2"),
        ("schema = 1", "", "key 'schema' is missing"),
        ('servo = "XL330-M288"', 'servo = "XL330-M228"', "did you mean 'XL330-M288'"),
        ("p = 400", "pp = 400", "unknown key 'pp'"),
        ("id = 1", "id = 2", "also that of joint.shoulder"),
        ("id = 1", "id = 300", "0 to 252"),
        ("id = 1", 'id = "1"', "a whole number"),
        ("id = 1", "id = true", "a whole number"),
        ('rest = "45deg"', 'rest = "99deg"', "outside the limit"),
        ('rest = "45deg"', 'rest = "45 grad"', "is not an angle"),
        ('rest = "45deg"', "rest = nan", "is not an angle"),
        ('rest = "45deg"', 'rset = "45deg"', "did you mean 'rest'"),
        ('["-90deg", 1.0]', '["-90deg"]', "not a pair"),
        ('["-90deg", 1.0]', '[1.0, "-90deg"]', "is empty"),
        ('["-90deg", 1.0]', '["-190deg", 1.0]', "beyond what servo 1 reaches"),
        ("direction = -1", "direction = 0", "1 or -1"),
        ("zero = 3072", 'bus = "mian"', "did you mean 'main'"),
        ("zero = 3072", "zero = 9999", "0 to 4095"),
        ("ratio = 1.0", "ratio = 0", "0.01 to 100"),
        ("p = 200", 'mode = "postion"', "did you mean 'position'"),
        ("baud = 1_000_000", "baud = 1", "9600"),
        ("baud = 1_000_000", "", "key 'baud' is missing"),
        ("[bus.main]", "[bus.Main]", "letters a-z"),
        ('name = "twig"', 'name = "../twig"', "letters a-z"),
        ('name = "twig"', 'name = "twig"\nmodel = "../robot.xml"', "leaves the robot's folder"),
        ('name = "twig"', 'name = "twig"\nmodel = "other.xml"', "no file 'other.xml'"),
        ('name = "twig"', 'name = "twig"\nmodel = "a\\u0000b"', "not a usable file name"),
        ("radius = 0.01", "radius = -1", "0 to 1 m"),
        ("pos = [0.1, 0, 0]", "pos = [0.1, 0]", "three numbers"),
        ('chest = "root"', "chest = 3", "neither a body name nor a table"),
        ('base = "fixed"', 'base = "floating"', "free, fixed"),
        ("[defaults]", "[defaults", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, says: str):
    assert old in TOML
    with pytest.raises(SpecError) as caught:
        read_robot(folder(tmp_path, TOML.replace(old, new, 1)))
    assert says in str(caught.value)


def test_an_unknown_robot_names_the_nearest():
    with pytest.raises(SpecError, match="did you mean 'op3'"):
        load_robot("op4")
    with pytest.raises(SpecError, match="marionette"):
        load_robot("/nowhere/at/all")


def test_missing_and_binary_files_are_refused(tmp_path: Path):
    with pytest.raises(SpecError, match="cannot be read"):
        read_robot(tmp_path)
    (tmp_path / "robot.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SpecError, match="not valid TOML"):
        read_robot(tmp_path)


@pytest.mark.parametrize(
    ("xml", "says"),
    [
        (
            '<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]><mujoco>&x;</mujoco>',
            "document types",
        ),
        ('<mujoco><include file="/etc/passwd"/></mujoco>', "leaves the robot's folder"),
        ('<mujoco><include file="../outside.xml"/></mujoco>', "leaves the robot's folder"),
        ('<mujoco><asset><mesh file="../../m.stl"/></asset></mujoco>', "leaves the robot's folder"),
        (
            '<mujoco><compiler meshdir="/usr"/><asset><mesh file="m.stl"/></asset></mujoco>',
            "leaves the robot's folder",
        ),
        (
            '<mujoco><asset><texture type="cube" fileright="/etc/hosts"/></asset></mujoco>',
            "leaves the robot's folder",
        ),
        ('<mujoco><asset><mesh file="gone.stl"/></asset></mujoco>', "no file 'gone.stl'"),
        ('<mujoco><asset><model file="../m.xml"/></asset></mujoco>', "leaves the robot's folder"),
        ('<mujoco><extension><plugin plugin="x"/></extension></mujoco>', "plug-ins"),
        ("<robot/>", "starts with <robot>"),
        ("<mujoco>", "not valid XML"),
        ("", "not valid XML"),
    ],
)
def test_hostile_models_are_refused_before_mujoco_sees_them(tmp_path: Path, xml: str, says: str):
    with pytest.raises(SpecError, match=says):
        read_robot(folder(tmp_path, xml=xml))


def test_includes_inside_the_folder_are_followed_and_scanned(tmp_path: Path):
    part = '<mujocoinclude><body name="x"><geom size=".1"/></body></mujocoinclude>'
    main = '<mujoco><worldbody><include file="part.xml"/></worldbody></mujoco>'
    (tmp_path / "part.xml").write_text(part)
    (tmp_path / "main.xml").write_text(main)
    scan_mjcf(tmp_path / "main.xml", tmp_path)
    (tmp_path / "part.xml").write_text(part.replace("<body", '<include file="/etc/x"/><body'))
    with pytest.raises(SpecError, match="leaves the robot's folder"):
        scan_mjcf(tmp_path / "main.xml", tmp_path)


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path):
    robot = tmp_path / "robot"
    robot.mkdir()
    folder(robot)
    (tmp_path / "outside.xml").write_text(XML)
    (robot / "robot.xml").unlink()
    os.symlink(tmp_path / "outside.xml", robot / "robot.xml")
    with pytest.raises(SpecError, match="leaves the robot's folder"):
        read_robot(robot)


def test_what_mujoco_refuses_comes_out_as_our_error(tmp_path: Path):
    bad = XML.replace("<body name", '<bodyy nosuch="1"/><body name', 1)
    robot = read_robot(folder(tmp_path, xml=bad))
    with pytest.raises(SpecError, match="MuJoCo refuses it"):
        load_mjspec(robot)


@settings(max_examples=150, deadline=None)
@given(cut=st.integers(0, len(TOML)), junk=st.text(max_size=8))
def test_mutilated_toml_gives_our_error_or_a_robot(cut: int, junk: str, tmp_path_factory):
    place = tmp_path_factory.mktemp("robot")
    with contextlib.suppress(SpecError):
        read_robot(folder(place, TOML[:cut] + junk + TOML[cut + len(junk) :]))


@given(
    direction=st.sampled_from([-1, 1]),
    zero=st.integers(0, 4095),
    ratio=st.floats(0.25, 8),
)
def test_the_reach_of_a_servo_is_what_its_ticks_allow(direction: int, zero: int, ratio: float):
    servo = ServoSpec(1, "XM430-W350", "main", direction, zero, ratio)
    ticks = sorted(zero + direction * ratio * angle * 4096 / (2 * math.pi) for angle in servo.reach)
    assert ticks == pytest.approx([0, 4095], abs=1e-6)


def test_joint_arrays_come_in_the_order_of_the_joints():
    for name in robot_names():
        robot = load_robot(name)
        for i, joint in enumerate(robot.joints):
            assert (robot.lower[i], robot.upper[i]) == (joint.lower, joint.upper)
            assert robot.max_velocity[i] == joint.max_velocity
            assert robot.max_effort[i] == joint.max_effort
        assert np.all(robot.rest <= robot.upper)


def test_a_robot_cannot_be_changed_into_a_wrong_one():
    robot = load_robot("marionette")
    with pytest.raises(SpecError, match="two joints are named"):
        replace(robot, joints=robot.joints + robot.joints[:1])
    with pytest.raises(SpecError, match="did you mean 'left_hand'"):
        robot.landmark("left_hnad")
    with pytest.raises(SpecError, match="did you mean 'waist'"):
        robot.joint("waste")
