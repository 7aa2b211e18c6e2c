"""``pasdedeux robots``: list the servo robots, show one, check one's folder."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from bridge.cli.console import Console

if TYPE_CHECKING:
    from robots.spec import RobotSpec


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which robot."""
    parser.add_argument(
        "robot", nargs="?", help="a name or a folder with robot.toml; without it: list all"
    )


def execute(args: argparse.Namespace, console: Console) -> int:
    """List, or show and check; 1 if the robot breaks a promise."""
    from robots.conformance import check_robot
    from robots.registry import load_robot

    if args.robot is None:
        _list(console)
        return 0
    robot = load_robot(args.robot)
    findings = check_robot(robot)
    _show(robot, console)
    for finding in findings:
        console.show(str(finding))
    if findings:
        console.say(f"{robot.name} breaks {len(findings)} of the promises of docs/robots.md")
    else:
        console.show(_checked(robot))
    console.result(
        {
            "name": robot.name,
            "base": robot.base,
            "joints": [
                {
                    "name": joint.name,
                    "id": joint.servo.id,
                    "servo": joint.servo.model,
                    "lower": joint.lower,
                    "upper": joint.upper,
                    "rest": joint.rest,
                    "max_velocity": joint.max_velocity,
                    "max_effort": joint.max_effort,
                }
                for joint in robot.joints
            ],
            "buses": {
                bus.name: {"port": bus.port, "baud": bus.baud, "protocol": bus.protocol}
                for bus in robot.buses.values()
            },
            "findings": [
                {"rule": finding.rule, "what": finding.what, "hint": finding.hint}
                for finding in findings
            ],
        }
    )
    return 1 if findings else 0


def _list(console: Console) -> None:
    from robots.registry import load_robot, robot_names

    found = [load_robot(name) for name in robot_names()]
    console.table(
        "robots",
        ["name", "base", "joints", "servos"],
        [
            [
                r.name,
                r.base,
                str(len(r.joints)),
                ", ".join(sorted({j.servo.model for j in r.joints})),
            ]
            for r in found
        ],
    )
    console.result({"robots": [r.name for r in found]})


def _show(robot: RobotSpec, console: Console) -> None:
    console.table(
        f"{robot.name} ({robot.base} base)",
        ["joint", "id", "servo", "lower °", "upper °", "rest °", "speed rad/s"],
        [
            [
                joint.name,
                str(joint.servo.id),
                joint.servo.model,
                f"{math.degrees(joint.lower):.0f}",
                f"{math.degrees(joint.upper):.0f}",
                f"{math.degrees(joint.rest):.0f}",
                f"{joint.max_velocity:.1f}",
            ]
            for joint in robot.joints
        ],
    )
    for bus in robot.buses.values():
        console.show(f"bus {bus.name}: {bus.port} at {bus.baud} baud, protocol {bus.protocol:g}")


def _checked(robot: RobotSpec) -> str:
    """Return what retargeting will find: the robot's limbs, measured on a stage for two."""
    from bridge.retarget.build import measure
    from bridge.retarget.stage import build_stage

    stage = build_stage((robot, robot))
    build = measure(stage, stage.actors[0])
    legs = f", legs of {build.leg_length:.3f} m" if build.leg else ""
    return f"checked: two fit on one stage; arms of {build.arm_length:.3f} m{legs}"
