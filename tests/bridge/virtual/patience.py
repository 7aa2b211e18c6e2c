"""The stock SDK's port for a computer that is busy with other tests."""

from __future__ import annotations

import dynamixel_sdk as sdk


class PatientPort(sdk.PortHandler):
    """Waits ``patience`` ms for an answer, where the SDK gives up after 34 ms by the wall clock."""

    def __init__(self, name: str, baud: int, *, patience: float = 1000.0) -> None:
        super().__init__(name)
        self.baudrate = baud
        self.patience = patience

    def setPacketTimeout(self, packet_length: int) -> None:
        self.setPacketTimeoutMillis(self.patience)
