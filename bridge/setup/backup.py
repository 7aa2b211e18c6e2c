"""Changes to what a servo keeps without power: shown, asked for, backed up, verified.

**The problem.** A wrong value in a servo's EEPROM survives everything, and each write wears it. So
there is one way in: read everything first, show what would change, ask, keep a copy, write nothing
but the differences, and read back.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bridge.servo.access import RegisterAccess
from bridge.servo.registers import BAUD_RATES, Register
from bridge.servo.transport import Transport
from robots.errors import BusCorrupt, BusTimeout, ServoFault, SpecError
from robots.files import plain, write_json

log = logging.getLogger(__name__)

SCHEMA = "pasdedeux.servo-backup/1"
FOLDER = Path("servo-backups")
"""Where copies go unless told otherwise."""
MOVES = ("id", "baud_rate")
"""Registers after whose change the servo is to be found elsewhere: written last, one at a time."""

Ask = Callable[[str], bool]
"""Shows a text to the user and returns whether to go on."""
Reopen = Callable[[int], Transport]
"""Returns a transport, still closed, for the same port at another bit rate."""


@dataclass(frozen=True, slots=True)
class Backup:
    """What a servo's EEPROM held before a change."""

    servo_id: int
    """Its id then."""
    joint: str
    """What it moves, as far as that was known."""
    port: str
    model: str
    """The maker's name."""
    firmware: int
    eeprom: dict[str, int]
    """Every writable register of the EEPROM, by name, in register units."""
    change: dict[str, int] = field(default_factory=dict)
    """What was about to be written."""
    made: str = ""
    """When, UTC."""

    def save(self, folder: Path) -> Path:
        """Write it into a folder under a new name and return the path."""
        stem = f"servo-{self.servo_id}-{self.made.replace(':', '')}"
        path, count = folder / f"{stem}.json", 1
        while path.exists():
            count += 1
            path = folder / f"{stem}-{count}.json"
        write_json(path, {"schema": SCHEMA, **plain(self)})
        return path

    @classmethod
    def load(cls, path: Path) -> Backup:
        """Read one.

        Raises:
            SpecError: The file is no backup of a servo.
        """
        data = read_object(path)
        if data.pop("schema", None) != SCHEMA:
            raise SpecError("is not a backup of a servo", where=str(path), allowed=SCHEMA)
        try:
            backup = cls(**data)
            whole = all(type(value) is int for value in backup.eeprom.values())
            whole &= all(type(value) is int for value in backup.change.values())
            whole &= type(backup.servo_id) is int and isinstance(backup.model, str)
        except (TypeError, AttributeError) as error:
            raise SpecError(f"is damaged: {error}", where=str(path)) from error
        if not whole:
            raise SpecError("is damaged: values are not whole numbers", where=str(path))
        return backup

    @property
    def place(self) -> tuple[int, int]:
        """(id, bit rate) at which the servo is to be found after the change."""
        servo_id = self.change.get("id", self.servo_id)
        return servo_id, BAUD_RATES[self.change.get("baud_rate", self.eeprom["baud_rate"])]


