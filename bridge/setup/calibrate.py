"""Measuring one unit of a robot by hand: first the sweep, then the home pose.

**The problem.** In this order, because a joint that is swept first shows at once whether its
reading jumps from 4095 to 0 on the way; homed first, the jump would be found when the file is
written. The robot is limp all the while. Reads that get lost are simply missing from the sweep.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bridge.ports import Connect, Ports, connect, ports_of
from bridge.servo.bus import ServoBus
from bridge.servo.clock import Clock
from bridge.servo.registers import TickScale, control_table
from bridge.setup.backup import FOLDER, Ask, change
from bridge.setup.calibration import Calibration, Home, JointCalibration, home_angle, zero_at
from robots.errors import BusTimeout, ServoFault, SpecError
from robots.spec import JointSpec, RobotSpec

PERIOD = 0.02
"""s between two looks while the joints are moved."""
LEAST_SWEEP = math.radians(10)
"""rad of the joint below which it was not swept."""
SAMPLES = 10
"""Readings that make up the home pose."""
STILL = 12
"""Ticks within which these readings lie if nobody moves the joint: one degree."""
TOLERANCE = math.radians(3)
"""rad that a home pose put by hand may be off when it is verified."""


@dataclass(slots=True)
class Sweep:
    """Where the joints have been, in ticks, jumps over the end of the turn unrolled."""

    low: dict[str, int] = field(default_factory=dict)
    high: dict[str, int] = field(default_factory=dict)
    last: dict[str, int] = field(default_factory=dict)
    """By joint name."""

    def see(self, ticks: dict[str, int], turns: dict[str, int]) -> None:
        """Take present positions; ``turns`` are the ticks in a turn of each servo."""
        for name, tick in ticks.items():
            before, turn = self.last.get(name, tick), turns[name]
            tick = before + (tick - before + turn // 2) % turn - turn // 2
            self.last[name] = tick
            self.low[name] = min(self.low.get(name, tick), tick)
            self.high[name] = max(self.high.get(name, tick), tick)


@contextmanager
def limp_robot(
    robot: RobotSpec,
    ports: Ports,
    clock: Clock,
    *,
    joints: Sequence[str] = (),
    connector: Connect = connect,
) -> Iterator[Limp]:
    """Yield a robot whose servos have answered and are limp.

    Args:
        robot: Which.
        ports: Where it is.
        clock: For time limits.
        joints: Names of the joints that take part; none for all.
        connector: Makes transports.

    Raises:
        BusError: A servo is missing, of another model, or its torque stays on.
        SpecError: A joint or bus is not there.
    """
    names = tuple(robot.joint(name).name for name in joints) or robot.joint_names
    with ExitStack() as stack:
        buses: list[ServoBus] = []
        for bus, port in ports_of(robot, ports).items():
            mine = [robot.joint(n) for n in names if robot.joint(n).servo.bus == bus]
            if not mine:
                continue
            found = ServoBus(mine, connector(robot, bus, port, clock, stack))
            stack.callback(found.close)
            found.open()
            found.identify()
            buses.append(found)
        for bus in buses:
            errors = bus.torque_off()
            if errors:
                raise errors[0]
        yield Limp(robot, tuple(buses), clock)


@dataclass(frozen=True, slots=True)
class Limp:
    """A robot that can be moved by hand and read."""

    robot: RobotSpec
    buses: tuple[ServoBus, ...]
    clock: Clock

    @property
    def joints(self) -> tuple[JointSpec, ...]:
        """The joints that take part."""
        return tuple(joint for bus in self.buses for joint in bus.joints)

    def ticks(self) -> dict[str, int]:
        """Return the present positions of those that answer, by joint name."""
        return {n: tick for bus in self.buses for n, tick in bus.ask("present_position").items()}

    def firmware(self) -> dict[str, int]:
        """Return the firmware versions by joint name."""
        return {
            name: bus.registers.read(index, "firmware_version")
            for bus in self.buses
            for index, name in enumerate(bus.joint_names)
        }

    def make_plain(self, ask: Ask, folder: Path = FOLDER) -> None:
        """Clear homing offset and drive mode of every servo; see :func:`~.backup.change`.

        Raises:
            ServoFault: The user declined: ticks would mean something else.
        """
        for bus in self.buses:
            for index in range(len(bus.joints)):
                plain = {"homing_offset": 0, "drive_mode": 0}
                if change(bus.registers, index, plain, ask, folder=folder) is None:
                    raise ServoFault(
                        "has an offset or reversal of its own",
                        where=bus.registers.who(index),
                        hint="calibration and play need both at 0",
                    )

    def sweep(
        self, done: Callable[[], bool], show: Callable[[Sweep], None] = lambda sweep: None
    ) -> Sweep:
        """Follow the joints while somebody moves them, until ``done``."""
        sweep = Sweep()
        turns = {joint.name: joint.servo.hardware.ticks for joint in self.joints}
        while True:
            ended = done()
            sweep.see(self.ticks(), turns)
            show(sweep)
            if ended:
                return sweep
            self.clock.sleep_until(self.clock.now() + PERIOD)

    def pose(self) -> dict[str, int]:
        """Return where the joints stand, in ticks: the middle of several readings.

        Raises:
            BusTimeout: A servo does not answer.
            ServoFault: A joint is being moved.
        """
        seen: dict[str, list[int]] = {joint.name: [] for joint in self.joints}
        for _ in range(SAMPLES):
            for name, tick in self.ticks().items():
                seen[name].append(tick)
            self.clock.sleep_until(self.clock.now() + PERIOD)
        silent = [name for name, ticks in seen.items() if not ticks]
        if silent:
            raise BusTimeout(f"no answer from {', '.join(silent)}", where=self.robot.name)
        for name, ticks in seen.items():
            if max(ticks) - min(ticks) > STILL:
                raise ServoFault(
                    "is being moved", where=name, hint="hold it still in the home pose"
                )
        return {name: round(float(np.median(ticks))) for name, ticks in seen.items()}


def measured(
    limp: Limp, sweep: Sweep, pose: dict[str, int], *, unit: str, home: Home
) -> Calibration:
    """Return the calibration that a sweep and a home pose make.

    Args:
        limp: The robot.
        sweep: Where its joints went.
        pose: Ticks in the home pose, by joint name.
        unit: Name of the unit.
        home: What that pose is.

    Raises:
        SpecError: Joints were not swept, a range crosses the end of the servo's turn, or the home
            pose is outside of the sweep; all that is wrong is named.
    """
    firmware = limp.firmware()
    found: dict[str, JointCalibration] = {}
    wrong: list[str] = []
    for joint in limp.joints:
        name, servo = joint.name, joint.servo
        # The sweep unrolls jumps from wherever it began; both are the same turn of the servo.
        low, high = sweep.low.get(name, 0), sweep.high.get(name, 0)
        turn = TickScale.of(0, 1, servo.ratio, [control_table(servo.model)])
        if float(turn.from_ticks(high - low)[0]) < LEAST_SWEEP:
            wrong.append(f"{name} was hardly moved")
        elif servo.mode == "position" and not (
            servo.hardware.first <= low <= high <= servo.hardware.last
        ):
            wrong.append(f"{name} passes the end of its servo's turn: turn the horn on the shaft")
        elif not low <= pose[name] <= high:
            wrong.append(f"{name} was not swept as far as the home pose")
        else:
            found[name] = JointCalibration(
                id=servo.id,
                model=servo.model,
                zero=zero_at(joint, pose[name], home),
                direction=servo.direction,
                range_min=low,
                range_max=high,
                firmware=firmware[name],
            )
    if wrong:
        raise SpecError("; ".join(wrong), where=limp.robot.name, hint="sweep again")
    return Calibration(limp.robot.name, unit, found)


@dataclass(frozen=True, slots=True)
class Deviation:
    """How a joint compares with its calibration."""

    joint: str
    off: float
    """rad by which it is off from the home pose it was put into."""
    problems: tuple[str, ...]
    """What is wrong; empty if nothing is."""


def verify(limp: Limp, calibration: Calibration, *, home: Home) -> list[Deviation]:
    """Compare a robot that stands in its home pose with its calibration; writes nothing.

    Raises:
        SpecError: The calibration is of another robot.
        BusError: A servo does not answer, or a joint is being moved.
    """
    robot = calibration.apply(limp.robot)
    pose, firmware = limp.pose(), limp.firmware()
    own = dict(_registers(limp, ("homing_offset", "drive_mode")))
    deviations: list[Deviation] = []
    for joint in limp.joints:
        name = joint.name
        if name not in calibration.joints:
            deviations.append(Deviation(name, math.nan, ("not calibrated",)))
            continue
        kept, servo = calibration.joints[name], robot.joint(name).servo
        scale = TickScale.of_servos([servo])
        off = float(scale.from_ticks(pose[name])[0]) - home_angle(joint, home)
        problems = [f"{register} is {value}" for register, value in own[name].items() if value]
        if abs(off) > TOLERANCE:
            problems.append(f"{math.degrees(off):+.1f} degrees from the home pose")
        if not kept.range_min <= pose[name] <= kept.range_max:
            problems.append("outside of its sweep")
        if kept.firmware not in (None, firmware[name]):
            problems.append(f"firmware {firmware[name]}, was {kept.firmware}")
        deviations.append(Deviation(name, off, tuple(problems)))
    return deviations


def _registers(limp: Limp, names: Iterable[str]) -> Iterator[tuple[str, dict[str, int]]]:
    for bus in limp.buses:
        for index, joint in enumerate(bus.joint_names):
            yield joint, {name: bus.registers.read(index, name) for name in names}
