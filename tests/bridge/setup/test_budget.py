"""What a wire allows, and what the doctor says about it."""

from __future__ import annotations

import pytest

from bridge.doctor import examine_buses, examine_servos, mujoco_mixture
from bridge.setup.budget import FACTORY_DELAY, budgets, cycles
from bridge.setup.scan import scan
from robots.registry import load_robot
from tests.bridge.setup.rig import XL330, Rig, servo


@pytest.mark.parametrize(
    ("servos", "baud", "plain", "fast"),
    [(20, 1_000_000, 176, 229), (20, 4_000_000, 704, 917), (40, 4_000_000, None, 478)],
)
def test_cycles_are_those_of_the_protocols_bytes(servos, baud, plain, fast):
    if plain is not None:
        assert int(cycles(servos, baud)) == plain
    assert int(cycles(servos, baud, fast=True)) == fast


def test_the_factorys_return_delay_costs_most_of_a_plain_bus():
    assert cycles(20, 1_000_000, delay=FACTORY_DELAY) < 0.4 * cycles(20, 1_000_000)
    assert cycles(20, 1_000_000, delay=FACTORY_DELAY, fast=True) > 200


def test_each_bus_of_a_robot_has_its_budget():
    (op3,) = budgets(load_robot("op3"))
    assert (op3.bus, op3.servos, op3.baud) == ("main", 20, 2_000_000)
    assert int(op3.plain) == 352
    assert op3.factory < op3.plain < op3.best


@pytest.mark.parametrize(("rate", "status"), [(100, "ok"), (400, "note"), (900, "fail")])
def test_a_rate_is_judged_against_the_wire(rate, status):
    (finding,) = examine_buses(load_robot("op3"), rate)
    assert finding.status == status
    assert f"{rate} Hz wanted" in finding.detail
    assert (finding.hint == "") == (status == "ok")


def test_servos_on_a_port_are_compared_with_the_robot_and_their_delay_noted():
    robot = load_robot("marionette")
    all_there = Rig([servo(joint.servo.id, 1_000_000, XL330) for joint in robot.joints])
    findings = examine_servos(robot, "main", scan(all_there.line, [1_000_000]))
    assert findings[0].status == "ok"
    assert all("return delay 500 us" in finding.detail for finding in findings[1:])
    findings = examine_servos(robot, "main", scan(Rig([]).line, [1_000_000]))
    assert {finding.status for finding in findings} == {"fail"}
    assert len(findings) == len(robot.joints)


@pytest.mark.parametrize(
    ("found", "status"),
    [
        ({"mujoco": "3.17.0"}, "ok"),
        ({"mujoco": "4.1.0", "mujoco-core": "4.1.0", "mujoco-studio": "4.1.0"}, "ok"),
        ({"mujoco": "3.17.0", "mujoco-core": "4.1.0"}, "fail"),
        ({"mujoco": "4.0.0", "mujoco-core": "4.0.0"}, "fail"),
        ({"mujoco": "4.1.0", "mujoco-core": "4.0.0"}, "fail"),
    ],
)
def test_parts_of_several_mujocos_are_told_apart_from_one(found, status):
    (finding,) = mujoco_mixture(found)
    assert finding.status == status
    assert bool(finding.hint) == (status == "fail")
