"""The client of the servos, over the SDK, against the virtual bus in virtual time."""

from __future__ import annotations

import dataclasses
import errno
import math
import termios

import numpy as np
import pytest

from bridge.servo.bus import ServoBus
from bridge.servo.clock import VirtualClock
from bridge.servo.sdk_transport import SdkTransport
from bridge.virtual import Fault, FaultPlan, VirtualBus, VirtualSerial, virtual_bus_for
from robots.errors import BusCorrupt, BusError, BusTimeout, PortLost, ServoFault
from robots.registry import load_robot

ROBOT = load_robot("op3")
COUNT = len(ROBOT.joints)
ELBOW = ROBOT.joints[4]


class Rig:
    """A client and the bus it talks to, on one virtual clock."""

    def __init__(self, *faults: Fault, seed: int = 0, joints=ROBOT.joints, serial=VirtualSerial):
        self.clock = VirtualClock(1.0)
        plan = FaultPlan(faults, seed=seed)
        self.wire: VirtualBus = virtual_bus_for(ROBOT, timing=True, faults=plan)

        def opener(port: str, baud: int):
            return serial(self.wire, self.clock, baudrate=baud, timeout=0.005)

        self.transport = SdkTransport("test", 2_000_000, opener=opener, clock=self.clock)
        self.bus = ServoBus(joints, self.transport)

    def open(self) -> Rig:
        self.bus.open()
        return self

    def servo(self, index: int):
        return self.wire.servos[index]

    def read(self):
        self.bus.begin_read()
        return self.bus.end_read(self.clock.now())

    def torques(self) -> list[int]:
        return [servo.get("torque_enable") for servo in self.wire.servos]


def test_a_robot_is_identified_configured_and_armed():
    rig = Rig().open()
    rig.bus.identify()
    rig.bus.configure()
    goal = rig.bus.hold_present(0.1)
    rig.bus.torque_on()
    assert rig.torques() == [1] * COUNT
    np.testing.assert_allclose(goal, ROBOT.rest, atol=2e-3)
    for joint, servo in zip(ROBOT.joints, rig.wire.servos, strict=True):
        assert servo.get("return_delay_time") == 0
        assert servo.get("profile_velocity") == round(joint.max_velocity / 0.0239808, 0)
        assert servo.get("min_position_limit") < servo.get("max_position_limit")


def test_eeprom_is_written_only_where_it_differs(monkeypatch):
    rig = Rig().open()
    rig.bus.configure()
    before = [servo.memory.get("return_delay_time") for servo in rig.wire.servos]
    writes = []
    write = rig.transport.write

    def spy(servo_id: int, address: int, data: bytes) -> int:
        writes.append(address)
        return write(servo_id, address, data)

    monkeypatch.setattr(rig.transport, "write", spy)
    rig.bus.configure()
    assert before == [0] * COUNT
    assert [address for address in writes if address < 64] == []


def test_goals_and_states_are_radians_of_the_named_joints():
    rig = Rig().open()
    rig.bus.configure()
    rig.bus.hold_present(0.1)
    rig.bus.torque_on()
    goal = np.clip(ROBOT.rest + 0.1, ROBOT.lower, ROBOT.upper)
    rig.bus.write_goals(goal)
    rig.clock.sleep_until(rig.clock.now() + 1.0)
    state = rig.read()
    np.testing.assert_allclose(state.position, goal, atol=4e-3)
    assert state.seen.all()
    assert not state.alert.any()
    assert np.abs(state.velocity).max() < 0.05


def test_missing_servos_and_wrong_models_are_all_named():
    rig = Rig(Fault("silence", servo_id=3), Fault("silence", servo_id=5)).open()
    with pytest.raises(BusTimeout) as caught:
        rig.bus.identify()
    for joint in ROBOT.joints:
        assert (f"{joint.name} (id" in str(caught.value)) == (joint.servo.id in (3, 5))
    rig = Rig().open()
    rig.servo(2).memory.set("model_number", 1060)
    with pytest.raises(ServoFault, match=r"XL430-W250 \(1060\), not XM430-W350 \(1020\)"):
        rig.bus.identify()


