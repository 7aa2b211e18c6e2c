"""Packets that are made once and filled in, against the codec that builds each from the start."""

from __future__ import annotations

import os
import subprocess
import sys
import tty

import numpy as np
import pytest
import serial
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bridge.servo.packets import (
    BROADCAST,
    SYNC_WRITE,
    crc16,
    crc16_rows,
    fast_status,
    instruction,
    status,
)
from bridge.servo.serial_port import open_serial
from bridge.servo.stream import SyncReadPacket, SyncWritePacket

IDS = (1, 7, 253 - 1, 40)
WORDS = st.lists(st.binary(min_size=4, max_size=4), min_size=len(IDS), max_size=len(IDS))


def rows_of(data):
    return np.frombuffer(b"".join(data), np.uint8).reshape(len(data), -1)


@settings(max_examples=100, deadline=None)
@given(WORDS, WORDS)
@example([b"\xff\xff\xfd\xff"] * 4, [b"\0\0\0\0"] * 4)
@example([b"\xff\xff\xff\xff"] * 4, [b"\xff\xff\xfd\xfd"] * 4)
def test_a_filled_sync_write_is_the_packet_built_from_the_start(first, second):
    packet = SyncWritePacket(116, 4, IDS)
    for data in (first, second, first):
        params = b"".join(bytes((servo,)) + part for servo, part in zip(IDS, data, strict=True))
        built = instruction(BROADCAST, SYNC_WRITE, b"\x74\x00\x04\x00" + params)
        assert packet.filled(rows_of(data)) == built


def test_too_many_servos_for_one_packet_are_refused():
    with pytest.raises(ValueError, match="longer than"):
        SyncWritePacket(116, 4, [k % 252 for k in range(210)])


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 40), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_row_checksums_are_those_of_each_row(length, count, seed):
    rows = np.random.default_rng(seed).integers(0, 256, (count, length)).astype(np.uint8)
    assert crc16_rows(rows).tolist() == [crc16(row.tobytes()) for row in rows]


def answer_of(data, *, fast, error=0):
    if fast:
        entries = [(error, servo, part) for servo, part in zip(IDS, data, strict=True)]
        return b"".join(fast_status(entries))
    return b"".join(status(servo, error, part) for servo, part in zip(IDS, data, strict=True))


@pytest.mark.parametrize("fast", [False, True])
@settings(max_examples=100, deadline=None)
@given(data=WORDS, where=st.integers(0, 10**6), flip=st.integers(0, 255))
@example(data=[b"\xff\xff\xfd\xff"] * 4, where=0, flip=0)
def test_a_whole_answer_is_taken_and_a_damaged_one_is_not(fast, data, where, flip):
    asked = SyncReadPacket(132, 4, IDS, fast=fast)
    received = bytearray(answer_of(data, fast=fast))
    stuffed = not fast and len(received) != asked.size
    received[where % len(received)] ^= flip
    answer = asked.whole(received)
    if flip or stuffed:
        assert answer is None
    else:
        assert answer is not None
        assert answer.seen.all()
        assert not answer.alert.any()
        np.testing.assert_array_equal(answer.data, rows_of(data))


@pytest.mark.parametrize("fast", [False, True])
def test_an_alert_and_a_refusal_are_told_apart_in_a_whole_answer(fast):
    asked, data = SyncReadPacket(132, 4, IDS, fast=fast), [b"abcd"] * 4
    answer = asked.whole(answer_of(data, fast=fast, error=0x80))
    assert answer is not None
    assert answer.seen.all()
    assert answer.alert.all()
    answer = asked.whole(answer_of(data, fast=fast, error=0x87))
    assert answer is not None
    assert not answer.seen.any()
    assert not answer.alert.any()


def test_answers_of_other_servos_are_not_taken_for_the_ones_asked():
    others = SyncReadPacket(132, 4, (1, 7, 40, 252), fast=True)
    assert others.whole(answer_of([b"abcd"] * 4, fast=True)) is None
    assert not others.collected({99: (0, b"abcd")}).seen.any()


def test_a_port_gives_what_has_come_and_says_when_the_other_end_is_gone():
    master, slave = os.openpty()
    tty.setraw(slave)
    port = open_serial(os.ttyname(slave), 1_000_000)
    os.close(slave)
    try:
        assert port.read(10) == b""
        assert port.write([1, 2, 3]) == 3
        assert os.read(master, 10) == b"\x01\x02\x03"
        os.write(master, b"hello")
        assert port.read(3) == b"hel"
        assert port.read(100) == b"lo"
        os.close(master)
        with pytest.raises((OSError, serial.SerialException)):
            port.read(1)
    finally:
        port.close()


def test_a_port_that_takes_no_bytes_is_an_error_not_a_hang(monkeypatch):
    monkeypatch.setattr("bridge.servo.serial_port.WRITE_WAIT", 0.01)
    master, slave = os.openpty()
    tty.setraw(slave)
    port = open_serial(os.ttyname(slave), 1_000_000)
    try:
        with pytest.raises(serial.SerialTimeoutException):
            port.write(bytes(1_000_000))
    finally:
        os.close(master)
        os.close(slave)
        port.close()


def test_the_servo_side_can_be_imported_where_there_are_no_terminals():
    """As on Windows; pyserial itself has another module for it and is imported before."""
    code = (
        "import sys, serial, dynamixel_sdk\n"
        "sys.modules['termios'] = sys.modules['fcntl'] = sys.modules['tty'] = None\n"
        "import bridge.servo.bus, bridge.servo.lock, bridge.servo.sdk_transport\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
