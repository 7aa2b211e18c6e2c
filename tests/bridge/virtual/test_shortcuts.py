"""What the virtual bus does in a short way comes out as if it were done in the long one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import pytest
import serial

from bridge.servo import packets
from bridge.servo.packets import instruction
from bridge.servo.registers import ControlTable, control_table
from bridge.virtual import Fault, FaultPlan, PtyServer, VirtualBus, VirtualServo
from bridge.virtual.drive import Drive

MODELS = ("XM430-W350", "XL430-W250", "XL330-M288", "XH540-W150")
BROADCAST = packets.BROADCAST
SETTINGS: dict[str, Callable[[np.random.Generator], int]] = {
    "torque_enable": lambda rng: int(rng.random() < 0.8),
    "profile_velocity": lambda rng: int(rng.integers(0, 300)),
    "profile_acceleration": lambda rng: int(rng.choice([0, 0, 0, 5, 60])),
    "bus_watchdog": lambda rng: int(rng.choice([0, 0, 5, 20])),
    "goal_position": lambda rng: int(rng.integers(-100, 4300)),
    "operating_mode": lambda rng: int(rng.choice([3, 3, 3, 1, 4, 16])),
    "drive_mode": lambda rng: int(rng.choice([0, 0, 0, 1, 4, 8])),
    "status_return_level": lambda rng: int(rng.choice([2, 2, 2, 1, 0])),
    "homing_offset": lambda rng: int(rng.integers(-200, 200)),
    "min_position_limit": lambda rng: int(rng.integers(0, 500)),
    "max_position_limit": lambda rng: int(rng.integers(3000, 4096)),
    "return_delay_time": lambda rng: int(rng.choice([0, 10, 250])),
}
"""Registers that the short ways depend on, with random values for them."""


class LongDrive(Drive):
    """A drive that takes single steps."""

    def _is_plain(self) -> bool:
        return False


class LongWay(VirtualServo):
    """A servo that checks every goal, steps at every packet and publishes at every read."""

    def __init__(self, table: ControlTable, servo_id: int, *, angle: float) -> None:
        super().__init__(table, servo_id, angle=angle, drive=LongDrive(table, angle))

    @property
    def due(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        return -math.inf

    @due.setter
    def due(self, value: float) -> None:
        pass

    def _goals_without_rule(self) -> tuple[int, int]:
        return 0, -1

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        self._map._shown = (math.nan, math.nan, math.nan)
        return super().read(address, length)


def word(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def random_packet(rng: np.random.Generator, count: int) -> bytes:
    """Return one packet for ``count`` servos: mostly what a player sends, and what disturbs it."""
    ids = [int(k) for k in rng.permutation(count)[: int(rng.integers(1, count + 1))] + 1]
    kind = rng.random()
    if kind < 0.4:
        low, high = (0, 4096) if rng.random() < 0.9 else (-2000, 9000)
        goals = [
            int(goal).to_bytes(4, "little", signed=True) for goal in rng.integers(low, high, 9)
        ]
        params = b"".join(bytes((k,)) + goal for k, goal in zip(ids, goals, strict=False))
        return instruction(BROADCAST, packets.SYNC_WRITE, word(116, 4) + params)
    if kind < 0.7:
        code = packets.SYNC_READ if rng.random() < 0.5 else packets.FAST_SYNC_READ
        block = [(126, 10), (132, 4), (116, 20), (60, 90)][int(rng.integers(4))]
        return instruction(BROADCAST, code, word(*block) + bytes(ids))
    if kind < 0.95:
        name = list(SETTINGS)[int(rng.integers(len(SETTINGS)))]
        register = control_table(MODELS[0])[name]
        data = register.encode(SETTINGS[name](rng))
        return instruction(ids[0], packets.WRITE, word(register.address) + data)
    if kind < 0.97:
        return instruction(ids[0], packets.REBOOT)
    return rng.bytes(int(rng.integers(1, 40)))


def outcome(kind: type[VirtualServo], seed: int, count: int) -> list[object]:
    """Return all answers to random packets, and where the servos are in the end."""
    rng = np.random.default_rng(seed)
    servos = [
        kind(control_table(model), k + 1, angle=float(rng.uniform(-1, 1)))
        for k, model in enumerate(MODELS)
    ]
    faults = FaultPlan(
        [Fault("hardware", start=3.0, servo_id=2), Fault("silence", 4.0, 4.5, servo_id=3)]
    )
    bus = VirtualBus(servos, baud=1_000_000, faults=faults)
    now, result = 0.0, []
    for _ in range(count):
        now += float(rng.choice([1e-4, 1.1e-3, 2e-3, 7.3e-3, 0.02, 0.11]))
        result += bus.feed(now, random_packet(rng, len(servos)))
    ends = [(servo.angle, servo.motor.velocity, servo.motor.temperature) for servo in servos]
    return [*result, *ends]


@pytest.mark.parametrize("seed", range(4))
def test_random_packets_are_answered_as_if_nothing_were_cut_short(seed):
    assert outcome(VirtualServo, seed, 250) == outcome(LongWay, seed, 250)


def test_a_goal_beyond_new_limits_does_not_slip_through():
    """The range of goals that need no check must follow the limits."""
    servo = VirtualServo(control_table(MODELS[0]), 1)
    table = servo.table
    limit = table["max_position_limit"]
    assert servo.write(table["goal_position"].address, (3500).to_bytes(4, "little")) == 0
    assert servo.write(limit.address, limit.encode(3000)) == 0
    error = servo.write(table["goal_position"].address, (3500).to_bytes(4, "little"))
    assert error == packets.ERROR_LIMIT


def test_answers_come_in_one_piece_and_not_before_their_bytes_can():
    """At 57600 bit/s three statuses of 21 bytes and the request of 17 take 13.9 ms."""
    servos = [VirtualServo(control_table(MODELS[0]), k + 1) for k in range(3)]
    for servo in servos:
        servo.memory.set("return_delay_time", 0)
    request = instruction(BROADCAST, packets.SYNC_READ, word(126, 10) + bytes((1, 2, 3)))
    with (
        PtyServer(VirtualBus(servos), timing=True) as server,
        serial.Serial(server.port, 57600, timeout=20) as port,
    ):
        begin = time.monotonic()
        port.write(request)
        answer = port.read(3 * 21)
        passed = time.monotonic() - begin
    assert [answer[at + 4] for at in (0, 21, 42)] == [1, 2, 3]
    assert passed >= (len(request) + len(answer)) * 10 / 57600
