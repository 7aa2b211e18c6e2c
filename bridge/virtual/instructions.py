"""What a virtual servo does with a Protocol 2.0 instruction that is for it alone (or for all)."""

from __future__ import annotations

from collections.abc import Callable

from bridge.servo import packets
from bridge.servo.packets import Packet
from bridge.virtual.servo import VirtualServo

CLEAR_KEY = b"\x01\x44\x58\x4c\x22"
"""Parameters of the one Clear that exists: the multi-turn position."""
BACKUP_KEY = b"CTRL"
"""What follows the task of a Control Table Backup."""

Act = Callable[[VirtualServo], tuple[int, bytes]]
"""Carries an instruction out and returns (error, data) of the answer."""


def single(packet: Packet, now: float) -> tuple[Act, int]:
    """Return what to do, and the least Status Return Level at which the servo answers."""
    params = packet.params
    level = 1 if packet.code == packets.READ else 2

    def act(servo: VirtualServo) -> tuple[int, bytes]:
        match packet.code:
            case packets.READ:
                if len(params) != 4:
                    return packets.ERROR_LENGTH, b""
                return servo.read(word(params, 0), word(params, 2))
            case packets.WRITE | packets.REG_WRITE:
                if len(params) < 3:
                    return packets.ERROR_LENGTH, b""
                write = servo.write if packet.code == packets.WRITE else servo.register_write
                return write(word(params, 0), params[2:]), b""
            case packets.ACTION:
                return servo.action(), b""
            case packets.REBOOT:
                servo.reboot(now)
                return 0, b""
            case packets.FACTORY_RESET:
                if len(params) != 1:
                    return packets.ERROR_LENGTH, b""
                everybody = packet.servo_id == packets.BROADCAST
                return servo.factory_reset(params[0], now, everybody=everybody), b""
            case packets.CLEAR:
                right = params == CLEAR_KEY
                return (servo.clear_turns() if right else packets.ERROR_RANGE), b""
            case packets.BACKUP:
                right = params[1:] == BACKUP_KEY
                return (servo.back_up(params[0], now) if right else packets.ERROR_RANGE), b""
        return packets.ERROR_INSTRUCTION, b""

    return act, level


def word(data: bytes, at: int) -> int:
    """Return two bytes, the low one first, as a number."""
    return data[at] | data[at + 1] << 8
