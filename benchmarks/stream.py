"""How near to the limit of the wire the servo client streams, beside two other clients.

    python -m benchmarks.stream [--seconds 2] [--paced 10] [--busy 1] [--servos 20] [--json]

Each line is one run of one client in a process of its own; so is every virtual bus, which keeps the
wire's timing and has no return delay. A cycle writes moving goals to all servos (Sync Write) and
reads their current, velocity and position (10 bytes each; Sync Read or Fast Sync Read). The limit
is what the bytes of a cycle need at ten bits each.

- *Saturated*: as many cycles as there is room for, as share of the limit. Ours leads two buses
  from one loop; the others, whose calls return when the answers are there, from a thread for each.
- *Paced*: two buses at 100 Hz, as the player leads them, beside busy neighbours if asked. Jitter is
  how late a tick begins (and, beside it, how late this computer wakes a process that only waits),
  skew how long after the first bus the second has its command; a tick that is still running when
  the next should begin makes that one be dropped.

- *Unhurried*: our client and the bus in one process, in virtual time. What a cycle costs each of
  them in CPU time, as share of the time its bytes need on the wire; below 100 % for both, nothing
  but the operating system keeps them from the limit.

On a computer without idle cores the first two show the scheduler. The last hardly depends on what
else is running.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import json
import math
import os
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import asdict
from importlib.util import find_spec
from typing import IO, Any

import numpy as np

from benchmarks.stream_clients import GOAL, MAKERS, TABLE, Client, Ours, Run
from bridge.servo.bus import STREAM_LENGTH
from bridge.servo.clock import MonotonicClock, VirtualClock
from bridge.servo.packets import FAST_OVERHEAD
from bridge.servo.registers import BAUD_RATES
from bridge.servo.sdk_transport import SdkTransport
from bridge.servo.serial_port import READ_WAIT
from bridge.virtual import PtyServer, VirtualBus, VirtualSerial, VirtualServo

STATUS_BYTES, INSTRUCTION_BYTES, FAST_HEAD = 11, 14, 8
"""Bytes of a packet beside its data: status, sync instruction, head of a fast read's answer."""
PACKAGES = {"rustypot": "rustypot", "dynamixel-sdk": "dynamixel_sdk"}
ROUNDS, CYCLES = 5, 100
"""Of an unhurried run: the cheapest round counts, the others shared the core's caches."""
TARGETS = {(1_000_000, True): 0.93, (4_000_000, True): 0.88}
"""Share of the limit that our client should reach, by rate and whether reads are fast."""


def wire_limit(servos: int, baud: int, *, fast: bool) -> float:
    """Return the cycles per second that the bytes of one write and one read leave room for."""
    size = 2 * INSTRUCTION_BYTES + servos * (1 + GOAL.length) + servos
    if fast:
        size += FAST_HEAD + servos * (FAST_OVERHEAD + STREAM_LENGTH)
    else:
        size += servos * (STATUS_BYTES + STREAM_LENGTH)
    return baud / (10 * size)


# -- the other end --------------------------------------------------------------------------------


def bus_of(servos: int, baud: int) -> VirtualBus:
    """Return a bus with servos that answer at once and follow their goals."""
    bus = VirtualBus(
        VirtualServo(TABLE, k + 1, baud_index=BAUD_RATES.index(baud)) for k in range(servos)
    )
    for servo in bus.servos:
        servo.memory.set("return_delay_time", 0)
        servo.write(TABLE["torque_enable"].address, b"\x01")
    return bus


def serve(servos: int, baud: int) -> None:
    """Serve a bus until standard input closes; tell the CPU time, s, for every line read."""
    bus = bus_of(servos, baud)
    gc.freeze()
    with PtyServer(bus, timing=True) as server:
        print(server.port, flush=True)
        for _ in sys.stdin:
            print(time.process_time(), flush=True)


class Server:
    """A virtual bus in a process of its own."""

    def __init__(self, stack: ExitStack, servos: int, baud: int) -> None:
        """Start it; it ends with the stack."""
        self._child = child_of("--serve", str(servos), str(baud))
        stack.callback(self._child.wait)
        stack.callback(self._in.close)
        self.port = self._out.readline().strip()

    @property
    def cpu(self) -> float:
        """CPU time that it has taken, s."""
        self._in.write("\n")
        self._in.flush()
        return float(self._out.readline())

    @property
    def _in(self) -> IO[str]:
        assert self._child.stdin is not None
        return self._child.stdin

    @property
    def _out(self) -> IO[str]:
        assert self._child.stdout is not None
        return self._child.stdout


