"""The narrow seam to a servo wire: (id, address, bytes).

:mod:`bridge.servo.access` and :mod:`bridge.servo.bus` need no more than :class:`Transport`; any
client library fits behind it. The default is :mod:`bridge.servo.sdk_transport`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class SyncAnswer:
    """What servos answered to a sync read; rows follow the ids that were asked."""

    data: NDArray[np.uint8]
    """``[N, length]``, each row in one piece; meaningless where :attr:`seen` is false."""
    seen: NDArray[np.bool_]
    """``[N]`` who answered."""
    alert: NDArray[np.bool_]
    """``[N]`` who says that it has a hardware error."""


class Transport(Protocol):
    """Sends instructions over one port; servos are ids, registers are addresses.

    Every method raises only :class:`PortLost`, :class:`BusTimeout`, :class:`BusCorrupt` or
    :class:`ServoFault`.
    """

    port: str

    def open(self) -> None:
        """Open the port."""
        ...

    def close(self) -> None:
        """Close the port; never raises."""
        ...

    def ping(self, servo_id: int) -> int:
        """Return the model number of a servo."""
        ...

    def read(self, servo_id: int, address: int, length: int) -> tuple[int, bytes]:
        """Return (alert bit, data)."""
        ...

    def write(self, servo_id: int, address: int, data: bytes) -> int:
        """Write and return the alert bit of the answer."""
        ...

    def sync_write(self, address: int, ids: Sequence[int], data: NDArray[np.uint8]) -> None:
        """Write a row of ``data`` ``[N, length]`` to each servo at once; nobody answers."""
        ...

    def sync_read_begin(
        self, address: int, length: int, ids: Sequence[int], *, fast: bool = False
    ) -> None:
        """Ask several servos at once; ``fast`` for one chained answer (Fast Sync Read).

        A client that cannot ask without waiting only notes the request.
        """
        ...

    def sync_read_end(self) -> SyncAnswer:
        """Return what was asked for; servos that did not answer are marked, not raised."""
        ...
