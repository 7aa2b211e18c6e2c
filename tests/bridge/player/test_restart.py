"""A servo that restarts while nobody looks has forgotten what limits it."""

from __future__ import annotations

import pytest

from bridge.virtual import Fault
from robots.errors import ServoFault
from tests.bridge.player.stage import SMALL, Stage


def test_a_servo_that_restarts_between_setting_up_and_torque_gets_none():
    """Its goal is where it stands, so only the missing speed ceiling gives it away."""
    stage = Stage(robots=SMALL)
    joint = SMALL[0].joints[1]

    def dip(state: str, share: float) -> None:
        if state == "CONFIGURED":
            now = stage.clock.now()
            fault = Fault("brownout", now, now + 0.001, servo_id=joint.servo.id, value=0.0)
            stage.wires[0].faults.faults.append(fault)
            stage.clock.sleep_until(now + 0.5)  # it has booted before it is asked again

    with pytest.raises(ServoFault, match=rf"{joint.name}.*speed ceiling"):
        stage.play(on_progress=dip)
    assert stage.torques() == [0] * 6