@pytest.mark.parametrize(("register", "value"), [("homing_offset", 512), ("drive_mode", 1)])
def test_offsets_kept_in_the_servo_are_refused(register, value):
    rig = Rig().open()
    rig.servo(4).memory.set(register, value)
    with pytest.raises(ServoFault, match=rf"{ELBOW.name}.*{register} is {value}"):
        rig.bus.configure()


def test_a_latched_error_is_named_before_anything_is_armed():
    rig = Rig().open()
    rig.servo(4).trip(2)
    with pytest.raises(ServoFault, match=rf"{ELBOW.name}.*overheating"):
        rig.bus.configure()


def test_stale_goals_are_replaced_before_torque_comes_on():
    """Torque on with an old goal makes a robot lunge."""
    rng = np.random.default_rng(3)
    rig = Rig().open()
    rig.bus.configure()
    for servo in rig.wire.servos:
        low, high = servo.get("min_position_limit"), servo.get("max_position_limit")
        servo.memory.set("goal_position", int(rng.integers(low, high)))
    before = np.array([servo.angle for servo in rig.wire.servos])
    rig.bus.hold_present(0.1)
    rig.bus.torque_on()
    rig.clock.sleep_until(rig.clock.now() + 1.0)
    rig.read()
    moved = np.abs(np.array([servo.angle for servo in rig.wire.servos]) - before)
    assert moved.max() < 2e-3


def test_torque_stays_off_when_a_goal_cannot_be_set():
    rig = Rig().open()
    rig.bus.configure()
    servo = rig.servo(4)
    write = servo.write
    servo.write = lambda address, data: 0 if address == 116 else write(address, data)
    servo.memory.set("goal_position", 2100)
    with pytest.raises(ServoFault, match=rf"{ELBOW.name}.*jump"):
        rig.bus.hold_present(0.1)
    assert rig.torques() == [0] * COUNT


def test_a_joint_outside_its_limits_is_refused_by_name():
    rig = Rig().open()
    rig.bus.configure()
    rig.servo(4).place(ELBOW.upper + 0.3)
    with pytest.raises(ServoFault, match=rf"{ELBOW.name}.*by hand"):
        rig.bus.hold_present(0.1)


def test_a_joint_slightly_outside_starts_from_its_limit():
    rig = Rig().open()
    rig.bus.configure()
    rig.servo(4).place(ELBOW.upper + 0.05)
    assert rig.bus.hold_present(0.1)[4] == pytest.approx(ELBOW.upper, abs=2e-3)


def test_one_dead_servo_does_not_blind_the_others():
    """The SDK's own sync read gives up all answers behind the first that is missing."""
    rig = Rig(Fault("silence", start=2.0, servo_id=ROBOT.joints[0].servo.id)).open()
    rig.clock.sleep_until(2.5)
    state = rig.read()
    assert state.seen.tolist() == [False] + [True] * (COUNT - 1)
    assert np.isnan(state.position[0])
    assert np.isfinite(state.position[1:]).all()


@pytest.mark.parametrize("kind", ["drop", "corrupt", "truncate", "duplicate", "noise"])
def test_spoilt_answers_are_left_out_and_never_become_values(kind):
    rig = Rig(Fault(kind, probability=0.3), seed=4).open()
    truth = np.array([servo.angle for servo in rig.wire.servos])
    lost = 0
    for _ in range(20):
        state = rig.read()
        lost += int((~state.seen).sum())
        np.testing.assert_allclose(state.position[state.seen], truth[state.seen], atol=1e-3)
    if kind in ("duplicate", "noise"):
        assert lost == 0
    else:
        assert 40 < lost < 250


def test_single_reads_survive_some_lost_answers():
    rig = Rig(Fault("drop", probability=0.15), seed=7).open()
    rig.bus.identify()
    np.testing.assert_allclose(rig.bus.positions(), ROBOT.rest, atol=2e-3)


