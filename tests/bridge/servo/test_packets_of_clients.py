"""The codec beside two other clients' bytes; where they disagree, the manual decides.

The manual: wherever FF FF FD appears from the instruction to the last parameter, an FD follows it.
"""

from __future__ import annotations

import contextlib
import os
import select
import tty

import dynamixel_sdk as sdk
import numpy as np
import pytest

from bridge.servo.packets import WRITE, instruction

HEAD = bytes((116, 0))
COUNT = 60


def bodies() -> list[bytes]:
    """Return parameters full of what needs stuffing, or almost."""
    rng = np.random.default_rng(0)
    return [bytes(rng.choice([0xFF, 0xFF, 0xFD, 0xFD, 0], 8).tolist()) for _ in range(COUNT)]


class Recorder:
    """A port of the SDK's that keeps what is written."""

    is_using, baudrate = False, 1_000_000

    def __init__(self) -> None:
        self.written = b""

    def clearPort(self) -> None:
        """Do nothing."""

    def writePort(self, packet: list[int]) -> int:
        """Keep the bytes."""
        self.written += bytes(packet)
        return len(packet)


def written_by_the_sdk(body: bytes) -> bytes:
    port, length = Recorder(), len(body) + 5
    packet = [0, 0, 0, 0, 1, length & 255, length >> 8, WRITE, *HEAD, *body, 0, 0]
    sdk.Protocol2PacketHandler().txPacket(port, packet)
    return port.written


def test_rustypot_writes_the_same_bytes():
    rustypot = pytest.importorskip("rustypot")
    master, slave = os.openpty()
    tty.setraw(slave)
    client = rustypot.Xl430PyController(os.ttyname(slave), 1_000_000, 0.001)
    for body in bodies():
        with contextlib.suppress(OSError, RuntimeError):  # nobody answers
            client.write_raw_data_with_error(1, 116, list(body))
        wanted, seen = instruction(1, WRITE, HEAD + body), b""
        while len(seen) < len(wanted) and select.select([master], (), (), 2.0)[0]:
            seen += os.read(master, 4096)
        assert seen == wanted, body.hex(" ")
    client.close()
    os.close(master)
    os.close(slave)


def test_the_sdk_writes_the_same_bytes_but_leaves_the_stuffing_out():
    stuffed = 0
    for body in bodies():
        ours, theirs = instruction(1, WRITE, HEAD + body), written_by_the_sdk(body)
        needed = b"\xff\xff\xfd" in body
        stuffed += needed
        assert (theirs == ours) is not needed, body.hex(" ")
        assert len(ours) == len(theirs) + body.count(b"\xff\xff\xfd")
    assert stuffed > COUNT / 10
