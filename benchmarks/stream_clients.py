"""The clients whose streaming is measured, and what they are to do."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bridge.servo.bus import STREAM_LENGTH, ServoBus
from bridge.servo.registers import control_table
from bridge.servo.sdk_transport import SdkTransport
from bridge.servo.transport import Transport
from robots.registry import load_robot
from robots.spec import JointSpec

MODEL = "XM430-W350"
"""All servos are of this model."""
TABLE = control_table(MODEL)
GOAL = TABLE["goal_position"]
STREAM = [TABLE[name] for name in ("present_current", "present_velocity", "present_position")]
"""What is read, in one piece."""
PATIENCE = 1.0
"""s that an answer may be late: a virtual bus that waits for a core is no servo that is missing."""
CENTRE, SWING, STEPS = 2048, 100, 500
"""The goals: ticks, swinging about the centre, so many to a period."""


@dataclass(frozen=True, slots=True)
class Run:
    """What one process is to measure."""

    client: str
    """One of :data:`MAKERS`."""
    buses: int
    baud: int
    fast: bool
    servos: int
    """On each bus."""
    seconds: float
    """0 for a fixed number of cycles in virtual time."""
    rate: float = 0.0
    """Hz; 0 for as fast as it goes."""


class Client(Protocol):
    """Streams to one bus."""

    def begin(self, step: int) -> None:
        """Write the goals of a step and ask for the states, if that can be done without waiting."""
        ...

    def end(self) -> int:
        """Take the states; return how many servos are missing."""
        ...


def ticks_of(servos: int) -> NDArray[np.int64]:
    """Return the goals of all steps ``[S, D]`` in ticks."""
    phase = 2 * math.pi * (np.arange(STEPS)[:, None] / STEPS + np.arange(servos) / servos)
    return np.rint(CENTRE + SWING * np.sin(phase)).astype(np.int64)


class Ours:
    """A :class:`~bridge.servo.bus.ServoBus`, as the player uses it."""

    def __init__(self, port: str, run: Run, transport: Transport | None = None) -> None:
        """Open the port, or another transport."""
        transport = transport or SdkTransport(port, run.baud, patience=PATIENCE)
        self.bus = ServoBus(joints_of(run.servos), transport, fast=run.fast)
        self.bus.open()
        self.bus.identify()
        self.bus.configure()
        self.bus.hold_present(0.3)
        self.bus.torque_on()
        self._goals = self.bus.scale.from_ticks(ticks_of(run.servos))

    def write(self, step: int) -> None:
        """Write the goals of a step."""
        self.bus.write_goals(self._goals[step % STEPS])

    def begin(self, step: int) -> None:
        """Write goals and ask for states."""
        self.write(step)
        self.bus.begin_read()

    def end(self) -> int:
        """Take the states."""
        return int((~self.bus.end_read(0.0).seen).sum())


def joints_of(count: int) -> tuple[JointSpec, ...]:
    """Return ``count`` joints with servos of our model, centred in their range."""
    joint = load_robot("op3").joints[0]
    return tuple(
        replace(
            joint,
            name=f"joint_{k}",
            servo=replace(joint.servo, model=MODEL, id=k + 1, zero=CENTRE),
        )
        for k in range(count)
    )


class Rustypot:
    """The loop that rustypot's users write, with its raw calls."""

    def __init__(self, port: str, run: Run) -> None:
        """Open the port."""
        import rustypot

        self._port = rustypot.Xl430PyController(port, run.baud, PATIENCE)
        self._port.set_fast_sync_read(run.fast)
        self._ids = list(range(1, run.servos + 1))
        self._data = [
            [list(goal.to_bytes(GOAL.length, "little")) for goal in row]
            for row in ticks_of(run.servos).tolist()
        ]
        self._step = 0

    def begin(self, step: int) -> None:
        """Note the step: the calls wait for their answers."""
        self._step = step

    def end(self) -> int:
        """Write goals and read states."""
        try:
            self._port.sync_write_raw_data(self._ids, GOAL.address, self._data[self._step % STEPS])
            answers = self._port.sync_read_raw_data(self._ids, STREAM[0].address, STREAM_LENGTH)
        except RuntimeError:
            return len(self._ids)
        return len(self._ids) - len(answers)


class StockSdk:
    """The loop of the maker's own examples, by the SDK as it is installed."""

    def __init__(self, port: str, run: Run) -> None:
        """Open the port."""
        import dynamixel_sdk as sdk

        self._port = sdk.PortHandler(port)
        self._port.baudrate = run.baud
        self._port.openPort()
        packets = sdk.PacketHandler(2.0)
        self._write = sdk.GroupSyncWrite(self._port, packets, GOAL.address, GOAL.length)
        self._read = sdk.GroupSyncRead(self._port, packets, STREAM[0].address, STREAM_LENGTH)
        self._receive = self._read.fastSyncRead if run.fast else self._read.txRxPacket
        self._ids = range(1, run.servos + 1)
        for servo_id in self._ids:
            self._read.addParam(servo_id)
        self._goals = ticks_of(run.servos).tolist()
        self._step = 0

    def begin(self, step: int) -> None:
        """Note the step: the calls wait for their answers."""
        self._step = step

    def end(self) -> int:
        """Write goals and read states."""
        self._write.clearParam()
        for servo_id, goal in zip(self._ids, self._goals[self._step % STEPS], strict=True):
            self._write.addParam(servo_id, list(goal.to_bytes(GOAL.length, "little")))
        self._write.txPacket()
        if self._receive() != 0:
            return len(self._ids)
        for servo_id in self._ids:
            for register in STREAM:
                self._read.getData(servo_id, register.address, register.length)
        return 0


MAKERS: dict[str, Callable[[str, Run], Client]] = {
    "pasdedeux": Ours,
    "rustypot": Rustypot,
    "dynamixel-sdk": StockSdk,
}