def test_a_damaged_answer_is_told_from_a_missing_one():
    rig = Rig(Fault("corrupt", servo_id=1)).open()
    with pytest.raises(BusCorrupt, match="servo 1"):
        rig.transport.read(1, 132, 4)
    rig = Rig(Fault("drop", servo_id=1)).open()
    with pytest.raises(BusTimeout, match="servo 1"):
        rig.transport.read(1, 132, 4)


def test_an_answer_shorter_than_asked_is_corrupt():
    rig = Rig().open()
    servo = rig.servo(0)
    servo.read = lambda address, length: (0, bytes(length - 1))
    with pytest.raises(BusCorrupt, match="3 of 4 bytes"):
        rig.transport.read(servo.id, 132, 4)
    rig.bus.begin_read()
    assert not rig.bus.end_read(0.0).seen[0]


def test_a_late_answer_is_not_taken_for_the_next_one():
    """Status packets carry no number: after a timeout the line must fall silent first."""
    rig = Rig().open()
    servo = rig.servo(0)
    feed = rig.wire.feed
    late = [0.045]
    rig.wire.feed = lambda *args, **kwargs: [
        (due + late[0], data) for due, data in feed(*args, **kwargs)
    ]
    with pytest.raises(BusTimeout):
        rig.transport.read(servo.id, 132, 4)
    late[0] = 0.0
    assert rig.transport.read(servo.id, 24, 4)[1] == bytes([10, 0, 0, 0])


def test_a_servo_that_is_asked_alone_may_take_as_long_as_an_untuned_adapter():
    """Adapters collect what arrives for 16 ms, and a busy machine adds its own."""
    rig = Rig().open()
    feed = rig.wire.feed
    rig.wire.feed = lambda *args, **kwargs: [
        (due + 0.025, data) for due, data in feed(*args, **kwargs)
    ]
    assert rig.transport.read(rig.servo(0).id, 24, 4)[1] == bytes([10, 0, 0, 0])


def test_goals_that_need_byte_stuffing_arrive(monkeypatch):
    """The SDK computes the stuffing and sends the packet without it."""
    rig = Rig().open()
    servo = rig.servo(0)
    servo.memory.set("operating_mode", 4)
    value = int.from_bytes(b"\xff\xff\xfd\xff", "little", signed=True)
    rig.transport.sync_write(116, [servo.id], np.array([[255, 255, 253, 255]], np.uint8))
    assert servo.get("goal_position") == value
    rig.transport.write(servo.id, 116, b"\xfe\xff\xff\xff")
    sent = []
    original = VirtualSerial.write

    def spy(serial, data) -> int:
        sent.append(bytes(data))
        return original(serial, data)

    monkeypatch.setattr(VirtualSerial, "write", spy)
    rig.transport.sync_write(116, [servo.id], np.array([[255, 255, 253, 255]], np.uint8))
    assert b"\xff\xff\xfd\xfd\xff" in sent[0]
    assert rig.transport.read(servo.id, 116, 4)[1] == b"\xff\xff\xfd\xff"


def test_an_alert_is_seen_in_a_sync_read_and_named():
    rig = Rig().open()
    rig.servo(4).trip(5)
    state = rig.read()
    assert np.flatnonzero(state.alert).tolist() == [4]
    assert "overload" in str(rig.bus.fault_of(4))
    assert ELBOW.name in str(rig.bus.fault_of(4))


