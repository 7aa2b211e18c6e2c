"""A servo out of the box to its place on a robot: id and bit rate, one servo at a time."""

from __future__ import annotations

from pathlib import Path

from bridge.servo.packets import MAX_ID
from bridge.servo.registers import BAUD_RATES
from bridge.setup.backup import FOLDER, Ask, Backup, change, restore
from bridge.setup.line import Line
from bridge.setup.scan import FoundServo, Scan
from robots.errors import BusTimeout, ServoFault, SpecError

Changes = dict[str, tuple[int, int]]
"""Before and after of registers, by name."""


def only_servo(found: Scan) -> FoundServo:
    """Return the servo of a scan if it is the only one.

    Raises:
        BusTimeout: Nobody answered.
        ServoFault: There are several, or what answers is damaged.
    """
    if len(found.servos) == 0:
        raise BusTimeout(
            "no servo answers", where=found.port, hint="check power and cable; Protocol 2.0 only"
        )
    first = found.servos[0]
    if len(found.servos) > 1 or first.clash or found.noisy:
        names = ", ".join(f"{servo.id} at {servo.baud} bit/s" for servo in found.servos)
        raise ServoFault(
            f"not just one servo answers: id {names}",
            where=found.port,
            hint="connect the one to be changed alone: a new id must reach no other",
        )
    return first


def set_id(
    line: Line,
    servo: FoundServo,
    ask: Ask,
    *,
    servo_id: int | None = None,
    baud: int | None = None,
    folder: Path = FOLDER,
) -> Changes | None:
    """Give a servo an id and a bit rate and find it there again.

    Args:
        line: The port, with this one servo on it (:func:`only_servo`).
        servo: Where it is now.
        ask: Shown what would be written.
        servo_id: New id, 0 to 252; ``None`` leaves it.
        baud: New rate, bit/s; ``None`` leaves it.
        folder: For the backup.

    Returns:
        What was written (nothing if it was so already); ``None`` if the user declined.

    Raises:
        SpecError: The id, the rate or the model is not possible.
        ServoFault: The servo refused, or is not found where it should be.
    """
    values: dict[str, int] = {}
    if servo_id is not None:
        if not 0 <= servo_id <= MAX_ID:
            raise SpecError(f"id {servo_id}", allowed=f"0 to {MAX_ID}")
        values["id"] = servo_id
    if baud is not None:
        if baud not in BAUD_RATES:
            raise SpecError(f"baud {baud}", allowed=", ".join(map(str, BAUD_RATES)))
        values["baud_rate"] = BAUD_RATES.index(baud)
    with line.servo(servo.id, servo.model, servo.baud) as access:
        return change(access, 0, values, ask, folder=folder, reopen=line.transport)


def restore_servo(
    line: Line, servo: FoundServo, backup: Backup, ask: Ask, *, folder: Path = FOLDER
) -> Changes | None:
    """Give a servo back what a backup kept, its id and bit rate included; as :func:`set_id`."""
    with line.servo(servo.id, servo.model, servo.baud) as access:
        return restore(access, 0, backup, ask, folder=folder, reopen=line.transport)
