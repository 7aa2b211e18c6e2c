"""The one way into a servo's EEPROM: shown, asked for, backed up, verified."""

from __future__ import annotations

import json

import pytest

from bridge.setup.backup import Backup, change, restore
from robots.errors import ServoFault, SpecError
from tests.bridge.setup.rig import Rig, never, no, servo, yes


@pytest.fixture
def rig() -> Rig:
    return Rig([servo(5)])


def opened(rig: Rig, servo_id: int = 5, baud: int = 57600):
    return rig.line.servo(servo_id, "XM430-W350", baud)


def test_only_differences_are_asked_for_and_written(rig, tmp_path, monkeypatch):
    asked: list[str] = []
    written: list[int] = []
    with opened(rig) as access:
        write = access.transport.write
        monkeypatch.setattr(
            access.transport,
            "write",
            lambda i, address, data: (written.append(address), write(i, address, data))[1],
        )
        changed = change(
            access,
            0,
            {"return_delay_time": 0, "operating_mode": 3, "homing_offset": 0},
            lambda text: bool(asked.append(text)) or True,
            folder=tmp_path,
        )
    assert changed == {"return_delay_time": (250, 0)}
    assert written == [9]
    assert "return_delay_time: 250 -> 0" in asked[0]
    assert "operating_mode" not in asked[0]
    assert rig.wire.servo(5).get("return_delay_time") == 0


def test_nothing_is_asked_or_backed_up_where_nothing_differs(rig, tmp_path):
    with opened(rig) as access:
        assert change(access, 0, {"return_delay_time": 250}, never, folder=tmp_path) == {}
    assert not list(tmp_path.iterdir())


def test_a_no_leaves_the_servo_and_the_disk_as_they_are(rig, tmp_path):
    with opened(rig) as access:
        assert change(access, 0, {"return_delay_time": 0}, no, folder=tmp_path) is None
    assert rig.wire.servo(5).get("return_delay_time") == 250
    assert not list(tmp_path.iterdir())


def test_the_backup_is_there_before_the_first_write_and_restores_all(rig, tmp_path):
    rig.wire.servo(5).write(20, (77).to_bytes(4, "little"))
    with opened(rig) as access:
        change(access, 0, {"homing_offset": 0, "return_delay_time": 0}, yes, folder=tmp_path)
        (path,) = tmp_path.iterdir()
        backup = Backup.load(path)
        assert backup.eeprom["homing_offset"] == 77
        assert backup.change == {"homing_offset": 0, "return_delay_time": 0}
        assert (backup.servo_id, backup.model) == (5, "XM430-W350")
        changed = restore(access, 0, backup, yes, folder=tmp_path)
    assert changed == {"homing_offset": (0, 77), "return_delay_time": (0, 250)}
    assert rig.wire.servo(5).get("homing_offset") == 77
    assert len(list(tmp_path.iterdir())) == 2  # a restore is a change like any other


def test_eeprom_under_torque_is_refused_not_relaxed(rig, tmp_path):
    rig.wire.servo(5).write(64, b"\x01")
    with opened(rig) as access, pytest.raises(ServoFault, match="torque is on"):
        change(access, 0, {"return_delay_time": 0}, never, folder=tmp_path)
    assert rig.wire.servo(5).get("torque_enable") == 1


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"return_delay_time": 999}, "0 to 254"),
        ({"operating_mode": 2}, "0, 1, 3"),
        ({"goal_position": 5}, "not a writable register"),
        ({"model_number": 5}, "not a writable register"),
        ({"retrun_delay": 0}, "did you mean"),
    ],
)
def test_impossible_values_are_refused_before_anything_is_read(rig, values, word, tmp_path):
    with opened(rig) as access, pytest.raises(SpecError, match=word):
        change(access, 0, values, never, folder=tmp_path)


def test_a_value_that_does_not_hold_names_the_backup(rig, tmp_path, monkeypatch):
    with opened(rig) as access:
        monkeypatch.setattr(access.transport, "write", lambda *_: 0)
        with pytest.raises(ServoFault, match="--restore"):
            change(access, 0, {"return_delay_time": 0}, yes, folder=tmp_path)


def test_a_backup_that_cannot_be_kept_leaves_the_servo_alone(rig, tmp_path):
    (tmp_path / "file").write_text("")
    with opened(rig) as access, pytest.raises(Exception, match="cannot be written"):
        change(access, 0, {"return_delay_time": 0}, yes, folder=tmp_path / "file")
    assert rig.wire.servo(5).get("return_delay_time") == 250


def test_a_backup_of_another_model_is_refused(rig, tmp_path):
    backup = Backup(5, "servo", "p", "XL330-M288", 52, {"baud_rate": 1})
    with opened(rig) as access, pytest.raises(ServoFault, match="XL330"):
        restore(access, 0, backup, never, folder=tmp_path)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"schema": "pasdedeux.servo-backup/1", "eeprom": 3}']
)
def test_a_damaged_backup_is_refused_with_its_name(tmp_path, text):
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(SpecError, match=r"b\.json"):
        Backup.load(path)


def test_a_backup_with_values_that_are_no_numbers_is_refused(rig, tmp_path):
    with opened(rig) as access:
        change(access, 0, {"return_delay_time": 0}, yes, folder=tmp_path)
    (path,) = tmp_path.iterdir()
    data = json.loads(path.read_text())
    data["eeprom"]["id"] = "5"
    path.write_text(json.dumps(data))
    with pytest.raises(SpecError, match="whole numbers"):
        Backup.load(path)
