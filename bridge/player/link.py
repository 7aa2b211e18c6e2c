"""One bus of a robot, as the player sees it: it can be lost, come back, and be let go of."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from bridge.player.health import Health
from bridge.servo.bus import ServoBus
from bridge.servo.packets import BROADCAST
from robots.errors import BusCorrupt, BusError, BusTimeout, PortLost, ServoFault
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

RETRY_TIME = 0.1
"""Time between two attempts to open a lost port, s."""
SHOWN = 6
"""Differences that are named before the others are only counted."""
CUT_TIMES = 3
"""How often torque-off is broadcast: nobody answers, so once may get lost."""

STRENGTHS = {"goal_pwm": "pwm_limit", "goal_current": "current_limit"}
"""Registers that bound a servo's effort, and those that hold their largest value. Goal PWM bounds
it in every mode that follows a position, Goal Current in current-based position mode alone."""

Eeprom = Literal["keep", "write", "free"]
"""What may happen to EEPROM that differs: refuse, write after a backup, or write (virtual)."""

T = TypeVar("T")


class Link:
    """The servos behind one port, and whether that port still works."""

    def __init__(self, bus: ServoBus, columns: NDArray[np.int64]) -> None:
        """Take a bus and the joints ``[D]`` of the robot that hang on it."""
        self.bus = bus
        self.columns = columns
        self.health: Health | None = None
        """Judge of the servos, once :meth:`configure` or :meth:`inspect` is through."""
        self.lost: PortLost | None = None
        """Why the port is gone; ``None`` while it works."""
        self._next_try = 0.0
        self._strengths: dict[str, list[int]] = {}

    # -- setting up -------------------------------------------------------------------------------

    def inspect(self) -> None:
        """Look at the servos without writing anything.

        Raises:
            ServoFault: A servo has a latched error, or an offset or reversal of its own.
        """
        for index in range(len(self.bus.ids)):
            self.bus.require_plain(index)
        self.health = Health(self.bus)

    def differences(self) -> list[str]:
        """Return in words where EEPROM differs from what the robot's file asks for."""
        found: list[str] = []
        for index in range(len(self.bus.ids)):
            for name, wanted in self.bus.permanent(index).items():
                value = self.bus.registers.read(index, name)
                if value != wanted:
                    found.append(f"{self.bus.registers.who(index)}: {name} {value} -> {wanted}")
        return found

    def configure(self, eeprom: Eeprom, backups: Path) -> None:
        """Torque off; mode, limits, gains and speed ceilings as in the robot's file.

        Raises:
            ServoFault: EEPROM would have to be written, and may not.
        """
        if eeprom == "keep":
            different = self.differences()
            if different:
                more = len(different) - SHOWN
                some = different[:SHOWN] + ([f"and {more} more"] if more > 0 else [])
                raise ServoFault(
                    f"the EEPROM of servos differs from the robot's file: {'; '.join(some)}",
                    where=self.bus.port,
                    hint="play with --write-eeprom once: it makes a backup and writes them",
                )
        elif eeprom == "write":
            self._write_eeprom(backups)
        self.bus.configure()
        self.health = Health(self.bus)
        self._strengths = {
            name: [self.bus.registers.read(index, limit) for index in range(len(self.bus.ids))]
            for name, limit in STRENGTHS.items()
            if self._bounds(name)
        }

    def _bounds(self, name: str) -> bool:
        """Whether a register bounds the effort of the servos here and can be written at once."""
        if name == "goal_current":
            modes = {joint.servo.mode for joint in self.bus.joints}
            if "current_based_position" not in modes:
                return False
        places = {(t[name].address, t[name].length) if name in t else None for t in self.bus.tables}
        return len(places) == 1 and None not in places

    def _write_eeprom(self, backups: Path) -> None:
        from bridge.setup.backup import change

        for error in self.bus.torque_off():
            raise error
        for index in range(len(self.bus.ids)):
            wanted = self.bus.permanent(index)
            change(self.bus.registers, index, wanted, lambda text: True, folder=backups)

    # -- while the port may go away ---------------------------------------------------------------

    def attempt(self, call: Callable[[], T]) -> T | None:
        """Call, unless the port is lost; note if it is lost now.

        Raises:
            ServoFault: A servo says so.
        """
        if self.lost is not None:
            return None
        try:
            return call()
        except PortLost as error:
            log.warning("%s", error)
            self.lost = error
        except (BusTimeout, BusCorrupt) as error:
            log.info("%s", error)
        return None

    def reopen(self, now: float) -> None:
        """Try now and then to open a lost port again and find the same servos behind it.

        Raises:
            ServoFault: Others are there.
        """
        if self.lost is None or now < self._next_try:
            return
        self._next_try = now + RETRY_TIME
        self.bus.close()
        try:
            self.bus.open()
            self.bus.transport.ping(self.bus.ids[0])  # at once, before a round that takes long
            self.bus.identify()
            self.lost = None
        except (PortLost, BusTimeout, BusCorrupt) as error:
            log.debug("%s", error)

    def revive(self, tolerance: float, watchdog: float) -> FloatArray | None:
        """Make sure that servos that were away still hold; free those that stopped by themselves.

        Returns:
            Their goals ``[d]`` rad, now the present positions, if the watchdog had stopped any.

        Raises:
            ServoFault: A servo has lost its torque.
        """
        registers = self.bus.registers
        for index in np.flatnonzero(registers.read_all("torque_enable") == 0):
            raise ServoFault(
                "has lost its torque",
                where=registers.who(int(index)),
                hint="check the supply: a servo that restarts comes back limp",
            )
        if (registers.read_all("bus_watchdog") >= 0).all():
            return None
        self.bus.watchdog(0)
        goal = self.bus.hold_present(tolerance)
        self.bus.watchdog(watchdog)
        return goal

    # -- letting go -------------------------------------------------------------------------------

    @property
    def yields(self) -> bool:
        """Whether the servos' strength can be set."""
        return bool(self._strengths)

    def exert(self, share: float) -> None:
        """Set the servos' strength as a share of the most, see :data:`STRENGTHS`."""
        for name, most in self._strengths.items():
            self.bus.registers.write_all(name, [round(share * value) for value in most])

    def cut(self) -> None:
        """Broadcast torque off, a few times; whatever hears on this wire obeys."""
        register = self.bus.tables[0]["torque_enable"]
        for _ in range(CUT_TIMES):
            try:
                self.bus.transport.write(BROADCAST, register.address, register.encode(0))
            except BusError as error:
                log.warning("broadcasting torque off failed: %s", error)

    def relax(self) -> list[BusError]:
        """Try to switch torque off, whatever failed before; return what failed.

        A watchdog and a strength that would puzzle whoever comes next are taken back.
        """
        if self.lost is not None:
            self._open_once_more()
        errors = self.bus.torque_off()
        if errors:
            self.cut()
            return errors
        try:
            self.bus.watchdog(0)
            for name, most in self._strengths.items():
                self.bus.registers.ensure(name, most)
        except BusError as error:
            log.warning("some registers stay set: %s", error)
        return []

    def _open_once_more(self) -> None:
        self.bus.close()
        try:
            self.bus.open()
        except PortLost as error:
            log.debug("%s", error)