def child_of(*arguments: str) -> subprocess.Popen[str]:
    """Start this module with other arguments."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.Popen(
        [sys.executable, "-m", "benchmarks.stream", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )


# -- measuring ------------------------------------------------------------------------------------


def measure(run: Run) -> dict[str, Any]:
    """Carry out one run and return its figures."""
    with ExitStack() as stack:
        servers = [Server(stack, run.servos, run.baud) for _ in range(run.buses)]
        clients = [MAKERS[run.client](server.port, run) for server in servers]
        gc.freeze()
        busy = -sum(server.cpu for server in servers)
        begin, used = time.perf_counter(), time.process_time()
        figures = pace(clients, run) if run.rate else saturate(clients, run)
        passed, used = time.perf_counter() - begin, time.process_time() - used
        busy += sum(server.cpu for server in servers)
    cycles = max(1, figures["cycles"])  # of all buses
    limit = wire_limit(run.servos, run.baud, fast=run.fast)
    return {
        **asdict(run),
        **figures,
        "hz": cycles / run.buses / passed,
        "wire_limit_hz": limit,
        "share": cycles / run.buses / passed / limit,
        "client_cores_per_bus": used / passed / run.buses,
        "client_us": 1e6 * used / cycles,
        "server_us": 1e6 * busy / cycles,
    }


def saturate(clients: list[Client], run: Run) -> dict[str, Any]:
    """Stream as fast as it goes."""
    stop = time.perf_counter() + run.seconds
    counts = [0] * len(clients)
    missed = [0] * len(clients)

    def alone(index: int) -> None:
        client = clients[index]
        while time.perf_counter() < stop:
            client.begin(counts[index])
            missed[index] += client.end()
            counts[index] += 1

    if run.client == "pasdedeux":
        # Each bus begins anew as soon as its answers are taken: the others' bytes travel meanwhile.
        for client in clients:
            client.begin(0)
        for index in itertools.cycle(range(len(clients))):
            missed[index] += clients[index].end()
            counts[index] += 1
            if index == 0 and time.perf_counter() >= stop:
                break
            clients[index].begin(counts[index])
    else:
        threads = [threading.Thread(target=alone, args=(k,)) for k in range(len(clients))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return {"cycles": sum(counts), "missed": sum(missed)}


def pace(clients: list[Client], run: Run) -> dict[str, Any]:
    """Lead all buses at a fixed rate."""
    ours = [client for client in clients if isinstance(client, Ours)]
    clock = MonotonicClock()
    timer = idle_jitter(clock, run)
    skew: list[float] = []
    late: list[float] = []
    missed, tick = 0, 0
    begin = clock.now()
    while tick < run.rate * run.seconds:
        deadline = begin + tick / run.rate
        clock.sleep_until(deadline)
        late.append(clock.now() - deadline)
        sent: list[float] = []
        for client in ours:
            client.write(tick)
            sent.append(clock.now())
        for client in ours:
            client.bus.begin_read()
        missed += sum(client.end() for client in ours)
        skew.append(sent[-1] - sent[0])
        tick = max(tick + 1, math.ceil((clock.now() - begin) * run.rate))
    return {
        "cycles": len(late) * len(ours),
        "missed": missed,
        "dropped": math.ceil(run.rate * run.seconds) - len(late),
        "jitter_p99_ms": 1e3 * float(np.percentile(late, 99)),
        "timer_p99_ms": 1e3 * timer,
        "skew_p50_ms": 1e3 * float(np.percentile(skew, 50)),
        "skew_p99_ms": 1e3 * float(np.percentile(skew, 99)),
    }


def idle_jitter(clock: MonotonicClock, run: Run) -> float:
    """Return how late, s (p99), this computer wakes who does nothing but wait for the next tick."""
    late = []
    begin = clock.now()
    for tick in range(1, int(run.rate * min(run.seconds, 5.0)) + 1):
        clock.sleep_until(begin + tick / run.rate)
        late.append(clock.now() - begin - tick / run.rate)
    return float(np.percentile(late, 99))


class TimedSerial(VirtualSerial):
    """A virtual port that keeps account of the CPU time behind it."""

    spent = 0.0
    """s."""

    def write(self, data: bytes | bytearray | list[int]) -> int:
        """Send bytes."""
        begin = time.process_time()
        try:
            return super().write(data)
        finally:
            self.spent += time.process_time() - begin


def unhurried(run: Run) -> dict[str, Any]:
    """Return what a cycle costs our client and the bus, both in this process."""
    clock = VirtualClock()
    bus = bus_of(run.servos, run.baud)
    bus.baud = run.baud
    port = TimedSerial(bus, clock, baudrate=run.baud, timeout=READ_WAIT)
    transport = SdkTransport("virtual", run.baud, opener=lambda *_: port, clock=clock)
    client = Ours("virtual", run, transport)
    costs: list[tuple[float, float]] = []
    start, missed = clock.now(), 0
    for first in range(0, ROUNDS * CYCLES, CYCLES):
        behind, used = port.spent, time.process_time()
        for step in range(first, first + CYCLES):
            client.begin(step)
            missed += client.end()
        behind, used = port.spent - behind, time.process_time() - used
        costs.append(((used - behind) / CYCLES, behind / CYCLES))
    ours, theirs = (min(cost) for cost in zip(*costs, strict=True))
    limit = wire_limit(run.servos, run.baud, fast=run.fast)
    return {
        **asdict(run),
        "share": ROUNDS * CYCLES / (clock.now() - start) / limit,
        "wire_limit_hz": limit,
        "client_us": 1e6 * ours,
        "client_share": ours * limit,
        "server_us": 1e6 * theirs,
        "server_share": theirs * limit,
        "missed": missed,
    }


# -- running and telling --------------------------------------------------------------------------


def in_a_process(run: Run) -> dict[str, Any]:
    """Return the figures of a run by a process of its own."""
    child = child_of("--run", json.dumps(asdict(run)))
    answer, _ = child.communicate()
    if child.returncode:
        raise SystemExit(f"the run {run} failed, see above")
    return json.loads(answer)


def describe(row: dict[str, Any]) -> str:
    """Return the line of one run."""
    read = "fast " if row["fast"] else "plain"
    head = f"{row['baud'] // 1_000_000} Mbit/s {read} {row['buses']} bus {row['client']:13s}"
    if not row["seconds"]:
        return (
            f"{head} unhurried: {100 * row['share']:5.1f} % of {row['wire_limit_hz']:.0f} Hz;"
            f" client {row['client_us']:4.0f} us/cycle, {100 * row['client_share']:.0f} % of the"
            f" wire's; virtual bus {row['server_us']:4.0f} us/cycle,"
            f" {100 * row['server_share']:.0f} %; {row['missed']} missed"
        )
    cost = (
        f"client {row['client_us']:4.0f} us/cycle, {row['client_cores_per_bus']:.2f} core/bus;"
        f" virtual bus {row['server_us']:4.0f} us/cycle; {row['missed']} missed"
    )
    if row["rate"]:
        return (
            f"{head} at {row['rate']:.0f} Hz, {row['seconds']:.0f} s: {row['dropped']} late ticks,"
            f" jitter p99 {row['jitter_p99_ms']:.2f} ms"
            f" (of a bare timer here {row['timer_p99_ms']:.2f}),"
            f" skew p50 {row['skew_p50_ms']:.3f} p99 {row['skew_p99_ms']:.3f} ms; {cost}"
        )
    target = TARGETS.get((row["baud"], row["fast"])) if row["client"] == "pasdedeux" else None
    wanted = f" (wanted {100 * target:.0f})" if target else ""
    return f"{head} {100 * row['share']:5.1f} % of {row['wire_limit_hz']:.0f} Hz{wanted}; {cost}"


def runs_of(args: argparse.Namespace) -> list[Run]:
    """Return the runs that the command line asks for."""
    names = [name for name in args.clients if find_spec(PACKAGES.get(name, "bridge"))]
    for name in set(args.clients) - set(names):
        print(f"{name}: not installed, left out", file=sys.stderr)
    saturated = [
        Run(name, buses, baud, fast, args.servos, args.seconds)
        for baud in args.baud
        for fast in (False, True)
        for buses in (1, 2)
        for name in names
        if args.seconds > 0
    ]
    paced = [
        Run("pasdedeux", 2, baud, True, args.servos, args.paced, rate=args.rate)
        for baud in args.baud
        if args.paced > 0 and "pasdedeux" in names
    ]
    costs = [
        Run("pasdedeux", 1, baud, fast, args.servos, 0.0)
        for baud in args.baud
        for fast in (False, True)
        if "pasdedeux" in names
    ]
    return costs + saturated + paced


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description="Streaming rate of servo clients")
    parser.add_argument("--seconds", type=float, default=2.0, help="of a saturated run; 0: none")
    parser.add_argument("--paced", type=float, default=10.0, help="seconds of a paced run; 0: none")
    parser.add_argument("--rate", type=float, default=100.0, help="Hz of the paced run")
    parser.add_argument("--busy", type=int, default=0, help="busy neighbours of the paced run")
    parser.add_argument("--servos", type=int, default=20, help="on each bus")
    parser.add_argument("--baud", type=int, nargs="+", default=[1_000_000, 4_000_000])
    parser.add_argument("--clients", nargs="+", choices=MAKERS, default=list(MAKERS))
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--serve", nargs=2, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--run", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(*args.serve)
        return
    if args.run:
        run = Run(**json.loads(args.run))
        print(json.dumps(measure(run) if run.seconds else unhurried(run)))
        return
    rows: list[dict[str, Any]] = []
    for run in runs_of(args):
        with ExitStack() as stack:
            for _ in range(args.busy if run.rate else 0):
                spinner = subprocess.Popen([sys.executable, "-c", "while True: pass"])
                stack.callback(spinner.wait)
                stack.callback(spinner.kill)
            rows.append(in_a_process(run))
        if not args.json:
            print(describe(rows[-1]), flush=True)
    if args.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
