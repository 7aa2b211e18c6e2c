"""``pasdedeux robots``: list the servo robots, show one, check one's folder."""

from __future__ import annotations

import argparse
import math

from bridge.cli.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add which robot."""
    parser.add_argument(
        "robot", nargs="?", help="a name or a folder with robot.toml; without it: list all"
    )


def execute(args: argparse.Namespace, console: Console) -> int:
    """List, or show and check."""
    from bridge.retarget.build import measure
    from bridge.retarget.stage import build_stage
    from robots.registry import load_robot, robot_names

    if args.robot is None:
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
        return 0
    robot = load_robot(args.robot)
    stage = build_stage((robot, robot))  # refuses a model that does not fit its data
    build = measure(stage, stage.actors[0])
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
    legs = f", legs of {build.leg_length:.3f} m" if build.leg else ""
    console.show(f"checked: two fit on one stage; arms of {build.arm_length:.3f} m{legs}")
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
        }
    )
    return 0
