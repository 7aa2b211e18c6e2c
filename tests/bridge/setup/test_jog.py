"""One joint by keys: within limits, slowly, and only while a key is held."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from bridge.servo.clock import VirtualClock
from bridge.servo.sdk_transport import SdkTransport
from bridge.setup.jog import DOWN, QUIT, UP, JogSettings, jog
from bridge.virtual import Fault, FaultPlan, VirtualSerial, virtual_bus_for
from robots.errors import BusTimeout, ServoFault, SpecError
from robots.registry import load_robot
from tests.bridge.setup.rig import never, no, yes

ROBOT = load_robot("marionette")
JOINT = ROBOT.joint("l_elbow")


class Bench:
    """The marionette's bus, with keys that come at given times."""

    def __init__(self, *faults: Fault) -> None:
        self.clock = VirtualClock(1.0)
        self.wire = virtual_bus_for(ROBOT, timing=True, faults=FaultPlan(faults))
        self.servo = self.wire.servo(JOINT.servo.id)
        self.seen: list[tuple[float, float, float]] = []
        self.torques: list[int] = []

    def keys(self, key: str | None, held: float, then: float = 1.0) -> Callable[[], str | None]:
        """A key that is held for some time, nothing for another, and quit; 25 keys a second."""
        start: list[float] = []
        last = -1.0

        def read() -> str | None:
            nonlocal last
            now = self.clock.now()
            start.append(now)
            self.torques.append(self.servo.get("torque_enable"))
            if now - start[0] > held + then:
                return QUIT
            if now - start[0] < held and now - last > 0.04:
                last = now
                return key
            return None

        return read

    def jog(self, keys, ask=never, **options):
        def opener(port: str, baud: int):
            return VirtualSerial(self.wire, self.clock, baudrate=baud, timeout=0.005)

        transport = SdkTransport("test", 1_000_000, opener=opener, clock=self.clock)
        return jog(
            JOINT,
            transport,
            keys,
            self.clock,
            ask,
            show=lambda position, goal: self.seen.append((self.clock.now(), position, goal)),
            **options,
        )


def test_keys_move_the_joint_and_it_is_limp_afterwards():
    bench = Bench()
    jogged = bench.jog(bench.keys(UP, 0.5))
    assert jogged.end - jogged.start > math.radians(8)
    assert bench.torques[0] == 1
    assert bench.servo.get("torque_enable") == 0
    assert bench.servo.get("bus_watchdog") == 0
    others = [servo for servo in bench.wire.servos if servo is not bench.servo]
    assert all(servo.get("goal_position") == servo.get("present_position") for servo in others)


def test_torque_comes_on_with_the_goal_where_the_horn_is():
    bench = Bench()
    bench.servo.memory.set("goal_position", 3500)  # what somebody left behind
    jogged = bench.jog(bench.keys(None, 0.0, 0.5))
    assert jogged.highest - jogged.lowest < math.radians(0.3)


def test_nothing_moves_on_when_no_key_comes():
    bench = Bench()
    settings = JogSettings(step=math.radians(10), speed=0.1)
    bench.jog(bench.keys(UP, 0.2, 2.0), settings=settings)
    began = bench.seen[0][0]
    late = [(at, position) for at, position, _ in bench.seen if at - began > 0.9]
    assert max(p for _, p in late) - min(p for _, p in late) < math.radians(0.5)
    # The goal had been further away than the joint could come in that time.
    assert max(goal for *_, goal in bench.seen) - bench.seen[-1][1] > math.radians(3)


def test_a_joint_stops_at_its_limit():
    bench = Bench()
    jogged = bench.jog(bench.keys(DOWN, 3.0))
    assert jogged.lowest == pytest.approx(JOINT.lower, abs=math.radians(0.5))
    assert min(goal for *_, goal in bench.seen) >= JOINT.lower - 1e-9


def test_a_joint_is_never_faster_than_asked_for():
    bench = Bench()
    bench.jog(bench.keys(UP, 2.0), settings=JogSettings(step=math.radians(5), speed=0.3))
    track = bench.seen
    speed = max(abs(b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(track, track[10:], strict=False))
    assert 0.15 < speed < 0.36


def test_the_goal_never_runs_far_ahead_of_a_joint_that_is_held():
    bench = Bench()
    settings = JogSettings(step=math.radians(5), speed=0.05)
    bench.jog(bench.keys(UP, 1.0), settings=settings)
    assert max(g - p for _, p, g in bench.seen) <= settings.lead + math.radians(0.2)


def test_a_fault_ends_it_limp_and_names_the_joint():
    bench = Bench(Fault("hardware", start=1.6, servo_id=JOINT.servo.id, value=5))
    with pytest.raises(ServoFault, match=r"l_elbow.*overload"):
        bench.jog(bench.keys(UP, 5.0))
    assert bench.servo.get("torque_enable") == 0


def test_a_servo_that_falls_silent_is_given_up():
    bench = Bench(Fault("silence", start=1.6, servo_id=JOINT.servo.id))
    with pytest.raises(BusTimeout):
        bench.jog(bench.keys(UP, 5.0))


def test_an_error_in_the_middle_leaves_no_torque_behind():
    bench = Bench()
    calls: list[int] = []

    def keys() -> str | None:
        calls.append(1)
        if len(calls) > 20:
            raise KeyboardInterrupt
        return UP

    with pytest.raises(KeyboardInterrupt):
        bench.jog(keys)
    assert bench.servo.get("torque_enable") == 0


def test_another_operating_mode_is_changed_only_if_the_user_says_so(tmp_path):
    bench = Bench()
    bench.servo.write(11, b"\x01")
    with pytest.raises(ServoFault, match="l_elbow"):
        bench.jog(bench.keys(UP, 0.2), ask=no, folder=tmp_path)
    assert bench.servo.get("operating_mode") == 1
    bench.jog(bench.keys(UP, 0.2), ask=yes, folder=tmp_path)
    assert bench.servo.get("operating_mode") == 3


@pytest.mark.parametrize("wrong", [{"step": 1.0}, {"step": math.nan}, {"speed": 10.0}])
def test_steps_and_speeds_that_are_too_large_are_refused(wrong):
    with pytest.raises(SpecError, match="allowed"):
        JogSettings(**wrong)
