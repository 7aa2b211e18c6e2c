"""How fast the servo client streams, against the limit of the wire.

    python benchmarks/stream.py [--seconds 3] [--servos 20] [--json]

One virtual bus in its own process, with the wire's timing and without return delay, is written to
(Sync Write of goals) and read from (10 bytes: current, velocity, position; by Sync Read, then by
Fast Sync Read) as fast as it goes. The limit is what the bytes alone need at ten bits each. Then
two buses are led at a fixed rate, as the player does it, and the time between their commands is
measured.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from bridge.servo.bus import STREAM_LENGTH, ServoBus
from bridge.servo.packets import FAST_OVERHEAD
from bridge.servo.registers import BAUD_RATES, control_table
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import PtyServer, VirtualBus, VirtualServo
from robots.registry import load_robot
from robots.spec import JointSpec

STATUS_BYTES, INSTRUCTION_BYTES, FAST_HEAD = 11, 14, 8
GOAL_BYTES = 4


def wire_limit(servos: int, baud: int, *, fast: bool) -> float:
    """Return the cycles per second that the bytes of one write and one read leave room for."""
    size = 2 * INSTRUCTION_BYTES + servos * (1 + GOAL_BYTES) + servos
    if fast:
        size += FAST_HEAD + servos * (FAST_OVERHEAD + STREAM_LENGTH)
    else:
        size += servos * (STATUS_BYTES + STREAM_LENGTH)
    return baud / (10 * size)


def joints_of(count: int) -> tuple[JointSpec, ...]:
    """Return ``count`` joints with XM430-W350 servos."""
    joint = load_robot("op3").joints[0]
    return tuple(
        replace(joint, name=f"joint_{k}", servo=replace(joint.servo, id=k + 1))
        for k in range(count)
    )


def serve(count: int, baud: int) -> None:
    """Serve ``count`` servos until standard input closes; the child's side."""
    table = control_table("XM430-W350")
    servos = [VirtualServo(table, k + 1, baud_index=BAUD_RATES.index(baud)) for k in range(count)]
    with PtyServer(VirtualBus(servos), timing=True) as server:
        print(server.port, flush=True)
        sys.stdin.read()


def start(stack: ExitStack, count: int, baud: int, *, fast: bool = True) -> ServoBus:
    """Return a configured and armed bus, served by a process of its own."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    child = subprocess.Popen(
        [sys.executable, str(Path(__file__)), "--serve", str(count), str(baud)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    stack.callback(child.wait)
    assert child.stdin is not None
    assert child.stdout is not None
    stack.callback(child.stdin.close)
    transport = SdkTransport(child.stdout.readline().strip(), baud)
    bus = ServoBus(joints_of(count), transport, fast=fast)
    bus.open()
    stack.callback(bus.close)
    bus.identify()
    bus.configure()
    bus.hold_present(0.1)
    bus.torque_on()
    return bus


def saturate(count: int, baud: int, seconds: float, *, fast: bool) -> dict[str, float]:
    """Return how fast one bus goes and how much of a core the client takes."""
    with ExitStack() as stack:
        bus = start(stack, count, baud, fast=fast)
        goal = bus.positions()
        cycles = missed = 0
        begin, used = time.perf_counter(), time.process_time()
        while (passed := time.perf_counter() - begin) < seconds:
            bus.write_goals(goal)
            bus.begin_read()
            missed += int((~bus.end_read(0.0).seen).sum())
            cycles += 1
        used = time.process_time() - used
        reads_fast = float(bus.reads_fast)
    limit = wire_limit(count, baud, fast=fast)
    return {
        "baud": baud,
        "fast": reads_fast,
        "hz": cycles / passed,
        "wire_limit_hz": limit,
        "share": cycles / passed / limit,
        "client_core": used / passed,
        "missed": missed,
    }


def pace(count: int, baud: int, rate: float, seconds: float) -> dict[str, float]:
    """Return how evenly two buses are led at a fixed rate."""
    with ExitStack() as stack:
        buses = [start(stack, count, baud) for _ in range(2)]
        goals = [bus.positions() for bus in buses]
        skew, late, missed, dropped, tick = [], [], 0, 0, 0
        begin = time.monotonic()
        while tick < rate * seconds:
            deadline = begin + tick / rate
            time.sleep(max(0.0, deadline - time.monotonic()))
            late.append(time.monotonic() - deadline)
            sent = []
            for bus, goal in zip(buses, goals, strict=True):
                bus.write_goals(goal)
                sent.append(time.monotonic())
            for bus in buses:
                bus.begin_read()
            missed += sum(int((~bus.end_read(0.0).seen).sum()) for bus in buses)
            skew.append(sent[1] - sent[0])
            following = max(tick + 1, int(np.ceil((time.monotonic() - begin) * rate)))
            dropped += following - tick - 1
            tick = following
    return {
        "baud": baud,
        "rate": rate,
        "ticks": len(late),
        "dropped": dropped,
        "missed": missed,
        "jitter_p99_ms": 1e3 * float(np.percentile(late, 99)),
        "skew_p50_ms": 1e3 * float(np.percentile(skew, 50)),
        "skew_p99_ms": 1e3 * float(np.percentile(skew, 99)),
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description="Streaming rate of the servo client")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--servos", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--serve", nargs=2, type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(*args.serve)
        return
    full = [
        saturate(args.servos, baud, args.seconds, fast=fast)
        for fast in (False, True)
        for baud in (1_000_000, 2_000_000, 4_000_000)
    ]
    paced = [pace(args.servos, 2_000_000, rate, args.seconds) for rate in (50.0, 100.0)]
    if args.json:
        print(json.dumps({"saturated": full, "paced": paced}, indent=1))
        return
    for row in full:
        print(
            f"{row['baud'] / 1e6:.0f} Mbit/s, {'fast' if row['fast'] else 'plain'}:"
            f" {row['hz']:6.1f} Hz of {row['wire_limit_hz']:6.1f}"
            f" ({100 * row['share']:.0f} %), client {row['client_core']:.2f} core,"
            f" {row['missed']:.0f} missed"
        )
    for row in paced:
        print(
            f"two buses at {row['rate']:.0f} Hz: {row['ticks']:.0f} ticks,"
            f" {row['dropped']:.0f} dropped, jitter p99 {row['jitter_p99_ms']:.2f} ms,"
            f" skew p50 {row['skew_p50_ms']:.2f} p99 {row['skew_p99_ms']:.2f} ms"
        )


if __name__ == "__main__":
    main()
