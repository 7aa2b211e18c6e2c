"""What faults of wire and adapter do to the bytes that reach the host."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.servo import packets
from bridge.servo.packets import Parser, instruction
from bridge.servo.registers import control_table
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualServo
from bridge.virtual.faults import KINDS, Kind
from bridge.virtual.line_faults import collide
from robots.errors import SpecError

XM430 = control_table("XM430-W350")
BYTE = 10e-6
"""s of a byte at a megabit."""


def bus(*faults: Fault, ids=(1, 2, 3), baud: int | None = 1_000_000, seed: int = 0) -> VirtualBus:
    servos = [VirtualServo(XM430, servo_id) for servo_id in ids]
    for servo in servos:
        servo.memory.set("return_delay_time", 0)
    return VirtualBus(servos, baud=baud, faults=FaultPlan(faults, seed=seed))


def word(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def ping(servo_id: int = 1) -> bytes:
    return instruction(servo_id, packets.PING)


def read(*ids: int, code: int = packets.SYNC_READ) -> bytes:
    """Return a read of 4 bytes (15 in each answer) of several servos."""
    return instruction(packets.BROADCAST, code, word(132, 4) + bytes(ids))


def senders(answers: list[tuple[float, bytes]]) -> list[int]:
    return [packet.servo_id for packet in Parser().feed(b"".join(data for _, data in answers))]


def clean(request: bytes, now: float = 0.0) -> list[tuple[float, bytes]]:
    return bus().feed(now, request)


@pytest.mark.parametrize("code", [packets.SYNC_READ, packets.FAST_SYNC_READ])
def test_an_echo_comes_back_when_it_has_been_sent_and_before_the_answers(code):
    request = read(1, 2, 3, code=code)
    (due, echo), *answers = bus(Fault("echo")).feed(1.0, request)
    assert echo == request
    assert due == pytest.approx(1.0 + len(request) * BYTE)
    assert answers == clean(request, 1.0)


def test_an_echo_is_heard_of_bytes_that_no_servo_understands():
    assert bus(Fault("echo")).feed(0.0, b"hello") == [(pytest.approx(5 * BYTE), b"hello")]


def test_a_late_answer_makes_those_behind_it_late_too():
    request = read(1, 2, 3)
    late = bus(Fault("delay", servo_id=2, value=0.01)).feed(0.0, request)
    on_time = clean(request)
    assert [data for _, data in late] == [data for _, data in on_time]
    waits = [a - b for (a, _), (b, _) in zip(late, on_time, strict=True)]
    assert waits[0] == 0.0
    assert 0.0 < waits[1] <= 0.01
    assert waits[2] == pytest.approx(waits[1])


def test_jitter_is_spread_over_its_range():
    wire = bus(Fault("delay", value=0.02), ids=(1,))
    waits = [wire.feed(k, ping())[0][0] - k - 24 * BYTE for k in range(400)]
    assert 0 <= min(waits) < 0.001
    assert 0.019 < max(waits) <= 0.02
    assert sum(waits) / 400 == pytest.approx(0.01, abs=0.001)


def test_a_late_servo_makes_a_chained_answer_late_as_a_whole():
    request = read(1, 2, code=packets.FAST_SYNC_READ)
    ((due, data),) = bus(Fault("delay", servo_id=2)).feed(0.0, request)
    ((on_time, whole),) = clean(request)
    assert data == whole
    assert on_time < due <= on_time + 0.01


def test_a_stale_answer_comes_in_the_next_exchange_before_its_answers():
    wire = bus(Fault("stale", end=1.0, servo_id=2))
    assert senders(wire.feed(0.0, read(1, 2, 3))) == [1, 3]
    wire.servo(2).place(0.5)
    answers = wire.feed(1.0, read(2))
    assert senders(answers) == [2, 2]
    assert answers[0][1] == clean(read(2))[0][1]  # what was true then
    assert answers[0][1] != answers[1][1]
    assert senders(wire.feed(2.0, read(1))) == [1]


def test_a_reordered_answer_comes_behind_the_next():
    answers = bus(Fault("reorder", servo_id=1)).feed(0.0, read(1, 2, 3))
    assert senders(answers) == [2, 1, 3]
    assert [due for due, _ in answers] == [due for due, _ in clean(read(1, 2, 3))]


def test_a_servo_alone_can_be_deaf():
    wire = bus(Fault("deaf", servo_id=2))
    led = instruction(
        packets.BROADCAST, packets.SYNC_WRITE, word(65, 1) + bytes([1, 1, 2, 1, 3, 1])
    )
    wire.feed(0.0, led)
    assert [servo.get("led") for servo in wire.servos] == [1, 0, 1]
    assert senders(wire.feed(0.1, read(1, 2, 3))) == [1, 3]


@pytest.mark.parametrize("kind", ["drop", "corrupt", "truncate", "noise", "duplicate"])
def test_a_fault_of_one_servo_spoils_its_part_of_a_chained_answer(kind):
    request = read(1, 2, 3, code=packets.FAST_SYNC_READ)
    ((_, data),) = bus(Fault(kind, servo_id=2), seed=1).feed(0.0, request)
    ((_, whole),) = clean(request)
    assert data != whole
    assert data.startswith(whole[:16])  # head and the part of servo 1
    intact = 2 if kind == "duplicate" else 1
    assert packets.fast_answers(data, 4, 3) == packets.fast_answers(whole, 4, 3)[:intact]


def test_bytes_wait_for_the_latency_timer():
    """The module's first example: 14 bytes at 1 ms wait for the end of the period."""
    ((due, data),) = bus(Fault("latency")).feed(0.9e-3, ping())
    assert data == clean(ping())[0][1]
    assert due == pytest.approx(0.016)


