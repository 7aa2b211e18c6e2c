"""A virtual bus in a process of its own, so that it does not compete with the player for Python.

Two threads of one interpreter take turns: a bus that computes delays a player that is due, by
milliseconds. A real bus does not. The child serves a robot's bus on a pseudo-terminal and ends when
its standard input closes, which also happens when the parent dies.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from bridge.virtual.build import virtual_bus_for
from bridge.virtual.plant import SERVO, require_plant
from robots.errors import PortLost
from robots.registry import load_robot
from robots.spec import RobotSpec

START_TIME = 30.0
"""Longest time that the child may take to start, s."""


@contextmanager
def virtual_port(robot: RobotSpec, bus: str, plant: str = SERVO) -> Iterator[str]:
    """Yield the port of a virtual bus with a robot's servos, with the timing of its bit rate.

    It runs in a child process if the robot is just what its folder says, else in a thread.

    Args:
        robot: The robot.
        bus: Name of its bus.
        plant: What moves, one of :data:`~bridge.virtual.plant.PLANTS`.

    Raises:
        PortLost: The child did not start, or there are no pseudo-terminals here.
        SpecError: There is no such plant, or it is none for this robot.
    """
    from bridge.virtual import PtyServer  # which not every system has

    require_plant(plant, robot)
    if load_robot(str(robot.folder)) != robot:
        with PtyServer(virtual_bus_for(robot, bus, plant=plant), timing=True) as server:
            yield server.port
        return
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = "from bridge.virtual.process import main; main()"
    child = subprocess.Popen(  # noqa: S603 - our own interpreter and code
        [sys.executable, "-c", command, str(robot.folder), bus, plant],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        text=True,
        # Ctrl-C is for the player: the bus must live on until it has relaxed its robots.
        start_new_session=True,
    )
    try:
        yield _announced_port(child, robot.name)
    finally:
        if child.stdin is not None:
            child.stdin.close()
        try:
            child.wait(timeout=5)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        if child.stdout is not None:
            child.stdout.close()


def _announced_port(child: subprocess.Popen[str], name: str) -> str:
    lines: list[str] = []

    def listen() -> None:
        if child.stdout is not None:
            lines.append(child.stdout.readline().strip())

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    listener.join(START_TIME)
    if not lines or not lines[0]:
        raise PortLost("did not start", where=f"virtual bus of {name}")
    return lines[0]


def main() -> None:
    """Serve the bus named on the command line until standard input closes."""
    from bridge.virtual import PtyServer

    folder, bus, plant = sys.argv[1:4]
    gc.freeze()  # what is loaded by now stays: a sweep over it would delay answers
    served = virtual_bus_for(load_robot(folder), bus, plant=plant)
    with PtyServer(served, timing=True) as server:
        sys.stdout.write(f"{server.port}\n")
        sys.stdout.flush()
        sys.stdin.read()
