"""The packet codec: the maker's examples, round trips, and bytes that are no packets."""

from __future__ import annotations

import dynamixel_sdk as sdk
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bridge.servo import packets
from bridge.servo.packets import (
    Packet,
    Parser,
    crc16,
    fast_status,
    instruction,
    status,
    stuff,
    unstuff,
)

TRICKY = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55]), max_size=40).map(bytes)
BODIES = st.one_of(st.binary(max_size=60), TRICKY)
IDS = st.one_of(st.integers(0, 252), st.just(packets.BROADCAST))


@pytest.mark.parametrize(
    ("made", "manual"),
    [
        (instruction(1, packets.PING), "FF FF FD 00 01 03 00 01 19 4E"),
        (
            instruction(1, packets.READ, bytes([0x84, 0, 4, 0])),
            "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15",
        ),
        (status(1, 0, bytes([0x06, 0x04, 0x26])), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
        (
            instruction(1, packets.WRITE, bytes([0x74, 0, 0, 2, 0, 0])),
            "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
        ),
    ],
)
def test_packets_are_those_of_the_manual(made, manual):
    assert made == bytes.fromhex(manual)


def test_fast_read_checksums_are_cumulative_as_in_the_manual():
    pieces = fast_status([(0, 3, b"\xa6\0\0\0"), (0, 7, b"\x1f\x08\0\0"), (0, 4, b"\xff\x03\0\0")])
    assert [piece[-2:][::-1].hex() for piece in pieces[1:]] == ["0884", "ca16", "9ed1"]
    (packet,) = Parser().feed(b"".join(pieces))
    assert packet.servo_id == packets.BROADCAST


def test_a_fast_read_is_not_unstuffed():
    pieces = fast_status([(0, 3, b"\xff\xff\xfd\xfd")])
    (packet,) = Parser().feed(b"".join(pieces))
    assert b"\xff\xff\xfd\xfd" in packet.params


@settings(deadline=None)
@given(st.one_of(st.binary(max_size=200), st.binary(min_size=1000, max_size=1100)))
def test_the_checksum_agrees_with_the_sdk(data):
    theirs = sdk.Protocol2PacketHandler().updateCRC(0, list(data), len(data))
    assert crc16(data) == theirs


@settings(deadline=None)
@given(st.binary(max_size=300), st.binary(max_size=300))
def test_a_checksum_goes_on_from_another(first, second):
    assert crc16(second, crc16(first)) == crc16(first + second)


@settings(deadline=None)
@given(BODIES)
@example(bytes.fromhex("fffffdfffdfd"))  # the SDK's own codec does not survive this one
@example(bytes.fromhex("fffffdfdfd"))
def test_stuffing_can_be_undone(body):
    assert unstuff(stuff(body)) == body


@settings(deadline=None)
@given(BODIES)
def test_stuffed_bytes_hold_no_header(body):
    assert packets.HEADER not in stuff(body) + b"\x01"
    assert b"\xff\xff\xfd\x00" not in stuff(body)


@settings(deadline=None)
@given(IDS, st.integers(0, 255), BODIES)
def test_every_packet_survives_the_wire(servo_id, code, params):
    if servo_id == packets.BROADCAST and code == packets.STATUS:
        return  # a fast read's answer: made by fast_status, never stuffed
    wire = instruction(servo_id, code, params)
    parser = Parser()
    assert parser.feed(wire) == [Packet(servo_id, code, params, len(wire))]
    assert parser.pending == 0
    assert parser.dropped == 0


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 252), BODIES), max_size=5), st.data())
def test_packets_are_found_however_the_stream_is_cut(messages, data):
    wire = b"".join(instruction(servo_id, 3, params) for servo_id, params in messages)
    parser, found, at = Parser(), [], 0
    while at < len(wire):
        size = data.draw(st.integers(1, 20))
        found += parser.feed(wire[at : at + size])
        at += size
    assert [(packet.servo_id, packet.params) for packet in found] == messages


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_garbage_never_raises_and_what_comes_out_has_a_right_checksum(noise):
    parser = Parser()
    found = parser.feed(noise)
    assert sum(packet.size for packet in found) + parser.pending + parser.dropped == len(noise)
    assert parser.pending < packets.MAX_PACKET


@settings(deadline=None)
@given(st.binary(max_size=60), BODIES)
def test_a_packet_after_garbage_is_found(noise, params):
    wire = instruction(7, 3, params)
    parser = Parser()
    # Garbage may end in the start of a packet that claims up to a kilobyte: silence tells.
    found = parser.feed(noise)
    parser.reset()
    found = parser.feed(wire)
    assert found == [Packet(7, 3, params, len(wire))]


@settings(deadline=None)
@given(BODIES, st.data())
def test_one_wrong_bit_never_makes_a_value(params, data):
    wire = bytearray(status(7, 0, params))
    bit = data.draw(st.integers(0, 8 * len(wire) - 1))
    wire[bit // 8] ^= 1 << bit % 8
    assert Parser().feed(bytes(wire)) == []


def test_a_megabyte_of_hostile_bytes_is_survived():
    rng = np.random.default_rng(1)
    alphabet = np.array([0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x01, 0x55, 0x83], np.uint8)
    parser, size = Parser(), 0
    for _ in range(250):
        chunk = alphabet[rng.integers(len(alphabet), size=4000)].tobytes()
        size += len(chunk)
        for packet in parser.feed(chunk):
            size -= packet.size
    assert parser.pending + parser.dropped == size
    parser.reset()
    assert len(parser.feed(instruction(1, packets.PING))) == 1


@pytest.mark.parametrize("servo_id", [253, 255, -1])
def test_ids_that_are_none_are_refused(servo_id):
    with pytest.raises(ValueError, match="not a servo id"):
        instruction(servo_id, packets.PING)


def test_packets_longer_than_a_servo_takes_are_refused():
    with pytest.raises(ValueError, match="longer"):
        instruction(1, packets.WRITE, bytes(2000))