def test_sixty_two_bytes_do_not_wait_for_the_latency_timer():
    request = read(1, 2, 3, 4, 5)
    answers = bus(Fault("latency"), ids=range(1, 6)).feed(0.0, request)
    whole = b"".join(data for _, data in bus(ids=range(1, 6)).feed(0.0, request))
    assert b"".join(data for _, data in answers) == whole
    assert [len(data) for _, data in answers] == [62, 13]
    full = (len(request) + 62) * BYTE
    assert answers[0][0] == pytest.approx(full)
    assert answers[1][0] == pytest.approx(full + 0.016)  # the timer restarts with a transfer


def test_a_client_that_waits_for_answers_gets_one_a_period_behind_a_latency_timer():
    """Why "only 60 Hz, whatever the bit rate" is the most common complaint about real adapters."""
    wire, now, due = bus(Fault("latency")), 0.0, []
    for _ in range(10):
        ((now, _),) = wire.feed(now, ping())
        due.append(now)
    assert [b - a for a, b in itertools.pairwise(due)] == pytest.approx([0.016] * 9)


def test_servos_of_one_id_pull_at_one_wire():
    """A driven 0 wins, where they overlap."""
    assert collide([(0.0, b"\xff\x10"), (BYTE, b"\xff\x30")], BYTE) == [(3 * BYTE, b"\xff\x10\x30")]
    assert collide([(0.0, b"\xa4"), (0.0, b"\xa4")], 0.0) == [(0.0, b"\xa4")]
    assert collide([(0.0, b"\x0f"), (0.0, b"\xf1")], 0.0) == [(0.0, b"\x01")]


def test_servos_of_one_id_are_heard_one_after_the_other_if_their_delays_differ():
    wire = bus(ids=(1, 1))
    wire.servos[1].memory.set("return_delay_time", 250)
    (answer,) = wire.feed(0.0, ping())
    assert senders([answer]) == [1, 1]


@pytest.mark.parametrize("code", [packets.SYNC_READ, packets.FAST_SYNC_READ])
def test_servos_of_one_id_damage_what_they_answer_differently(code):
    wire = bus(ids=(1, 2, 2, 3))
    wire.servos[2].place(0.7)
    answers = wire.feed(0.0, read(1, 2, 3, code=code))
    if code == packets.SYNC_READ:
        assert senders(answers) == [1, 3]
    else:
        ids = [who for _, who, _ in packets.fast_answers(answers[0][1], 4, 3)]
        assert ids == [1]  # the chain cannot be checked behind the damage


