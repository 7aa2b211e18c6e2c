"""How a virtual servo moves: profile, position controller, motor and heat.

**The problem.** A player is only tested by a servo that lags, saturates and warms up as a real one
does, and does so identically on every run. The chain of the real servo is kept, at a fixed step:

1. *Profile*: the goal becomes a reference that moves with limited speed and acceleration.
2. *Controller*: duty = (P / 128 * error + I / 65536 * sum of errors) / 885, errors in ticks, in the
   X series. These scalings are the maker's; they are what gives a servo its lag. For an XM430-W350
   (P 800, 46 rpm at 12 V) the lag to a ramp is 885 * 128 / 800 ticks / 3140 ticks/s = 45 ms. The
   scalings of the other series are in their tables; here gains are duty per rad.
3. *Motor*: a DC motor on its torque-speed line; the speed follows the duty with one mechanical time
   constant, and current is what the line leaves: stall current * (duty - speed / no-load speed).
4. *Heat*: copper losses against one thermal time constant.

The D and feed-forward gains are kept in the registers but do not act. Angles are rad of the horn.
Source of the gain scalings and duty limit: ROBOTIS e-manual, "Position PID gain", "Goal PWM".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

STEP = 0.002
"""Integration step, s."""
CONTROL_PERIOD = 0.001
"""Period of the servo's own controller, s: what one term of the I sum stands for."""
MECHANICAL_TIME = 0.015
"""Time constant of the loaded motor's speed, s: typical for a small robot's limb."""
FRICTION_TIME = 0.004
"""Time constant with which a limp servo's gearbox stops, s."""
AMBIENT = 25.0
"""degC."""
THERMAL_TIME = 120.0
"""s."""
STALL_HEAT = 160.0
"""Temperature rise that stall current would end at, K: a servo left stalled trips in a minute."""
RESISTANCE_DROP = 0.05
"""Share of the supply voltage lost in the cable at stall current."""


@dataclass(slots=True)
class Profile:
    """Moves a reference towards the goal with limited speed and acceleration."""

    position: float = 0.0
    """rad."""
    velocity: float = 0.0
    """rad/s."""

    def start(self, position: float) -> None:
        """Begin anew, at rest, where the horn is (rad)."""
        self.position, self.velocity = position, 0.0

    def step(self, goal: float, speed: float, acceleration: float, dt: float) -> None:
        """Advance by ``dt`` s; speed 0 means a step, acceleration 0 a speed without ramp."""
        distance = goal - self.position
        if speed <= 0:
            self.velocity, self.position = 0.0, goal
            return
        if acceleration <= 0:
            wanted = math.copysign(speed, distance)
        else:
            wanted = math.copysign(
                min(speed, math.sqrt(2 * acceleration * abs(distance))), distance
            )
            change = wanted - self.velocity
            limit = acceleration * dt
            wanted = self.velocity + max(-limit, min(limit, change))
        if abs(wanted * dt) >= abs(distance) and wanted * distance >= 0:
            self.velocity, self.position = 0.0, goal
        else:
            self.velocity, self.position = wanted, self.position + wanted * dt


@dataclass(slots=True)
class Motor:
    """State of the motor behind the horn.

    Everything electrical is a share of the nominal voltage and of the stall current, so that the
    same equations serve every model.
    """

    no_load_speed: float
    """rad/s at nominal voltage."""
    angle: float = 0.0
    """rad, of the horn, many turns."""
    velocity: float = 0.0
    """rad/s."""
    duty: float = 0.0
    """-1 to 1, share of the supply voltage."""
    current: float = 0.0
    """Share of stall current, signed."""
    temperature: float = AMBIENT
    """degC."""
    error_sum: float = 0.0
    """rad s, the I term's memory."""
    ambient: float = AMBIENT
    """Temperature of the air around it, degC."""
    stuck: bool = False
    """Whether something holds the horn where it is."""

    def control(self, error: float, p: float, i: float, limit: float) -> float:
        """Return the duty for a position error in rad, within +-``limit``.

        Args:
            error: rad.
            p: Duty per rad.
            i: Duty per rad s.
            limit: Largest duty.
        """
        if i:
            most = limit / i
            self.error_sum = max(-most, min(most, self.error_sum + error * STEP))
        else:
            self.error_sum = 0.0
        return max(-limit, min(limit, error * p + self.error_sum * i))

    def drive(self, duty: float, supply: float, load: float, dt: float) -> None:
        """Advance by ``dt`` s under a duty.

        Args:
            duty: -1 to 1.
            supply: Share of the nominal voltage at the servo.
            load: Torque against positive motion, share of stall torque.
            dt: s.
        """
        self.duty = duty
        if self.stuck:
            self.velocity = 0.0
            load = drive = self.current = duty * supply
        else:
            drive = self.current = duty * supply - self.velocity / self.no_load_speed
        acceleration = (drive - load) * self.no_load_speed / MECHANICAL_TIME
        self.velocity += acceleration * dt
        self.angle += self.velocity * dt
        self.warm(dt)

    def coast(self, dt: float) -> None:
        """Advance by ``dt`` s without torque: the gearbox stops the horn and holds it."""
        self.duty = self.current = self.error_sum = 0.0
        self.velocity *= 0.0 if self.stuck else math.exp(-dt / FRICTION_TIME)
        self.angle += self.velocity * dt
        self.warm(dt)

    def warm(self, dt: float) -> None:
        """Advance only the temperature by ``dt`` s, under the present current."""
        heat = STALL_HEAT * self.current * self.current - (self.temperature - self.ambient)
        self.temperature += heat * dt / THERMAL_TIME

    def rest(self, dt: float) -> None:
        """Advance only the temperature by ``dt`` s: nothing moves and the current stays."""
        goal = self.ambient + STALL_HEAT * self.current**2
        self.temperature += (goal - self.temperature) * (1 - math.exp(-dt / THERMAL_TIME))

    def brake(self) -> None:
        """Stop at once, for example because the horn meets a hand."""
        self.velocity = 0.0
