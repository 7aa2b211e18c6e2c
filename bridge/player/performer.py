"""The state machine of a performance; :func:`bridge.player.play` sets it up."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bridge.player.link import Eeprom
from bridge.player.path import SmoothPath
from bridge.player.puppet import Puppet
from bridge.player.ramp import Ramp, ramp_time
from bridge.player.recorder import Recorder
from bridge.player.settings import PlayerSettings
from bridge.player.streamer import OnProgress, RelaxNow, Streamer
from bridge.player.telemetry import Performance, Telemetry
from bridge.servo.clock import Clock
from bridge.stop import CUT, RELAX, stop_level
from robots.errors import BusError, DuetError
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)


class Performer:
    """One performance from discovery to relaxation."""

    def __init__(
        self,
        puppets: Sequence[Puppet],
        settings: PlayerSettings,
        *,
        period: float,
        clock: Clock,
        file: Telemetry,
        on_progress: OnProgress | None,
        stop: threading.Event,
        eeprom: Sequence[Eeprom],
        backups: Path,
    ) -> None:
        """Take the robots; nothing is opened yet.

        Args:
            puppets: Who performs.
            settings: How.
            period: Time between two ticks, s.
            clock: Gives the time and waits.
            file: Takes what happens.
            on_progress: Told about the state and how much of it is done.
            stop: Set to stop.
            eeprom: Per robot what may happen to EEPROM that differs.
            backups: Folder for what it held before.
        """
        self.puppets = tuple(puppets)
        self.settings = settings
        self.clock = clock
        self.file = file
        self.stop = stop
        self.eeprom = tuple(eeprom)
        self.backups = backups
        self.period = period
        parts = [puppet.part for puppet in puppets]
        self.duration = max(part.trajectory.duration for part in parts)
        self.recorder = Recorder([puppet.person for puppet in puppets], parts, 1 / period)
        self.streamer = Streamer(
            puppets,
            settings,
            period=period,
            clock=clock,
            file=file,
            recorder=self.recorder,
            on_progress=on_progress,
            stop=stop,
        )
        self._touched = False
        self._armed = False

    def run(self) -> Performance:
        """Go through all states; whatever happens, end relaxed.

        Raises:
            BusError: Hardware failed; also if torque-off failed at the end.
        """
        self._write_header()
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
            self._fault(error)
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

    def _write_header(self) -> None:
        robots = {
            puppet.person: {"name": puppet.part.robot.name, "joints": list(puppet.names)}
            for puppet in self.puppets
        }
        self.file.header(
            {
                "rate": 1 / self.period,
                "speed": self.settings.speed,
                "duration": self.duration,
                "dry_run": self.settings.dry_run,
                "robots": robots,
            }
        )

    # -- the states -------------------------------------------------------------------------------

    def _prepare(self) -> None:
        for puppet in self.puppets:
            puppet.discover()
        self.streamer.enter("DISCOVERED")
        for puppet, eeprom in zip(self.puppets, self.eeprom, strict=True):
            self._heed_early_stop()
            self._touched = True
            puppet.configure(eeprom, self.backups)
        self.streamer.enter("CONFIGURED")

    def _arm(self) -> None:
        for puppet in self.puppets:
            self._heed_early_stop()
            puppet.hold()
            self._armed = True
            puppet.torque_on()
        # Last, because a bus on which nothing is said would trip it.
        for puppet in self.puppets:
            puppet.watchdog()
        soft = self.settings.soft_time if any(puppet.yields for puppet in self.puppets) else 0.0
        share = Ramp(np.array([self.settings.soft_share]), np.ones(1), soft)
        self.streamer.lead("ARMED", self.streamer.still(), soft, effort=share)

    def _heed_early_stop(self) -> None:
        if self.stop.is_set():
            raise RelaxNow

    def _perform(self) -> str:
        settings, streamer = self.settings, self.streamer
        firsts = [puppet.part.trajectory.position[0] for puppet in self.puppets]
        dance = [self._path(puppet) for puppet in self.puppets]
        through = self._go("RAMP", firsts) and streamer.lead(
            "PLAY", dance, self.duration, settings.speed
        )
        if through:
            streamer.lead("SETTLE", streamer.still(), settings.settle_time)
            if settings.end == "rest":
                through = self._go("REST", [puppet.part.robot.rest for puppet in self.puppets])
        if through:
            return "completed"
        streamer.lead("HOLD", streamer.still(), settings.hold_time)
        if streamer.unfit is not None:
            raise streamer.unfit
        return "stopped"

    def _go(self, state: str, poses: Sequence[FloatArray]) -> bool:
        """Lead both robots softly to poses ``[D]`` rad; return whether they got there."""
        settings, duration = self.settings, self.settings.ramp_time
        starts = [puppet.asked.copy() for puppet in self.puppets]
        for puppet, start, pose in zip(self.puppets, starts, poses, strict=True):
            fastest = puppet.part.robot.max_velocity * settings.ramp_speed
            duration = max(duration, ramp_time(start, pose, fastest, settings.ramp_time))
        ways = [Ramp(start, pose, duration) for start, pose in zip(starts, poses, strict=True)]
        return self.streamer.lead(state, ways, duration)

    def _path(self, puppet: Puppet) -> SmoothPath:
        robot = puppet.part.robot
        return SmoothPath(
            puppet.part.trajectory,
            lower=robot.lower,
            upper=robot.upper,
            max_velocity=robot.max_velocity / self.settings.speed,
        )

    def _fault(self, error: BaseException) -> None:
        """Hold both robots where they were told to be, as far as that still works."""
        log.info("%s", error)  # whoever called is told by the exception
        self.streamer.enter("FAULT")
        self.file.event(self.clock.now(), "fault", error=str(error), type=type(error).__name__)
        if not self.streamer.began:
            return
        end = self.clock.now() + self.settings.hold_time
        while (now := self.clock.now()) < end and stop_level(self.stop) < RELAX:
            for puppet in self.puppets:
                puppet.repeat()
            self.clock.sleep_until(now + self.period)

    def _relax(self) -> list[BusError]:
        """Let the robots sink, then torque off everywhere, whatever fails; return what failed."""
        errors: list[BusError] = []
        try:
            self.streamer.enter("RELAX")
            if self._armed and any(puppet.yields for puppet in self.puppets):
                self._soften()
        finally:
            if self._touched:
                if stop_level(self.stop) >= CUT:
                    for puppet in self.puppets:
                        puppet.cut()
                errors = [error for puppet in self.puppets for error in puppet.relax()]
            for error in errors:
                log.error("while relaxing: %s", error)
                self.file.event(self.clock.now(), "relax failed", error=str(error))
        return errors

    def _soften(self) -> None:
        """Take the servos' strength away evenly, unless torque shall go off at once."""
        start, within = self.clock.now(), self.settings.relax_time
        while (now := self.clock.now()) < start + within and stop_level(self.stop) < CUT:
            for puppet in self.puppets:
                puppet.exert(1 - (now - start) / within)
                puppet.repeat()
            self.clock.sleep_until(now + self.period)
