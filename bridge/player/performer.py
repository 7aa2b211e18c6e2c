"""The state machine of a performance; :func:`bridge.player.play` sets it up.

**The problem.** Both robots must be told the same moment of the dance at the same time, for ever
without drift, on a machine that is sometimes late. So tick k has the absolute time t0 + k dt, both
goals are computed from it (:class:`~bridge.player.phase.Phase`), both commands leave before any
answer is awaited, and ticks whose time has passed are left out: goals are never queued.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

from bridge.player.path import SmoothPath
from bridge.player.phase import Phase
from bridge.player.puppet import Puppet
from bridge.player.ramp import Ramp, ramp_time
from bridge.player.recorder import Recorder
from bridge.player.settings import DEFAULT_RATE, PlayerSettings
from bridge.player.telemetry import Performance, Telemetry
from bridge.servo.clock import Clock
from bridge.stop import stop_level
from robots.errors import BusError, BusTimeout, DuetError
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

OnProgress = Callable[[str, float], None]
"""Called with the player's state and the share of it that is done."""

GENTLE = ("RAMP", "PLAY")
"""States in which a first stop slows down along the path."""


class Way(Protocol):
    """What a robot follows: a ramp or a trajectory."""

    def at(self, time: float, /) -> FloatArray:
        """Return positions ``[D]`` rad at a phase in s."""
        ...


class RelaxNow(Exception):
    """Nothing moves yet, or a second stop has come: straight to relaxation."""


