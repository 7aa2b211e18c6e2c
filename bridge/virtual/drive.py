"""What moves a virtual servo's horn: the registers in force, the profile and the motor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bridge.servo.registers import (
    MODE_CURRENT,
    MODE_CURRENT_POSITION,
    MODE_EXTENDED_POSITION,
    MODE_POSITION,
    MODE_PWM,
    MODE_VELOCITY,
    ControlTable,
)
from bridge.virtual.motor import (
    MECHANICAL_TIME,
    RESISTANCE_DROP,
    STALL_HEAT,
    STEP,
    THERMAL_TIME,
    Motor,
    Profile,
)

REVERSE = 0x01
SLAVE = 0x02
TIME_BASED = 0x04
TORQUE_BY_GOAL = 0x08
"""Bits of Drive Mode."""
WATCHDOG_TRIPPED = -1
"""Value of Bus Watchdog once it has stopped the servo."""


@dataclass(slots=True)
class DriveSettings:
    """Registers that the motion needs at every step, decoded once per write."""

    torque: bool
    """Whether torque is on."""
    mode: int
    """Operating mode."""
    goal: float
    """rad of the horn."""
    speed: float
    """Of the profile, rad/s; 0 for a step."""
    acceleration: float
    """Of the profile, rad/s^2; 0 for a speed without ramp."""
    p: float
    """Position P gain: duty per rad."""
    i: float
    """Position I gain: duty per rad s."""
    limit: float
    """Largest duty, share of the supply."""
    duty: float
    """Goal PWM, share of the supply."""
    goal_current: float
    """Share of stall current."""
    goal_velocity: float
    """rad/s."""
    dead_band: float = 0.0
    """Position error without consequence, rad."""


class Drive:
    """A horn with motor and profile, run in fixed steps."""

    settings: DriveSettings

    def __init__(self, table: ControlTable, angle: float, motor: Motor | None = None) -> None:
        """Put the horn at an angle, rad; call :meth:`use` before :meth:`run`.

        Args:
            table: Control table of the model.
            angle: Of the horn, rad.
            motor: What turns it, at that angle; the default moves nothing but itself.
        """
        self.motor = motor or Motor(table.no_load_speed, angle=angle)
        self.profile = Profile()
        self._voltage = table.voltage
        self._still = False

    def use(self, settings: DriveSettings) -> None:
        """Follow other settings."""
        self.settings = settings
        self._still = False

    def aim(self, goal: float) -> None:
        """Follow another goal, rad."""
        self.settings.goal = goal
        self._still = False

    def wake(self) -> None:
        """Note that something outside has moved the horn."""
        self._still = False

    def run(self, steps: int, supply: float, load: Callable[[float], float] | None) -> None:
        """Integrate some steps.

        Args:
            steps: Of :data:`~bridge.virtual.motor.STEP` each.
            supply: V at the connector.
            load: Torque against positive motion as share of stall torque, from the angle in rad.
        """
        if self._still:
            self.motor.rest(steps * STEP)
            return
        if load is None and self._is_plain():
            self._follow(steps, supply)
            return
        for left in range(steps, 0, -1):
            before = self.motor.angle
            self._step(supply, load)
            if (
                abs(self.motor.angle - before) < 1e-9
                and abs(self.motor.velocity) < 1e-7
                and self.profile.velocity == 0.0
                and load is None
                and not self.motor.stuck
                and self.motor.error_sum == 0.0
            ):
                self._still = True
                self.motor.rest((left - 1) * STEP)
                break

    def _is_plain(self) -> bool:
        """Whether :meth:`_follow` knows all that acts on the horn."""
        settings, motor = self.settings, self.motor
        return (
            settings.torque
            and settings.mode in (MODE_POSITION, MODE_EXTENDED_POSITION)
            and not (settings.i or settings.acceleration or settings.dead_band or motor.stuck)
            and type(motor) is Motor
        )

    def _follow(self, steps: int, supply: float) -> None:
        """Integrate as :meth:`_step` does, to the last bit, but all steps in one piece.

        Nearly all of a virtual bus's time goes into servos that follow goals at a limited speed;
        without the calls it is a third.
        """
        settings, motor, profile = self.settings, self.motor, self.profile
        goal, most, p, limit = settings.goal, settings.speed, settings.p, settings.limit
        position, speed = profile.position, profile.velocity
        angle, velocity, current = motor.angle, motor.velocity, motor.current
        temperature, ambient, fastest = motor.temperature, motor.ambient, motor.no_load_speed
        volts, duty, left = self._voltage, motor.duty, steps
        while left:
            left -= 1
            distance = goal - position
            wanted = most if distance >= 0 else -most
            if most <= 0 or abs(wanted * STEP) >= abs(distance):
                speed, position = 0.0, goal
            else:
                speed, position = wanted, position + wanted * STEP
            amount = abs(current)
            share = supply * (1 - RESISTANCE_DROP * (amount if amount < 1.0 else 1.0)) / volts
            duty = (position - angle) * p
            if duty > limit:
                duty = limit
            elif duty < -limit:
                duty = -limit
            current = duty * share - velocity / fastest
            velocity += current * fastest / MECHANICAL_TIME * STEP
            before, angle = angle, angle + velocity * STEP
            heat = STALL_HEAT * current * current - (temperature - ambient)
            temperature += heat * STEP / THERMAL_TIME
            if speed == 0.0 and abs(angle - before) < 1e-9 and abs(velocity) < 1e-7:
                self._still = True
                break
        profile.position, profile.velocity = position, speed
        motor.angle, motor.velocity, motor.current, motor.duty = angle, velocity, current, duty
        motor.temperature, motor.error_sum = temperature, 0.0
        if left:
            motor.rest(left * STEP)

    def _step(self, supply: float, load: Callable[[float], float] | None) -> None:
        settings, motor = self.settings, self.motor
        if not settings.torque:
            motor.coast(STEP)
            return
        sag = 1 - RESISTANCE_DROP * min(1.0, abs(motor.current))
        supply = supply * sag / self._voltage
        torque = load(motor.angle) if load else 0.0
        mode, limit = settings.mode, settings.limit
        if mode == MODE_PWM:
            duty = settings.duty
        elif mode == MODE_VELOCITY:
            duty = settings.goal_velocity / (motor.no_load_speed * supply)
        elif mode == MODE_CURRENT:
            duty = (settings.goal_current + motor.velocity / motor.no_load_speed) / supply
        else:
            profile = self.profile
            profile.step(settings.goal, settings.speed, settings.acceleration, STEP)
            error = profile.position - motor.angle
            if settings.dead_band:
                error -= max(-settings.dead_band, min(settings.dead_band, error))
            duty = motor.control(error, settings.p, settings.i, limit)
            if mode == MODE_CURRENT_POSITION:
                most = abs(settings.goal_current)
                back = motor.velocity / motor.no_load_speed
                duty = max((back - most) / supply, min((back + most) / supply, duty))
        motor.drive(max(-limit, min(limit, duty)), supply, torque, STEP)