def test_a_refused_write_names_joint_and_reason():
    rig = Rig().open()
    with pytest.raises(ServoFault, match=rf"{ELBOW.name} \(id {ELBOW.servo.id}.*out of range"):
        rig.bus.registers.write(4, "led", 9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_goals_that_are_not_finite_never_reach_the_wire(bad):
    rig = Rig().open()
    goal = ROBOT.rest.copy()
    goal[4] = bad
    heard = rig.wire.instructions
    with pytest.raises(ServoFault, match=ELBOW.name):
        rig.bus.write_goals(goal)
    assert rig.wire.instructions == heard


@pytest.mark.parametrize("dead", [(1,), (2, 3), tuple(range(1, 20))])
def test_torque_off_is_tried_on_every_servo_whatever_fails(dead):
    rig = Rig(*(Fault("silence", start=50.0, servo_id=servo) for servo in dead)).open()
    rig.bus.configure()
    rig.bus.hold_present(0.1)
    rig.bus.torque_on()
    rig.clock.sleep_until(50.0)
    errors = rig.bus.torque_off()
    assert len(errors) == len(dead)
    for servo in rig.wire.servos:
        assert servo.memory.get("torque_enable") == (servo.id in dead)
    for servo_id in dead:
        assert any(f"(id {servo_id}," in str(error) for error in errors)


class BareTermiosSerial(VirtualSerial):
    """An unplugged adapter as pyserial shows it: no OSError but a bare ``termios.error``."""

    def reset_input_buffer(self) -> None:
        """Fail as tcflush does."""
        try:
            super().reset_input_buffer()
        except OSError as error:
            raise termios.error(errno.EIO, "Input/output error") from error


@pytest.mark.parametrize("serial", [VirtualSerial, BareTermiosSerial])
def test_an_unplugged_adapter_is_a_lost_port_and_does_not_stay_busy(serial):
    rig = Rig(Fault("unplug", start=2.0, end=3.0), serial=serial).open()
    rig.read()
    rig.clock.sleep_until(2.0)
    for call in (rig.read, rig.bus.positions, lambda: rig.bus.write_goals(ROBOT.rest)):
        with pytest.raises(PortLost, match="test"):
            call()
    assert len(rig.bus.torque_off()) == 1
    rig.bus.close()
    rig.clock.sleep_until(3.0)
    rig.bus.open()
    assert rig.read().seen.all()


def test_a_port_that_is_not_there_says_what_to_do():
    transport = SdkTransport("/dev/does-not-exist", 1_000_000)
    with pytest.raises(PortLost, match=r"does-not-exist.*plugged in"):
        transport.open()
    with pytest.raises(PortLost, match="not open"):
        transport.ping(1)


def test_the_watchdog_is_verified_and_skipped_for_old_firmware(caplog):
    rig = Rig().open()
    rig.servo(4).memory.set("firmware_version", 37)
    rig.bus.identify()
    rig.bus.watchdog(0.5)
    values = [servo.get("bus_watchdog") for servo in rig.wire.servos]
    assert values == [0 if index == 4 else 25 for index in range(COUNT)]
    assert ELBOW.name in caplog.text


def test_every_failure_is_one_of_our_errors():
    """Whatever the seed does to the bytes, nothing but a BusError comes out."""
    kinds = ("drop", "corrupt", "truncate", "duplicate", "noise")
    for seed in range(8):
        faults = [Fault(kind, probability=0.1) for kind in kinds]
        rig = Rig(*faults, seed=seed).open()
        for call in (rig.bus.identify, rig.bus.configure, rig.read, rig.bus.torque_off):
            try:
                call()
            except BusError as error:
                assert error.where  # noqa: PT017 - either outcome is right


def test_mirrored_and_geared_joints_round_trip():
    joints = [
        dataclasses.replace(
            joint,
            lower=-0.5,
            upper=0.5,
            rest=0.0,
            servo=dataclasses.replace(joint.servo, direction=-1, ratio=2.0, zero=1500),
        )
        for joint in ROBOT.joints
    ]
    rig = Rig(joints=joints).open()
    for servo in rig.wire.servos:
        servo.place((1500 - 2048) * 2 * math.pi / 4096)
    rig.bus.configure()
    rig.bus.hold_present(0.1)
    rig.bus.torque_on()
    rig.bus.write_goals(np.full(COUNT, 0.25))
    rig.clock.sleep_until(rig.clock.now() + 2.0)
    np.testing.assert_allclose(rig.read().position, 0.25, atol=2e-3)
    assert rig.servo(0).get("present_position") == pytest.approx(1500 - 326, abs=2)
