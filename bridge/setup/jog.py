"""Moving a single joint by keys: small steps, slowly, and only while a key is held.

**The problem.** Somebody wants to see which way a joint turns and where it ends, on a robot whose
file may be wrong about both. So torque comes on with the goal where the horn is, the goal moves in
small steps within the limits at a low speed, it never runs far ahead of the joint, and when no key
comes it becomes where the joint is. The servo's own watchdog stops it if this program dies.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bridge.servo.bus import ServoBus
from bridge.servo.clock import Clock
from bridge.servo.registers import OPERATING_MODES, velocity_counts
from bridge.servo.transport import Transport
from bridge.setup.backup import FOLDER, Ask, change
from robots.errors import BusError, BusTimeout, ServoFault, SpecError
from robots.spec import JointSpec

UP, DOWN, QUIT = "+", "-", "q"
Keys = Callable[[], str | None]
"""Returns the key that was pressed since the last call, or ``None``; never waits."""


@dataclass(frozen=True, slots=True)
class JogSettings:
    """How to jog.

    Raises:
        SpecError: A value is out of its range.
    """

    step: float = math.radians(2)
    """rad per key."""
    speed: float = 0.5
    """Largest speed of the joint, rad/s."""
    lead: float = math.radians(10)
    """rad that the goal may be ahead of the joint."""
    deadman: float = 0.4
    """s without a key after which the joint stops."""
    watchdog: float = 0.5
    """s without a packet after which the servo stops by itself."""
    silence: float = 0.3
    """s without an answer after which it is given up."""
    period: float = 0.02
    """s between two looks."""
    tolerance: float = math.radians(5)
    """rad outside of its limits at which the joint may stand at the start."""

    def __post_init__(self) -> None:
        """Validate."""
        ranges = {
            "step": (math.radians(0.1), math.radians(10)),
            "speed": (0.05, 2.0),
            "deadman": (0.1, 2.0),
            "period": (0.005, 0.1),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise SpecError(f"{name} is {value:.3g}", allowed=f"{low:.3g} to {high:.3g}")


@dataclass(frozen=True, slots=True)
class Jogged:
    """How a joint was moved."""

    joint: str
    start: float
    """rad."""
    end: float
    """rad, where it stood when its torque went off."""
    lowest: float
    """rad, as far as it came."""
    highest: float
    """rad."""
    keys: int
    """Steps that were asked for."""


def jog(
    joint: JointSpec,
    transport: Transport,
    keys: Keys,
    clock: Clock,
    ask: Ask,
    *,
    settings: JogSettings | None = None,
    folder: Path = FOLDER,
    show: Callable[[float, float], None] = lambda position, goal: None,
) -> Jogged:
    """Move a joint by keys until :data:`QUIT`; its torque is off afterwards, whatever happens.

    Args:
        joint: Which; its limits are kept.
        transport: Its bus; opened and closed here.
        keys: :data:`UP`, :data:`DOWN` or :data:`QUIT`.
        clock: Gives the time and waits.
        ask: Asked before the operating mode is changed, if it is another.
        settings: How.
        folder: For the backup if something is changed.
        show: Told position and goal, rad, after every look.

    Raises:
        BusError: The servo is not there, is another model, reports an error, or falls silent.
    """
    settings = settings or JogSettings()
    bus = ServoBus([joint], transport)
    bus.open()
    armed = False
    try:
        bus.identify()
        errors = bus.torque_off()
        if errors:
            raise errors[0]
        _prepare(bus, joint, ask, settings, folder)
        armed = True
        bus.hold_present(settings.tolerance)
        bus.torque_on()
        bus.watchdog(settings.watchdog)
        return _follow(bus, joint, keys, clock, settings, show)
    finally:
        try:
            if armed:
                _relax(bus)
        finally:
            bus.close()


def _prepare(
    bus: ServoBus, joint: JointSpec, ask: Ask, settings: JogSettings, folder: Path
) -> None:
    registers = bus.registers
    status = registers.read(0, "hardware_error_status")
    if status:
        raise registers.hardware_fault(0, status)
    wanted = {
        "homing_offset": 0,
        "drive_mode": 0,
        "operating_mode": OPERATING_MODES[joint.servo.mode],
    }
    if change(registers, 0, wanted, ask, folder=folder) is None:
        raise ServoFault(
            "counts or moves otherwise than the robot's file says",
            where=registers.who(0),
            hint="let it be changed, or correct robot.toml",
        )
    registers.settle(0, "bus_watchdog", 0)
    registers.settle(0, "profile_acceleration", 0)
    speed = min(settings.speed, joint.max_velocity)
    counts = velocity_counts(speed * joint.servo.ratio, bus.tables[0])
    registers.settle(0, "profile_velocity", registers.capped(0, counts))


def _relax(bus: ServoBus) -> None:
    errors: list[BusError] = bus.torque_off()
    if not errors:
        try:
            bus.watchdog(0)
        except BusError as error:
            errors.append(error)
    if errors:
        raise errors[0]


def _follow(
    bus: ServoBus,
    joint: JointSpec,
    keys: Keys,
    clock: Clock,
    settings: JogSettings,
    show: Callable[[float, float], None],
) -> Jogged:
    present = float(bus.positions()[0])
    goal = start = lowest = highest = present
    pressed = 0
    seen = last_key = clock.now()
    moving = False
    while (key := keys()) != QUIT:
        now = clock.now()
        if key in (UP, DOWN):
            step = settings.step if key == UP else -settings.step
            goal = min(max(goal + step, present - settings.lead), present + settings.lead)
            goal = min(max(goal, joint.lower), joint.upper)
            last_key, moving = now, True
            pressed += 1
        elif moving and now - last_key > settings.deadman:
            goal, moving = min(max(present, joint.lower), joint.upper), False
        # Sent every time: a lost goal is made good, and the servo's watchdog hears us.
        bus.write_goals([goal])
        bus.begin_read()
        state = bus.end_read(clock.now())
        if state.alert[0]:
            raise bus.fault_of(0)
        if state.seen[0]:
            seen, present = state.time, float(state.position[0])
            lowest, highest = min(lowest, present), max(highest, present)
        elif state.time - seen > settings.silence:
            raise BusTimeout(
                f"no answer for {settings.silence:.1f} s",
                where=bus.registers.who(0),
                hint="check power and cable",
            )
        show(present, goal)
        clock.sleep_until(now + settings.period)
    return Jogged(joint.name, start, present, lowest, highest, pressed)
