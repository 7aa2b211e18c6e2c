"""The streaming benchmark counts the bytes of the wire rightly, and runs."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from benchmarks.stream import unhurried, wire_limit
from benchmarks.stream_clients import GOAL, STREAM, Run
from bridge.servo import packets


@pytest.mark.parametrize("fast", [False, True])
def test_the_limit_counts_the_bytes_of_real_packets(fast):
    ids = bytes(range(1, 21))
    length = sum(register.length for register in STREAM)
    goals = b"".join(bytes((k,)) + bytes(GOAL.length) for k in ids)
    sent = packets.instruction(packets.BROADCAST, packets.SYNC_WRITE, bytes(4) + goals)
    code = packets.FAST_SYNC_READ if fast else packets.SYNC_READ
    asked = packets.instruction(packets.BROADCAST, code, bytes(4) + ids)
    if fast:
        answers = packets.fast_status([(0, k, bytes(length)) for k in ids])
    else:
        answers = [packets.status(k, 0, bytes(length)) for k in ids]
    size = len(sent) + len(asked) + sum(map(len, answers))
    assert wire_limit(20, 1_000_000, fast=fast) == pytest.approx(1e6 / (10 * size))


@pytest.mark.parametrize("fast", [False, True])
def test_our_client_leaves_no_time_of_the_wire_unused(fast):
    """A stuffed answer is a byte longer than planned; waiting for 21 more once cost 5 ms each."""
    run = Run("pasdedeux", 1, 4_000_000, fast, servos=20, seconds=0.0)
    row = unhurried(run)
    assert row["missed"] == 0
    assert 0.995 < row["share"] < 1 + 1e-9


@pytest.mark.slow
def test_every_client_streams_without_missing_a_servo_or_says_why():
    command = [sys.executable, "-m", "benchmarks.stream", "--json", "--servos", "4"]
    command += ["--baud", "1000000", "--seconds", "0.5", "--paced", "0.5", "--rate", "20"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    rows = json.loads(done.stdout)
    assert {"pasdedeux", "dynamixel-sdk"} <= {row["client"] for row in rows}
    for row in (row for row in rows if row["seconds"]):  # the others run in virtual time
        assert row["cycles"] > 0
        if not row["rate"]:
            assert 0 < row["share"] < 1
        assert row["server_us"] > 0
