"""Leads two robots along their ways on one phase, tick by tick.

**The problem.** Both robots must be told the same moment of the dance at the same time, for ever
without drift, on a machine that is sometimes late and on wires that sometimes fail. So tick k has
the absolute time t0 + k dt, both goals are computed from it (:class:`~bridge.player.phase.Phase`),
both commands leave before any answer is awaited, and ticks whose time has passed are left out:
goals are never queued. What goes wrong with one robot happens to both: if a servo stays silent or a
port is lost, the phase stands still for both until all answer again, and both are led back to it
gently; if that takes too long, the trouble is raised.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from bridge.player.health import DERATE, Finding, Level
from bridge.player.phase import Phase
from bridge.player.puppet import Puppet
from bridge.player.ramp import Ramp, ramp_time
from bridge.player.recorder import Recorder
from bridge.player.settings import PlayerSettings
from bridge.player.telemetry import Telemetry
from bridge.servo.clock import Clock
from bridge.servo.state import ServoState
from bridge.stop import GENTLE, RELAX, is_paused, stop_level
from robots.errors import BusError, BusTimeout, ServoFault
from robots.skeleton import FloatArray

log = logging.getLogger(__name__)

OnProgress = Callable[[str, float], None]
"""Called with the player's state and the share of it that is done."""

FOLLOWING = ("RAMP", "PLAY", "RESUME", "REST")
"""States in which a first stop slows down along the path."""
CLEAR_TICKS = 5
"""Ticks with all answers after which a robot counts as recovered."""


class Way(Protocol):
    """What a robot follows: a ramp or a trajectory."""

    def at(self, time: float, /) -> FloatArray:
        """Return positions ``[D]`` rad at a phase in s."""
        ...


class RelaxNow(Exception):
    """Nothing moves yet, or an urgent stop has come: straight to relaxation."""