def read_object(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file.

    Raises:
        SpecError: There is none.
    """
    try:
        data = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise SpecError(f"cannot be read: {error.strerror}", where=str(path)) from error
    except (ValueError, RecursionError) as error:
        raise SpecError("is not JSON", where=str(path)) from error
    if not isinstance(data, dict):
        raise SpecError("is not a JSON object", where=str(path))
    return data


def change(
    access: RegisterAccess,
    index: int,
    values: Mapping[str, int],
    ask: Ask,
    *,
    folder: Path = FOLDER,
    reopen: Reopen | None = None,
) -> dict[str, tuple[int, int]] | None:
    """Make EEPROM registers of a servo hold values; return what changed, ``(before, after)``.

    Args:
        access: The servos of a port.
        index: Which of them.
        values: Register values by name.
        ask: Shown the differences; nothing is written unless it returns true. Not called if there
            are none.
        folder: Where the backup goes.
        reopen: Makes a transport at another bit rate; needed to change ``baud_rate``, after which
            ``access`` is closed.

    Returns:
        Before and after of each register that was written; ``None`` if the user declined.

    Raises:
        SpecError: A name or value is not possible.
        ServoFault: Torque is on, or a value did not hold; the backup is named.
    """
    table, who = access.tables[index], access.who(index)
    for name, value in values.items():
        _require_possible(table[name], value, f"{who}: {name}")
    before = {
        register.name: access.read(index, register.name)
        for register in table.spans
        if register.area == "eeprom" and register.access == "rw"
    }
    differing = {name: value for name, value in values.items() if before[name] != value}
    if not differing:
        return {}
    if reopen is None and "baud_rate" in differing:
        raise ValueError("to change baud_rate the port must be opened again")
    if access.read(index, "torque_enable"):
        raise ServoFault(
            "torque is on, which locks its EEPROM", where=who, hint="hold the robot and relax it"
        )
    lines = [f"  {name}: {before[name]} -> {value}" for name, value in differing.items()]
    if not ask("\n".join([f"{who}: write to its EEPROM?", *lines])):
        return None
    backup = Backup(
        servo_id=access.ids[index],
        joint=access.joint_names[index],
        port=access.transport.port,
        model=table.name,
        firmware=access.read(index, "firmware_version"),
        eeprom=before,
        change=differing,
        made=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    )
    path = backup.save(folder)
    log.info("%s: backup in %s", who, path)
    hint = f"pasdedeux setup-id --restore {path}"
    _write(access, index, {n: v for n, v in differing.items() if n not in MOVES}, hint)
    _move(access, index, differing, reopen, hint)
    return {name: (before[name], value) for name, value in differing.items()}


def _require_possible(register: Register, value: int, where: str) -> None:
    if register.area != "eeprom" or register.access != "rw":
        raise SpecError("is not a writable register of the EEPROM", where=where)
    if register.values is not None:
        if value not in register.values:
            allowed = ", ".join(map(str, register.values))
            raise SpecError(f"{value}", where=where, allowed=allowed)
        return
    low, high = register.min, register.max
    under = isinstance(low, int) and value < low
    if under or (isinstance(high, int) and value > high):
        raise SpecError(f"{value}", where=where, allowed=f"{low} to {high}")


def _write(access: RegisterAccess, index: int, values: Mapping[str, int], hint: str) -> None:
    for name, value in values.items():
        access.write(index, name, value)
    for name, value in values.items():
        _require_value(access.who(index), name, access.read(index, name), value, hint)


def _move(
    access: RegisterAccess,
    index: int,
    values: Mapping[str, int],
    reopen: Reopen | None,
    hint: str,
) -> None:
    """Write id and bit rate, one after the other; the servo is asked where it went."""
    transport, servo_id = access.transport, access.ids[index]
    for name in (name for name in MOVES if name in values):
        register, value = access.tables[index][name], values[name]
        try:
            transport.write(servo_id, register.address, register.encode(value))
        except (BusTimeout, BusCorrupt) as error:
            # Whether it took the value is seen where it should be now.
            log.info("%s: no answer to the new %s: %s", access.who(index), name, error)
        if name == "id":
            servo_id = value
        elif reopen is not None:
            transport.close()
            transport = reopen(BAUD_RATES[value])
            transport.open()
        address, length = register.address, register.length
        try:
            _, data = access.retry(
                index,
                lambda wire=transport, at=servo_id, a=address, n=length: wire.read(at, a, n),
            )
            _require_value(access.who(index), name, register.decode(data), value, hint)
        except BusTimeout as error:
            raise ServoFault(
                f"does not answer after {name} {value} was written",
                where=access.who(index),
                hint=f"look for it with pasdedeux scan; {hint}",
            ) from error
        finally:
            if transport is not access.transport:
                transport.close()


def _require_value(who: str, name: str, found: int, value: int, hint: str) -> None:
    if found != value:
        raise ServoFault(f"{name} is {found} after {value} was written", where=who, hint=hint)


def restore(
    access: RegisterAccess,
    index: int,
    backup: Backup,
    ask: Ask,
    *,
    folder: Path = FOLDER,
    reopen: Reopen | None = None,
) -> dict[str, tuple[int, int]] | None:
    """Give a servo back what a backup kept; as :func:`change`.

    Raises:
        ServoFault: It is another model.
    """
    table = access.tables[index]
    number = access.read(index, "model_number")
    if backup.model != table.name or number != table.number:
        raise ServoFault(
            f"the backup is of {backup.model}, the servo is model {number}",
            where=access.who(index),
        )
    return change(access, index, backup.eeprom, ask, folder=folder, reopen=reopen)
