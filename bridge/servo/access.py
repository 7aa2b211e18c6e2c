"""The registers of a robot's servos, by joint index and register name.

**The problem.** Answers get lost and damaged on a wire, a write that nobody answers may not have
arrived, and a bare "timeout" helps nobody who stands before twenty servos. So everything here is
tried a few times, what matters is read back, and errors name joint, id and port.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bridge.servo.registers import control_table, hardware_error_names
from bridge.servo.transport import Transport
from robots.errors import BusCorrupt, BusTimeout, ServoFault, SpecError
from robots.spec import JointSpec

ATTEMPTS = 3
"""How often an instruction is sent before its failure counts."""
SHARED = ("goal_position", "present_position", "torque_enable", "bus_watchdog")
"""Registers that are written or read for all servos at once: at the same address in all models."""

T = TypeVar("T")


class RegisterAccess:
    """Named registers of the servos behind one port."""

    def __init__(self, joints: Sequence[JointSpec], transport: Transport) -> None:
        """Take the joints whose servos hang on this port.

        Raises:
            SpecError: A servo has no control table, or the tables keep the streamed registers at
                different places.
        """
        if not joints:
            raise SpecError("a bus without servos", where=transport.port)
        self.transport = transport
        self.ids = tuple(joint.servo.id for joint in joints)
        self.joint_names = tuple(joint.name for joint in joints)
        self.tables = tuple(control_table(joint.servo.model) for joint in joints)
        self.first = self.tables[0]
        for table in self.tables:
            for name in SHARED:
                if table[name].address != self.first[name].address:
                    raise SpecError(
                        f"{table.name} and {self.first.name} cannot share a bus: their"
                        f" '{name}' lie at different addresses",
                        where=transport.port,
                    )

    def who(self, index: int) -> str:
        """Return joint name, id and port of a servo, for messages."""
        return f"{self.joint_names[index]} (id {self.ids[index]}, {self.transport.port})"

    def hardware_fault(self, index: int, status: int) -> ServoFault:
        """Return the error that a value of Hardware Error Status stands for."""
        names = ", ".join(hardware_error_names(status)) or "cleared meanwhile"
        return ServoFault(
            f"hardware error: {names}",
            where=self.who(index),
            hint="let it cool, remove the load or check the supply, then power-cycle it",
        )

    def retry(self, index: int, call: Callable[[], T]) -> T:
        """Call up to :data:`ATTEMPTS` times; name the joint in what is raised at last."""
        left = ATTEMPTS
        while True:
            left -= 1
            try:
                return call()
            except (BusTimeout, BusCorrupt) as error:
                if not left:
                    raise type(error)(error.what, where=self.who(index), hint=error.hint) from error
            except ServoFault as error:
                raise ServoFault(error.what, where=self.who(index), hint=error.hint) from error

    def read(self, index: int, name: str) -> int:
        """Return the value of one register."""
        register = self.tables[index][name]
        _, data = self.retry(
            index,
            lambda: self.transport.read(self.ids[index], register.address, register.length),
        )
        return register.decode(data)

    def write(self, index: int, name: str, value: int) -> None:
        """Write one register."""
        register = self.tables[index][name]
        self.retry(
            index,
            lambda: self.transport.write(self.ids[index], register.address, register.encode(value)),
        )

    def settle(self, index: int, name: str, value: int) -> None:
        """Make a register hold a value: written only if it differs, then read back."""
        if self.read(index, name) == value:
            return
        self.write(index, name, value)
        found = self.read(index, name)
        if found != value:
            raise ServoFault(f"{name} stays {found} instead of {value}", where=self.who(index))

    def capped(self, index: int, speed: int) -> int:
        """Return a count of Profile Velocity, at most Velocity Limit where that binds it."""
        if self.tables[index]["profile_velocity"].max == "velocity_limit":
            return min(speed, self.read(index, "velocity_limit"))
        return speed

    def write_all(self, name: str, values: ArrayLike) -> None:
        """Write one register of all servos with one packet."""
        register = self.first[name]
        encoded = [register.encode(int(value)) for value in np.asarray(values)]
        data = np.frombuffer(b"".join(encoded), np.uint8).reshape(len(self.ids), -1)
        self.transport.sync_write(register.address, self.ids, data)

    def ensure(self, name: str, values: ArrayLike) -> NDArray[np.int64]:
        """Write one register of all servos until it reads back, a few times; return what does."""
        wanted = np.asarray(values, np.int64)
        found = wanted
        for _ in range(ATTEMPTS):
            self.write_all(name, wanted)
            found = self.read_all(name)
            if np.array_equal(found, wanted):
                break
        return found

    def ask(self, name: str) -> dict[int, int]:
        """Read one register of all servos; return the values by index of those that answered."""
        register = self.first[name]
        self.transport.sync_read_begin(register.address, register.length, self.ids)
        answer = self.transport.sync_read_end()
        return {
            int(index): register.decode(answer.data[index].tobytes())
            for index in np.flatnonzero(answer.seen)
        }

    def read_all(self, name: str) -> NDArray[np.int64]:
        """Read one register of all servos; ask those that did not answer again, one by one."""
        found = self.ask(name)
        for index in range(len(self.ids)):
            if index not in found:
                found[index] = self.read(index, name)
        return np.array([found[index] for index in range(len(self.ids))], np.int64)