class Streamer:
    """The loop that tells both robots where to be, and hears where they are."""

    def __init__(
        self,
        puppets: Sequence[Puppet],
        settings: PlayerSettings,
        *,
        period: float,
        clock: Clock,
        file: Telemetry,
        recorder: Recorder,
        on_progress: OnProgress | None,
        stop: threading.Event,
    ) -> None:
        """Take the robots, ready to be streamed to every ``period`` s."""
        self.puppets = tuple(puppets)
        self.settings = settings
        self.period = period
        self.clock = clock
        self.file = file
        self.recorder = recorder
        self.stop = stop
        self.on_progress = on_progress or (lambda state, share: None)
        self.began = False
        """Whether a tick has ever been sent."""
        self.unfit: ServoFault | None = None
        """Why a servo must not go on, if so: both robots have been stopped for it."""
        self._pace = 1.0
        self._last_tick = math.nan
        self._next_look = 0.0
        self._looks = 0
        self._recoveries = 0
        self._held_back: list[set[str]] = [set() for _ in puppets]

    def enter(self, state: str) -> None:
        """Tell everybody that a state begins."""
        log.info("%s", state)
        self.file.event(self.clock.now(), "state", state=state)
        self.on_progress(state, 0.0)

    def still(self) -> list[Ramp]:
        """Return ways that stay where the robots were last asked to be."""
        return [Ramp(puppet.asked, puppet.asked, 0.0) for puppet in self.puppets]

    def lead(
        self,
        state: str,
        ways: Sequence[Way],
        duration: float,
        rate: float = 1.0,
        *,
        effort: Ramp | None = None,
    ) -> bool:
        """Lead both robots along their ways; return whether the end was reached.

        Args:
            state: What to call it.
            ways: One per robot.
            duration: Phase at which they end, s.
            rate: Speed of the phase.
            effort: Strength of the servos by phase, if that changes.

        Raises:
            RelaxNow: An urgent stop has come.
            BusError: A robot cannot be led on.
        """
        self.enter(state)
        start, tick = self.clock.now(), 0
        phase = Phase(start, rate)
        self._last_tick = math.nan
        while True:
            scheduled = start + tick * self.period
            self.clock.sleep_until(scheduled)
            now = self.clock.now()
            self._require_punctual(now)
            self._heed(state, phase, scheduled, rate)
            at = min(phase.at(scheduled), duration)
            if effort is not None:
                for puppet in self.puppets:
                    puppet.exert(float(effort.at(at)[0]))
            trouble = self._tick(state, scheduled, now, at, [way.at(at) for way in ways])
            self.on_progress(state, at / duration if duration else 1.0)
            if trouble is not None:
                if not self._recover(trouble, at):
                    return False
                self.enter(state)
                # Time stood still for both: the phase starts anew from where it was.
                start, tick = self.clock.now(), 0
                phase = Phase(start - at / rate, rate)
                phase.change(start, 0.0, 0.0)
                phase.change(start, 0.0 if is_paused(self.stop) else rate * self._pace, 0.5)
                continue
            if phase.stopped(scheduled):
                return False
            if at >= duration:
                return True
            following = self._following(start, tick)
            if state == "PLAY":
                self.recorder.drop(following - tick - 1)
            tick = following

    def _following(self, start: float, tick: int) -> int:
        """Return the next tick whose time has not passed."""
        passed = math.ceil((self.clock.now() - start) / self.period - 1e-9)
        return max(tick + 1, passed)

    def _heed(self, state: str, phase: Phase, now: float, rate: float) -> None:
        """Let the phase do what is asked from outside and by the servos' health."""
        level = stop_level(self.stop)
        if level >= RELAX:
            raise RelaxNow
        if state not in FOLLOWING or phase.stopping:
            return
        if level >= GENTLE or self.unfit is not None:
            self.file.event(now, "stop")
            phase.stop(now, self.settings.stop_time)
            return
        wanted = 0.0 if is_paused(self.stop) else rate * self._pace
        if wanted != phase.rate:
            self.file.event(now, "rate", rate=wanted, phase=phase.at(now))
            phase.change(now, wanted, self.settings.stop_time)

    def _require_punctual(self, now: float) -> None:
        stall = now - self._last_tick - self.period
        if stall > self.settings.max_stall:
            raise BusTimeout(
                f"this computer paused for {stall:.2f} s in the middle of a performance",
                allowed=f"{self.settings.max_stall:.2f} s",
                hint="close other programs, or play at a lower rate",
            )
        self._last_tick = now

    # -- one tick ---------------------------------------------------------------------------------

    def _tick(
        self, state: str, scheduled: float, now: float, at: float, goals: Sequence[FloatArray]
    ) -> BusError | None:
        """Tell both, hear both; return why one of them cannot be led on, if so."""
        self.began = True
        sent: list[float] = []
        for puppet, goal in zip(self.puppets, goals, strict=True):
            puppet.send(goal, scheduled)
            sent.append(self.clock.now())
        for puppet in self.puppets:
            puppet.begin_read()
        states = [puppet.end_read(self.clock) for puppet in self.puppets]
        for puppet, servos, when in zip(self.puppets, states, sent, strict=True):
            self.file.tick(
                scheduled,
                robot=puppet.person,
                state=state,
                phase=at,
                goal=puppet.goal,
                servos=servos,
                late=now - scheduled,
                sent=when - scheduled,
            )
        if state == "PLAY":
            told = [puppet.goal for puppet in self.puppets]
            self.recorder.tick(scheduled, now - scheduled, max(sent) - min(sent), told, states)
        self._tell_held_back(now)
        self._judge(now, states)
        troubles = [trouble for puppet in self.puppets if (trouble := puppet.trouble())]
        if not troubles and now >= self._next_look:
            self._look(now)
        return troubles[0] if troubles else None

    def _judge(self, now: float, states: Sequence[ServoState]) -> None:
        for puppet, servos in zip(self.puppets, states, strict=True):
            self._consider(now, puppet, puppet.judge(servos))

    def _look(self, now: float) -> None:
        self._next_look = now + self.settings.health_period
        puppet = self.puppets[self._looks % len(self.puppets)]
        self._looks += 1
        register, values, findings = puppet.look_after()
        self.file.event(now, "health", robot=puppet.person, **{register: values})
        self._consider(now, puppet, findings)

    def _consider(self, now: float, puppet: Puppet, findings: Sequence[Finding]) -> None:
        """Say what was found, and let both robots slow down or stop for it."""
        for finding in findings:
            log.warning("%s: %s %s", puppet.person, finding.joint, finding.what)
            level = finding.level.name.lower()
            self.file.event(
                now,
                "unwell",
                robot=puppet.person,
                joint=finding.joint,
                level=level,
                what=finding.what,
            )
            if finding.level >= Level.DERATE:
                self._pace = DERATE
            if finding.level >= Level.STOP and self.unfit is None and not self.settings.dry_run:
                servo = puppet.part.robot.joint(finding.joint).servo
                self.unfit = ServoFault(
                    finding.what,
                    where=f"{puppet.person}: {finding.joint} (id {servo.id})",
                    hint="let it rest, check load and supply, or play slower",
                )

    def _tell_held_back(self, now: float) -> None:
        """Note which joints are not told what was asked, when that changes."""
        for index, puppet in enumerate(self.puppets):
            names = {puppet.names[int(i)] for i in np.flatnonzero(puppet.governor.held_back)}
            if names != self._held_back[index]:
                self._held_back[index] = names
                self.file.event(now, "held back", robot=puppet.person, joints=sorted(names))

    # -- waiting for what is away -----------------------------------------------------------------

    def _recover(self, trouble: BusError, at: float) -> bool:
        """Hold both at one phase until all answer, then lead them back; False if stopped there.

        Raises:
            BusError: The trouble, if it lasts or comes too often; another that came of it.
        """
        settings = self.settings
        self._recoveries += 1
        waits = settings.recover_time and self._recoveries <= settings.recoveries
        if not waits or self.stop.is_set() or self.unfit is not None:
            raise trouble
        log.warning("both robots wait: %s", trouble)
        self.enter("FREEZE")
        self.file.event(self.clock.now(), "freeze", error=str(trouble), phase=at)
        held = [puppet.asked.copy() for puppet in self.puppets]
        start, tick, clear = self.clock.now(), 1, 0
        while clear < CLEAR_TICKS:
            scheduled = start + tick * self.period
            self.clock.sleep_until(scheduled)
            now = self.clock.now()
            if now - start > settings.recover_time:
                raise trouble
            if self.stop.is_set():
                raise RelaxNow
            for puppet in self.puppets:
                puppet.reopen(now)
            missing = self._tick("FREEZE", scheduled, now, at, held)
            clear = clear + 1 if missing is None else 0
            tick = self._following(start, tick)
        for puppet in self.puppets:
            puppet.revive()
        starts = [puppet.goal.copy() for puppet in self.puppets]
        duration = settings.stop_time
        for puppet, begin, end in zip(self.puppets, starts, held, strict=True):
            fastest = puppet.part.robot.max_velocity * settings.ramp_speed
            duration = max(duration, ramp_time(begin, end, fastest, duration))
        ways = [Ramp(begin, end, duration) for begin, end in zip(starts, held, strict=True)]
        return self.lead("RESUME", ways, duration)