class Performer:
    """One performance from discovery to relaxation."""

    def __init__(
        self,
        puppets: Sequence[Puppet],
        settings: PlayerSettings,
        *,
        clock: Clock,
        file: Telemetry,
        on_progress: OnProgress | None,
        stop: threading.Event,
    ) -> None:
        """Take the robots; nothing is opened yet."""
        self.puppets = tuple(puppets)
        self.settings = settings
        self.clock = clock
        self.file = file
        self.on_progress = on_progress or (lambda state, share: None)
        self.stop = stop
        parts = [puppet.part for puppet in puppets]
        self.rate = settings.rate or min(
            DEFAULT_RATE, 1000 / max(part.robot.cycle_ms for part in parts)
        )
        self.duration = max(part.trajectory.duration for part in parts)
        self.recorder = Recorder([puppet.person for puppet in puppets], parts, self.rate)
        self._touched = False
        self._last_tick = math.nan
        self._next_look = 0.0
        self._looks = 0

    def run(self) -> Performance:
        """Go through all states; whatever happens, end relaxed.

        Raises:
            BusError: Hardware failed; also if torque-off failed at the end.
        """
        self.file.header(
            {
                "rate": self.rate,
                "speed": self.settings.speed,
                "duration": self.duration,
                "robots": {
                    puppet.person: {
                        "name": puppet.part.robot.name,
                        "joints": list(puppet.names),
                    }
                    for puppet in self.puppets
                },
            }
        )
        outcome, failure = "completed", None
        errors: list[BusError] = []
        try:
            self._prepare()
            self._arm()
            outcome = self._perform()
        except RelaxNow:
            outcome = "stopped"
        except (DuetError, KeyboardInterrupt) as error:
            outcome, failure = f"{type(error).__name__}: {error}", error
            self._freeze(error)
        finally:
            errors = self._relax()
        performance = self.recorder.performance(outcome)
        self.file.summary(performance)
        if failure is not None:
            for error in errors:
                failure.add_note(f"while relaxing: {error}")
            raise failure
        if errors:
            for error in errors[1:]:
                errors[0].add_note(f"also: {error}")
            raise errors[0]
        return performance

    # -- the states -------------------------------------------------------------------------------

    def _enter(self, state: str) -> None:
        log.info("%s", state)
        self.file.event(self.clock.now(), "state", state=state)
        self.on_progress(state, 0.0)

    def _prepare(self) -> None:
        for puppet in self.puppets:
            puppet.discover()
        self._enter("DISCOVERED")
        for puppet in self.puppets:
            self._heed_early_stop()
            self._touched = True
            puppet.configure()
        self._enter("CONFIGURED")

    def _arm(self) -> None:
        for puppet in self.puppets:
            self._heed_early_stop()
            puppet.hold(self.settings.start_tolerance)
            puppet.torque_on()
        # Last, because a bus on which nothing is said would trip it.
        for puppet in self.puppets:
            puppet.watchdog(self.settings.watchdog)
        self._enter("ARMED")

    def _heed_early_stop(self) -> None:
        if self.stop.is_set():
            raise RelaxNow

    def _perform(self) -> str:
        settings = self.settings
        moves: list[tuple[FloatArray, FloatArray]] = []
        duration = settings.ramp_time
        for puppet in self.puppets:
            start, first = puppet.goal.copy(), puppet.part.trajectory.position[0]
            fastest = puppet.part.robot.max_velocity * settings.ramp_speed
            duration = max(duration, ramp_time(start, first, fastest, settings.ramp_time))
            moves.append((start, first))
        ramps = [Ramp(start, first, duration) for start, first in moves]
        dance = [self._path(puppet) for puppet in self.puppets]
        if not (
            self._stream("RAMP", ramps, duration)
            and self._stream("PLAY", dance, self.duration, settings.speed)
        ):
            self._stream("HOLD", self._still(), settings.hold_time)
            return "stopped"
        self._stream("SETTLE", self._still(), settings.settle_time)
        return "completed"

    def _path(self, puppet: Puppet) -> SmoothPath:
        robot = puppet.part.robot
        return SmoothPath(
            puppet.part.trajectory,
            lower=robot.lower,
            upper=robot.upper,
            max_velocity=robot.max_velocity / self.settings.speed,
        )

    def _still(self) -> list[Ramp]:
        return [Ramp(puppet.goal, puppet.goal, 0.0) for puppet in self.puppets]

    def _freeze(self, error: BaseException) -> None:
        """Hold both robots where they were told to be, as far as that still works."""
        log.info("%s", error)  # whoever called is told by the exception
        self._enter("FAULT")
        self.file.event(self.clock.now(), "fault", error=str(error), type=type(error).__name__)
        if math.isnan(self._last_tick):
            return
        end = self.clock.now() + self.settings.hold_time
        while (now := self.clock.now()) < end and stop_level(self.stop) < 2:
            for puppet in self.puppets:
                puppet.repeat()
            self.clock.sleep_until(now + 1 / self.rate)

    def _relax(self) -> list[BusError]:
        """Torque off everywhere, whatever fails; return what failed."""
        errors: list[BusError] = []
        if self._touched:
            for puppet in self.puppets:
                failed = puppet.relax()
                errors += failed
                if not failed:
                    # Limp now; a client that comes after us shall not meet our watchdog.
                    puppet.forget_watchdog()
        for error in errors:
            log.error("while relaxing: %s", error)
            self.file.event(self.clock.now(), "relax failed", error=str(error))
        self._enter("RELAX")
        return errors

    # -- streaming --------------------------------------------------------------------------------

    def _stream(self, state: str, ways: Sequence[Way], duration: float, rate: float = 1.0) -> bool:
        """Lead both robots along their ways; return whether the end was reached."""
        self._enter(state)
        period = 1 / self.rate
        start = self.clock.now()
        phase = Phase(start, rate)
        tick = 0
        while True:
            scheduled = start + tick * period
            self.clock.sleep_until(scheduled)
            now = self.clock.now()
            self._require_punctual(now, period)
            level = stop_level(self.stop)
            if level >= 2:
                raise RelaxNow
            if level and state in GENTLE and not phase.stopping:
                self.file.event(now, "stop")
                phase.stop(scheduled, self.settings.stop_time)
            at = min(phase.at(scheduled), duration)
            self._tick(state, scheduled, now, at, [way.at(at) for way in ways])
            self.on_progress(state, at / duration if duration else 1.0)
            if phase.stopped(scheduled):
                return False
            if at >= duration:
                return True
            passed = math.ceil((self.clock.now() - start) / period - 1e-9)
            following = max(tick + 1, passed)
            if state == "PLAY":
                self.recorder.drop(following - tick - 1)
            tick = following

    def _require_punctual(self, now: float, period: float) -> None:
        stall = now - self._last_tick - period
        if stall > self.settings.max_stall:
            raise BusTimeout(
                f"this computer paused for {stall:.2f} s in the middle of a performance",
                allowed=f"{self.settings.max_stall:.2f} s",
                hint="close other programs, or play at a lower rate",
            )
        self._last_tick = now

    def _tick(
        self, state: str, scheduled: float, now: float, at: float, goals: Sequence[FloatArray]
    ) -> None:
        sent: list[float] = []
        for puppet, goal in zip(self.puppets, goals, strict=True):
            puppet.send(goal)
            sent.append(self.clock.now())
        for puppet in self.puppets:
            puppet.begin_read()
        states = [puppet.end_read(self.clock) for puppet in self.puppets]
        for puppet, goal, servos, when in zip(self.puppets, goals, states, sent, strict=True):
            self.file.tick(
                scheduled,
                robot=puppet.person,
                state=state,
                phase=at,
                goal=goal,
                servos=servos,
                late=now - scheduled,
                sent=when - scheduled,
            )
        if state == "PLAY":
            self.recorder.tick(scheduled, now - scheduled, max(sent) - min(sent), goals, states)
        for puppet, servos in zip(self.puppets, states, strict=True):
            puppet.judge(servos, self.settings)
        if now >= self._next_look:
            self._next_look = now + self.settings.health_period
            puppet = self.puppets[self._looks % len(self.puppets)]
            self._looks += 1
            self.file.event(now, "health", robot=puppet.person, **puppet.look_after())
