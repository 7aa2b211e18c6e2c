"""Fast Sync Read: one chained answer, and the plain way where that does not work."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.servo.bus import FAST_FAILURES, ServoBus
from bridge.servo.clock import VirtualClock
from bridge.servo.packets import FAST_SYNC_READ, SYNC_READ, fast_answers, fast_head, fast_status
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import Fault, FaultPlan, VirtualSerial, virtual_bus_for
from robots.registry import load_robot

ROBOT = load_robot("op3")
COUNT = len(ROBOT.joints)


class Rig:
    """An identified bus, and the codes of the instructions that were sent."""

    def __init__(self, *faults: Fault, old: int | None = None, fast: bool = True, seed: int = 0):
        self.clock = VirtualClock(0.0)
        self.wire = virtual_bus_for(ROBOT, timing=True, faults=FaultPlan(faults, seed=seed))
        if old is not None:
            self.wire.servos[old].memory.set("firmware_version", 44)
        self.codes: list[int] = []
        feed = self.wire.feed

        def spy(now, data, **options):
            self.codes.append(data[7])
            return feed(now, data, **options)

        self.wire.feed = spy

        def opener(port: str, baud: int):
            return VirtualSerial(self.wire, self.clock, baudrate=baud, timeout=0.005)

        transport = SdkTransport("test", 2_000_000, opener=opener, clock=self.clock)
        self.bus = ServoBus(ROBOT.joints, transport, fast=fast)
        self.bus.open()
        self.bus.identify()
        self.clock.sleep_until(2.0)
        self.codes.clear()

    def read(self):
        self.bus.begin_read()
        return self.bus.end_read(self.clock.now())


def test_servos_that_know_it_are_read_with_one_chained_answer():
    rig, plain = Rig(), Rig(fast=False)
    state, same = rig.read(), plain.read()
    assert rig.codes == [FAST_SYNC_READ]
    assert plain.codes == [SYNC_READ]
    assert state.seen.all()
    np.testing.assert_array_equal(state.position, same.position)
    assert rig.clock.now() < plain.clock.now()


def test_one_servo_with_old_firmware_makes_all_be_read_the_plain_way():
    rig = Rig(old=7)
    assert not rig.bus.reads_fast
    assert rig.read().seen.all()
    assert rig.codes == [SYNC_READ]


def test_a_dead_servo_hides_those_behind_it_for_one_read_only():
    rig = Rig(Fault("silence", start=3.0, end=4.0, servo_id=ROBOT.joints[5].servo.id))
    rig.clock.sleep_until(3.0)
    assert rig.read().seen.tolist() == [True] * 5 + [False] * (COUNT - 5)
    assert rig.read().seen.tolist() == [True] * 5 + [False] + [True] * (COUNT - 6)
    rig.clock.sleep_until(4.5)
    assert rig.read().seen.all()
    assert rig.read().seen.all()
    assert rig.codes == [FAST_SYNC_READ, SYNC_READ, SYNC_READ, FAST_SYNC_READ]


def test_fast_reads_that_keep_failing_are_given_up(caplog):
    rig = Rig()
    rig.wire.servos[3].memory.set("firmware_version", 44)  # it said 48
    for _ in range(2 * FAST_FAILURES + 6):
        rig.read()
    assert rig.codes.count(FAST_SYNC_READ) == FAST_FAILURES
    assert "plain ones from now on" in caplog.text
    assert not rig.bus.reads_fast


def test_an_alert_is_seen_in_a_fast_read():
    rig = Rig()
    rig.wire.servos[4].trip(5)
    assert np.flatnonzero(rig.read().alert).tolist() == [4]


@pytest.mark.parametrize("kind", ["drop", "corrupt", "truncate", "duplicate", "noise"])
def test_spoilt_fast_answers_never_become_values(kind):
    rig = Rig(Fault(kind, start=1.0, probability=0.5), seed=4)
    truth = np.array([servo.angle for servo in rig.wire.servos])
    for _ in range(20):
        state = rig.read()
        np.testing.assert_allclose(state.position[state.seen], truth[state.seen], atol=1e-3)
        if kind in ("duplicate", "noise"):
            assert state.seen.all()


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.binary(min_size=3, max_size=3), min_size=1, max_size=6),
    st.integers(0, 10**6),
    st.integers(1, 255),
    st.integers(0, 60),
)
def test_the_parts_before_a_damage_survive_and_no_other(data, where, flip, cut):
    entries = [(0, index + 1, values) for index, values in enumerate(data)]
    whole = bytearray(b"".join(fast_status(entries)))
    assert whole.startswith(fast_head(3, len(data)))
    assert fast_answers(bytes(whole), 3, len(data)) == entries
    where %= len(whole)
    whole[where] ^= flip
    intact = max(0, (where - 8) // 7) if where >= 8 else 0
    assert fast_answers(bytes(whole), 3, len(data)) == entries[:intact]
    whole[where] ^= flip
    assert fast_answers(bytes(whole[:cut]), 3, len(data)) == entries[: max(0, cut - 8) // 7]
