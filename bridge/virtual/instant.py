"""A horn that is where it is told to be, at once: for tests of what a program asks for."""

from __future__ import annotations

from collections.abc import Callable

from bridge.servo.registers import MODE_CURRENT, MODE_PWM, MODE_VELOCITY
from bridge.virtual.drive import Drive, DriveSettings
from bridge.virtual.motor import STEP


class InstantDrive(Drive):
    """Takes goals without time, torque or heat; profile, gains and loads mean nothing to it.

    The modes without a goal position turn the horn at the speed that an unloaded motor ends at.
    """

    def use(self, settings: DriveSettings) -> None:
        """Follow other settings."""
        super().use(settings)
        self._arrive()

    def aim(self, goal: float) -> None:
        """Follow another goal, rad."""
        super().aim(goal)
        self._arrive()

    def wake(self) -> None:
        """Go back to the goal after something outside has moved the horn."""
        super().wake()
        self._arrive()

    def run(self, steps: int, supply: float, load: Callable[[float], float] | None) -> None:
        """Turn on in the modes that have no goal position; see :meth:`Drive.run`."""
        del supply, load
        self.motor.velocity = self._speed()
        self.motor.angle += self.motor.velocity * steps * STEP

    def _speed(self) -> float:
        """Return rad/s."""
        settings, fastest = self.settings, self.motor.no_load_speed
        if not settings.torque:
            return 0.0
        if settings.mode == MODE_VELOCITY:
            return max(-fastest, min(fastest, settings.goal_velocity))
        if settings.mode == MODE_PWM:
            return settings.duty * fastest
        if settings.mode == MODE_CURRENT:
            return settings.goal_current * fastest
        return 0.0

    def _arrive(self) -> None:
        settings = self.settings
        if settings.torque and settings.mode not in (MODE_VELOCITY, MODE_PWM, MODE_CURRENT):
            self.motor.angle = settings.goal
            self.profile.start(settings.goal)
