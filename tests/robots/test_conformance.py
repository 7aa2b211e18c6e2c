"""Robots broken on purpose: each rule notices what breaks it, and says where."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.conformance import RULES, check_robot
from robots.registry import load_robot
from robots.spec import RobotSpec

TOML, XML = "robot.toml", "robot.xml"
BROKEN = [
    # rule, says, robot, changes: file, old, new
    ("compiles", "MuJoCo refuses it", "marionette", [(XML, 'type="sphere"', 'type="spere"')]),
    ("compiles", "MuJoCo refuses it", "op3", [(XML, 'mass=".07"', 'mass="0"')]),
    ("radian", "in degrees", "marionette", [(XML, 'angle="radian"', 'angle="degree"')]),
    ("radian", "in degrees", "marionette", [(XML, 'angle="radian" ', "")]),
    ("joints", "range of 'waist'", "marionette", [(XML, "-1.570796 1.570796", "-1.5 1.570796")]),
    ("joints", "range of 'r_knee'", "op3", [(TOML, '"-126deg", "18deg"', '"-126deg", "19deg"')]),
    (
        "joints",
        "no hinge 'r_elbow'; did you mean 'r_elbwo'?",
        "marionette",
        [(XML, '"r_elbow"', '"r_elbwo"')],
    ),
    ("joints", "no servo drives hinge 'waist'", "marionette", [(TOML, "waist = {", "# {")]),
    (
        "joints",
        "no range",
        "op3",
        [
            (
                XML,
                'name="head_pan" axis="0 0 1" range="-1.570796 1.570796"',
                'name="head_pan" axis="0 0 1"',
            ),
            (XML, '<position class="xm430" name="head_pan" joint="head_pan"/>', ""),
        ],
    ),
    (
        "joints",
        "neither a hinge nor a free base",
        "marionette",
        [
            (
                XML,
                '<joint name="waist"',
                '<joint type="slide" name="lift" range="0 1"/><joint name="waist"',
            )
        ],
    ),
    ("base", "no free joint", "marionette", [(TOML, 'base = "fixed"', 'base = "free"')]),
    ("base", "a free joint", "op3", [(TOML, 'base = "free"', 'base = "fixed"')]),
    (
        "base",
        "2 bodies stand in the world",
        "op3",
        [
            (
                XML,
                "</worldbody>",
                '<body name="ball"><freejoint/><geom size=".1"/></body></worldbody>',
            )
        ],
    ),
    (
        "base",
        "1 shapes lie in the world",
        "op3",
        [(XML, "<worldbody>", '<worldbody><geom type="plane" size="1 1 1"/>')],
    ),
    (
        "masses",
        "'base' has no mass",
        "marionette",
        [
            (XML, 'mass=".35"', 'mass="0"'),
            (XML, 'mass=".04"', 'mass="0"'),
            (
                XML,
                'size=".017 .013 .014" pos="0 0 .088" mass=".018"',
                'size=".017 .013 .014" pos="0 0 .088" mass="0"',
            ),
        ],
    ),
    (
        "masses",
        "weighs 350.4 kg",
        "marionette",
        [(XML, 'mass=".35"', 'mass="350"')],
    ),
    (
        "shapes",
        "'head' carries a landmark",
        "marionette",
        [
            (XML, 'size=".027"', 'size=".027" contype="0"'),
            (XML, 'size=".021 .006"', 'size=".021 .006" contype="0"'),
        ],
    ),
    (
        "rest pose",
        "overlap by",
        "op3",
        [
            (TOML, '"54deg"], rest = "-75deg"', '"54deg"], rest = "-90deg"'),
            (TOML, 'rest = "-10deg"', 'rest = "30deg"'),
        ],
    ),
    ("standing", "8.3 mm above the floor", "op3", [(XML, "0 0 .3717", "0 0 .38")]),
    ("standing", "more than 50.0 mm above", "op3", [(XML, "0 0 .3717", "0 0 .5")]),
    ("standing", "11.7 mm inside the floor", "op3", [(XML, "0 0 .3717", "0 0 .36")]),
    (
        "standing",
        "'r_ank_roll_link' stands on an edge",
        "op3",
        [
            (
                XML,
                '<body name="r_ank_roll_link">',
                '<body name="r_ank_roll_link" euler="0.15 0 0" pos="0 0 .005">',
            )
        ],
    ),
    (
        "standing",
        "outside the soles' outline",
        "op3",
        [(XML, 'pos="-.004 0 -.005"', 'pos="-.6 0 -.005"')],
    ),
    (
        "standing",
        "'base' is 5.0 mm above",
        "marionette",
        [(XML, 'pos="0 0 .01" mass', 'pos="0 0 .015" mass')],
    ),
    (
        "standing",
        "'base' is 3.0 mm inside",
        "marionette",
        [(XML, 'pos="0 0 .01" mass', 'pos="0 0 .007" mass')],
    ),
    (
        "standing",
        "inside the floor",
        "marionette",
        [
            (TOML, '"95deg"], rest = "72deg"', '"95deg"], rest = "95deg"'),
            (XML, 'pos="0 0 .105"', 'pos="0 0 .0"'),
        ],
    ),
    ("landmarks", "'left_hand' is missing", "marionette", [(TOML, "left_hand = {", "# {")]),
    ("landmarks", "'left_knee' is missing", "op3", [(TOML, "left_knee = {", "# {")]),
    (
        "landmarks",
        "'left_hnad' is no point of a human; did you mean 'left_hand'?",
        "marionette",
        [(TOML, "left_hand = {", "left_hnad = {")],
    ),
    (
        "landmarks",
        "on body 'heda', which the MJCF does not have; did you mean 'head'?",
        "marionette",
        [(TOML, 'head = { body = "head"', 'head = { body = "heda"')],
    ),
    (
        "symmetry",
        "'left_hand' is 10.0 mm from",
        "marionette",
        [(TOML, "[0.0, 0.11, 0.0]", "[0.0, 0.12, 0.0]")],
    ),
    (
        "symmetry",
        "its own mirror image",
        "marionette",
        [(TOML, "[0.0, 0.0, 0.026]", "[0.0, 0.01, 0.026]")],
    ),
    (
        "symmetry",
        "different radii",
        "marionette",
        [(TOML, "[0.0, 0.11, 0.0], radius = 0.012", "[0.0, 0.11, 0.0], radius = 0.02")],
    ),
    (
        "t-pose",
        "'left_elbow' to 'left_hand' does not point along +y",
        "marionette",
        [
            (TOML, "[0.0, 0.11, 0.0]", "[0.03, 0.106, 0.0]"),
            (TOML, "[0.0, -0.11, 0.0]", "[0.03, -0.106, 0.0]"),
        ],
    ),
    ("t-pose", "'chest' to 'head'", "op3", [(TOML, "[0.0, 0.0, 0.06]", "[-0.4, 0.0, 0.06]")]),
    ("t-pose", "the left foot does not point along +x", "op3", [(TOML, "[0.045", "[-0.045")]),
    (
        "pair",
        "drops what the MJCF sets",
        "op3",
        [(XML, "<default>", '<size nuser_body="3"/><default>')],
    ),
    (
        "pair",
        "drops what the MJCF sets",
        "marionette",
        [(XML, "<default>", '<option cone="elliptic"/><default>')],
    ),
]


def broken(tmp_path: Path, name: str, changes: list[tuple[str, str, str]]) -> RobotSpec:
    """Return a copy of a robot in which every ``old`` text is replaced by ``new``."""
    original = load_robot(name).folder
    for file in (TOML, XML):
        text = (original / file).read_text("utf-8")
        for where, old, new in changes:
            if where == file:
                assert old in text, old
                text = text.replace(old, new)
        (tmp_path / file).write_text(text, "utf-8")
    return load_robot(tmp_path)


@pytest.mark.parametrize(("rule", "says", "name", "changes"), BROKEN)
def test_a_broken_robot_is_found(tmp_path: Path, rule: str, says: str, name: str, changes):
    found = [str(finding) for finding in check_robot(broken(tmp_path, name, changes))]
    assert any(text.startswith(f"{rule}: ") and says in text for text in found), found


def test_every_rule_has_a_robot_that_breaks_it():
    assert {rule for rule, *_ in BROKEN} == {"compiles", *RULES}


def test_one_fault_gives_one_finding(tmp_path: Path):
    robot = broken(
        tmp_path, "marionette", [(TOML, 'limit = [0, "135deg"]', 'limit = [0, "130deg"]')]
    )
    assert [(f.rule, "elbow" in f.what) for f in check_robot(robot)] == [("joints", True)] * 2


@pytest.mark.parametrize(
    "xml",
    [
        "<mujoco/>",
        '<mujoco><worldbody><geom size=".1"/></worldbody></mujoco>',
        '<mujoco><worldbody><body><geom size=".1"/></body></worldbody></mujoco>',
    ],
)
@pytest.mark.parametrize("name", ["op3", "marionette"])
def test_a_model_of_nothing_gives_findings_and_no_other_error(tmp_path: Path, name: str, xml: str):
    (tmp_path / TOML).write_bytes((load_robot(name).folder / TOML).read_bytes())
    (tmp_path / XML).write_text(xml, "utf-8")
    rules = {finding.rule for finding in check_robot(load_robot(tmp_path))}
    assert {"joints", "landmarks"} <= rules


def test_the_command_reports_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    from bridge.cli import main

    assert main(["robots", "marionette", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["findings"] == []
    broken(tmp_path, "marionette", [(TOML, "[0.0, 0.11, 0.0]", "[0.0, 0.12, 0.0]")])
    assert main(["robots", str(tmp_path)]) == 1
    assert "symmetry: 'left_hand' is 10.0 mm from" in capsys.readouterr().out
    assert main(["robots", str(tmp_path), "--json"]) == 1
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert finding["rule"] == "symmetry"


@settings(max_examples=60, deadline=None)
@given(name=st.sampled_from(["op3", "marionette"]), data=st.data())
def test_a_model_with_a_part_torn_out_never_ends_in_another_error(
    name: str, data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
):
    folder = load_robot(name).folder
    tree = ElementTree.parse(folder / XML)
    parents = {child: parent for parent in tree.iter() for child in parent}
    victim = data.draw(st.sampled_from(list(parents)))
    place = tmp_path_factory.mktemp("torn")
    parents[victim].remove(victim)
    tree.write(place / XML)
    (place / TOML).write_bytes((folder / TOML).read_bytes())
    findings = check_robot(load_robot(place))
    assert {finding.rule for finding in findings} <= {"compiles", *RULES}
    if victim.tag == "joint" and "range" in victim.attrib:
        assert findings
