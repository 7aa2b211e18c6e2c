"""A servo gets its id and rate, alone on the bus, and is found there again."""

from __future__ import annotations

import pytest

from bridge.servo.sdk_transport import SdkTransport
from bridge.setup.backup import Backup
from bridge.setup.scan import scan
from bridge.setup.set_id import only_servo, restore_servo, set_id
from robots.errors import BusTimeout, ServoFault, SpecError
from tests.bridge.setup.rig import Rig, never, no, servo, yes


def test_a_new_servo_gets_its_id_and_rate_and_is_verified_there(tmp_path):
    rig = Rig([servo(1)])
    found = only_servo(scan(rig.line))
    changed = set_id(rig.line, found, yes, servo_id=14, baud=2_000_000, folder=tmp_path)
    assert changed == {"id": (1, 14), "baud_rate": (1, 4)}
    there = only_servo(scan(rig.line))
    assert (there.id, there.baud) == (14, 2_000_000)


def test_a_restore_brings_a_servo_back_to_its_old_place(tmp_path):
    rig = Rig([servo(1)])
    set_id(rig.line, only_servo(scan(rig.line)), yes, servo_id=14, baud=4_000_000, folder=tmp_path)
    (path,) = tmp_path.iterdir()
    backup = Backup.load(path)
    assert backup.place == (14, 4_000_000)
    restore_servo(rig.line, only_servo(scan(rig.line)), backup, yes, folder=tmp_path)
    there = only_servo(scan(rig.line))
    assert (there.id, there.baud) == (1, 57600)


def test_it_asks_before_it_writes(tmp_path):
    rig = Rig([servo(1)])
    found = only_servo(scan(rig.line))
    assert set_id(rig.line, found, no, servo_id=14, folder=tmp_path) is None
    assert rig.wire.servos[0].id == 1


def test_a_servo_that_is_right_already_is_not_written(tmp_path):
    rig = Rig([servo(1)])
    found = only_servo(scan(rig.line))
    assert set_id(rig.line, found, never, servo_id=1, baud=57600, folder=tmp_path) == {}


def test_a_lost_answer_to_the_new_id_is_made_good_by_looking(tmp_path, monkeypatch):
    """Servos may answer the write from the old place, the new one, or not at all."""
    rig = Rig([servo(1)])
    found = only_servo(scan(rig.line, [57600]))
    write = SdkTransport.write

    def lost(self: SdkTransport, servo_id: int, address: int, data: bytes) -> int:
        write(self, servo_id, address, data)
        raise BusTimeout("no answer")

    monkeypatch.setattr(SdkTransport, "write", lost)
    changed = set_id(rig.line, found, yes, servo_id=14, baud=1_000_000, folder=tmp_path)
    assert changed == {"id": (1, 14), "baud_rate": (1, 3)}


def test_a_servo_that_vanishes_is_said_to_be_and_the_backup_named(tmp_path, monkeypatch):
    rig = Rig([servo(1)])
    found = only_servo(scan(rig.line, [57600]))
    monkeypatch.setattr(SdkTransport, "write", lambda *_: 0)
    with pytest.raises(ServoFault, match=r"scan; pasdedeux setup-id --restore"):
        set_id(rig.line, found, yes, servo_id=14, folder=tmp_path)


def test_several_servos_are_refused_and_named():
    rig = Rig([servo(1), servo(2, 1_000_000)])
    with pytest.raises(ServoFault, match=r"1 at 57600 bit/s, 2 at 1000000 bit/s.*alone"):
        only_servo(scan(rig.line))


def test_a_clash_is_not_one_servo():
    rig = Rig([servo(1), servo(1, angle=0.7)])
    with pytest.raises(ServoFault, match="alone"):
        only_servo(scan(rig.line))


def test_an_empty_bus_has_no_servo_to_change():
    with pytest.raises(BusTimeout, match="power"):
        only_servo(scan(Rig([]).line))


@pytest.mark.parametrize("wanted", [{"servo_id": 253}, {"servo_id": -1}, {"baud": 115201}])
def test_ids_and_rates_that_do_not_exist_are_refused(wanted, tmp_path):
    rig = Rig([servo(1)])
    with pytest.raises(SpecError, match="allowed"):
        set_id(rig.line, only_servo(scan(rig.line)), never, folder=tmp_path, **wanted)