PACKET_KINDS = sorted(name for name, kind in KINDS.items() if kind.scope != "servo")


@settings(max_examples=40, deadline=None)
@given(
    kinds=st.lists(st.sampled_from(PACKET_KINDS), min_size=1, max_size=4),
    chance=st.floats(0.05, 1.0),
    seed=st.integers(0, 10**6),
    steps=st.lists(st.floats(1e-4, 0.05), min_size=1, max_size=20),
)
def test_the_same_seed_gives_the_same_bytes_in_the_order_of_time(kinds, chance, seed, steps):
    def run() -> list[tuple[float, bytes]]:
        faults = [Fault(kind, probability=chance) for kind in kinds]
        wire, now, heard = bus(*faults, seed=seed), 0.0, []
        for index, step in enumerate(steps):
            now += step
            code = packets.SYNC_READ if index % 2 else packets.FAST_SYNC_READ
            answers = wire.feed(now, read(1, 2, 3, code=code))
            assert all(due >= now for due, _ in answers)
            heard += answers
        assert [due for due, _ in heard] == sorted(due for due, _ in heard) or "delay" not in kinds
        return heard

    assert run() == run()


def test_another_seed_gives_other_bytes():
    heard = []
    for seed in range(2):
        wire = bus(Fault("corrupt"), seed=seed)
        heard.append([wire.feed(k, ping()) for k in range(5)])
    assert heard[0] != heard[1]


@pytest.mark.parametrize("kind", PACKET_KINDS)
def test_what_is_over_changes_nothing_any_more(kind: Kind):
    wire = bus(Fault(kind, end=1.0))
    wire.feed(0.5, read(1, 2, 3))
    wire.feed(1.5, ping())  # takes what was held back
    assert wire.feed(2.0, read(1, 2, 3)) == clean(read(1, 2, 3), 2.0)


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"kind": "ecko"}, "echo"),
        ({"kind": "drop", "value": 3.0}, "no value"),
        ({"kind": "latency", "value": 0.0}, "0.0002 to 1 s"),
        ({"kind": "baud", "value": 57601}, "57600"),
        ({"kind": "drop", "probability": 1.1}, "0 to 1"),
        ({"kind": "drop", "start": 2.0, "end": 1.0}, "from 2.0 to 1.0 s"),
    ],
)
def test_a_fault_that_cannot_be_is_refused(wrong, reason):
    with pytest.raises(SpecError, match=reason):
        Fault(**wrong)


def test_a_timeline_is_read_from_a_file(tmp_path):
    path = tmp_path / "faults.toml"
    path.write_text(
        'seed = 7\n[[fault]]\nkind = "latency"\nstart = 1\nend = 2.5\n'
        '[[fault]]\nkind = "load"\nservo_id = 3\nvalue = 0.4\n'
    )
    plan = FaultPlan.load(path)
    assert plan.faults == [Fault("latency", 1, 2.5), Fault("load", servo_id=3, value=0.4)]
    assert plan.rng.random() == FaultPlan(seed=7).rng.random()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('[[fault]]\nkind = "drop"\nprobabilty = 0.1', "probability"),
        ('[[fault]]\nkind = "dorp"', "fault 0.*drop"),
        ("[[fault]]\nstart = 1", "'kind'"),
        ('[[fault]]\nkind = "drop"\nstart = "now"', "not a number"),
        ("fault = 3", "list"),
        ("seed = -1", "seed"),
        ("faults = []", "fault"),
        ("[[fault", "TOML"),
    ],
)
def test_a_file_with_something_unknown_is_refused(tmp_path, text, reason):
    path = tmp_path / "faults.toml"
    path.write_text(text)
    with pytest.raises(SpecError, match=reason):
        FaultPlan.load(path)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SpecError, match="cannot be read"):
        FaultPlan.load(tmp_path / "none.toml")
