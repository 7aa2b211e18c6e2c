"""Protocol 1.0 on the byte level: the maker's examples, round trips, bytes without meaning."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.servo import packets
from bridge.servo.protocol1 import MAX_PARAMS, SYNC_WRITE, Parser, packet

EXAMPLES = [
    # The maker's manual, "Protocol 1.0": instructions, then what is answered to them.
    ("FF FF 01 05 03 0C 64 AA DC", 1, 0x03, "0C 64 AA"),
    ("FF FF 01 02 01 FB", 1, 0x01, ""),
    ("FF FF 01 04 02 2B 01 CC", 1, 0x02, "2B 01"),
    ("FF FF FE 04 03 03 01 F6", 254, 0x03, "03 01"),
    ("FF FF 01 05 04 1E F4 01 E2", 1, 0x04, "1E F4 01"),
    ("FF FF FE 02 05 FA", 254, 0x05, ""),
    ("FF FF 00 02 06 F7", 0, 0x06, ""),
    (
        "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
        254,
        SYNC_WRITE,
        "1E 04 00 10 00 50 01 01 20 02 60 03",
    ),
    ("FF FF FE 09 92 00 02 01 1E 02 02 24 1D", 254, 0x92, "00 02 01 1E 02 02 24"),
    ("FF FF 01 02 24 D8", 1, 0x24, ""),
    ("FF FF 01 03 00 20 DB", 1, 0x00, "20"),
    ("FF FF 02 04 00 00 80 79", 2, 0x00, "00 80"),
]
codes = st.integers(0, 255)
ids = st.integers(0, 254)
params = st.binary(max_size=MAX_PARAMS)


@pytest.mark.parametrize(("text", "servo_id", "code", "said"), EXAMPLES)
def test_packets_are_the_makers_examples_byte_by_byte(text, servo_id, code, said):
    assert packet(servo_id, code, bytes.fromhex(said)) == bytes.fromhex(text)
    (found,) = Parser().feed(bytes.fromhex(text))
    assert (found.servo_id, found.code, found.params) == (servo_id, code, bytes.fromhex(said))
    assert found.intact


@given(servo_id=ids, code=codes, data=params, cut=st.integers(0, 300))
def test_a_packet_survives_its_bytes_in_any_two_pieces(servo_id, code, data, cut):
    whole = packet(servo_id, code, data)
    parser = Parser()
    (found,) = parser.feed(whole[:cut]) + parser.feed(whole[cut:])
    assert (found.servo_id, found.code, found.params) == (servo_id, code, data)
    assert found.size == len(whole)
    assert parser.dropped == parser.pending == 0


@given(noise=st.binary(max_size=400))
def test_no_bytes_raise_and_all_are_accounted_for(noise):
    parser = Parser()
    found = parser.feed(noise)
    intact = sum(packet.size for packet in found if packet.intact)
    foreign = len(noise) - intact - parser.dropped - parser.pending
    assert foreign >= 0  # what is left lay in Protocol 2.0 packets
    parser.reset()
    assert parser.pending == 0


@given(noise=st.binary(max_size=60), servo_id=ids, data=st.binary(max_size=20))
def test_after_noise_and_silence_the_next_packet_is_found(noise, servo_id, data):
    parser = Parser()
    parser.feed(noise)
    parser.reset()
    assert [p.params for p in parser.feed(packet(servo_id, 2, data)) if p.intact] == [data]


@given(data=st.binary(max_size=20), at=st.integers(2, 30), bit=st.integers(0, 7))
def test_one_bent_bit_never_passes_as_intact(data, at, bit):
    whole = bytearray(packet(7, 3, data))
    if at >= len(whole):
        at = len(whole) - 1
    whole[at] ^= 1 << bit
    found = Parser().feed(whole)
    assert not any(p.intact and p.params == data and p.servo_id == 7 and p.code == 3 for p in found)


def test_a_whole_packet_inside_of_a_damaged_one_is_found():
    inner = packet(1, 1)
    found = Parser().feed(b"\xff\xff\x05\x08" + inner + b"\x00\x00\x00")
    assert [(p.servo_id, p.intact) for p in found] == [(5, False), (1, True)]


@given(data=st.binary(max_size=40))
def test_protocol_2_packets_are_passed_over_whatever_they_hold(data):
    foreign = packets.instruction(1, packets.WRITE, data)
    found = Parser().feed(packet(3, 1) + foreign + packet(4, 1))
    assert [(p.servo_id, p.intact) for p in found] == [(3, True), (4, True)]


@pytest.mark.parametrize(("servo_id", "data"), [(255, b""), (-1, b""), (1, bytes(254))])
def test_a_packet_that_cannot_be_is_refused(servo_id, data):
    with pytest.raises(ValueError, match=r"id|parameters"):
        packet(servo_id, 1, data)
