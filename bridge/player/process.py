"""Plays in a process of its own, which nothing in the caller's can hold up.

**The problem.** Threads of one interpreter take turns, so a busy caller (one that draws, plans or
serves a browser) delays a player that is due: two robots at 100 Hz become 60 Hz, tens of
milliseconds apart. And a caller that dies must not leave two robots dancing. So a child process
plays, streaming to both buses from one loop; the caller only says what, and listens::

    caller                                   child
    request, one line of JSON       ─────►   loads and checks the files itself
    "stop" or "pause", a word each  ─────►   sets the stop request
    closed (also by a death)        ─────►   a stop: along the path, hold, relax
                                    ◄─────   progress and log records, left out if nobody listens
                                    ◄─────   what came of it: a performance or an error

Nothing the caller does or fails to do makes the child wait: what it says along the way it says
without blocking. Ctrl-C reaches the caller alone, for the child has a session of its own, and is
passed on.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any, cast

from bridge.player.conductor import serve
from bridge.player.request import PlayRequest
from bridge.player.streamer import OnProgress
from bridge.player.telemetry import Performance
from bridge.stop import CUT, RELAX, StopRequest, is_paused, stop_level
from robots import errors
from robots.errors import BusError, DuetError

log = logging.getLogger(__name__)

COMMAND = f"from {serve.__module__} import {serve.__name__}; {serve.__name__}()"
"""What the child runs."""
POLL = 0.02
"""Time between two looks at the stop request, s."""
GRACE = 15.0
"""Longest time from the last word to the end of a child that shall relax its robots, s."""
CHUNK = 65536


def conduct(
    request: PlayRequest,
    *,
    stop: threading.Event | None = None,
    on_progress: OnProgress | None = None,
) -> Performance:
    """Play in a process of its own and return how it went; a stop is no error.

    Args:
        request: What to play.
        stop: Ends the performance when set; a :class:`StopRequest` can ask more urgently and pause.
        on_progress: Told about the state and how much of it is done, some ten times a second.

    Raises:
        DuetError: As :func:`bridge.player.play`, from the child.
        BusError: The child ended without a word. What its servos do then, their bus watchdog says.
    """
    with _child() as child:
        return _Listener(child, request, stop or StopRequest(), on_progress).attend()


@contextlib.contextmanager
def _child() -> Iterator[subprocess.Popen[bytes]]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    child = subprocess.Popen(  # noqa: S603 - our own interpreter and code
        [sys.executable, "-c", COMMAND],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
        env=environment,
        start_new_session=True,
    )
    try:
        yield child
    finally:
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        child.wait()


class _Listener:
    """The caller's end: passes stops on, and takes what the child says until it ends."""

    def __init__(
        self,
        child: subprocess.Popen[bytes],
        request: PlayRequest,
        stop: threading.Event,
        on_progress: OnProgress | None,
    ) -> None:
        self._child = child
        self._stop = stop
        self._on_progress = on_progress
        self._told = 0
        self._paused = False
        self._least = 0
        self._last_word = time.monotonic()
        self._received = bytearray()
        self._result: tuple[str, Any] | None = None
        level = logging.getLogger().getEffectiveLevel()
        self._say(json.dumps({"request": request.to_json(), "log_level": level}))

    def attend(self) -> Performance:
        """Listen until the child has ended; return or raise what came of it.

        Whatever is raised in this process meanwhile waits until the robots are relaxed.
        """
        trouble: BaseException | None = None
        while True:
            try:
                self._listen()
                break
            except BaseException as error:  # also Ctrl-C where nobody turns it into a stop
                trouble = trouble or error
                self._on_progress = None
                self._least = min(max(self._least + 1, RELAX), CUT)
        if trouble is not None:
            raise trouble
        code = self._child.wait()
        kind, facts = self._result or ("", {})
        if kind == "performance":
            return Performance.from_json(facts)
        if kind == "error":
            raise _as_ours(facts)
        raise BusError(
            f"the process that played ended without a word (exit status {code})",
            hint="cut the servos' power if they hold; their bus watchdog has stopped them",
        )

    def _listen(self) -> None:
        pipe = self._child.stdout
        if pipe is None:
            return
        while True:
            self._pass_on()
            ready, _, _ = select.select((pipe,), (), (), POLL)
            if ready:
                data = os.read(pipe.fileno(), CHUNK)
                if not data:
                    return
                self._received += data
                *lines, rest = self._received.split(b"\n")
                self._received = bytearray(rest)
                for line in lines:
                    self._take(*json.loads(line))
            elif self._told >= CUT and time.monotonic() > self._last_word + GRACE:
                log.error("the process that plays does not end: it is killed")
                self._child.kill()
                return

    def _pass_on(self) -> None:
        wanted = max(stop_level(self._stop), self._least)
        while self._told < wanted:
            self._told += 1
            self._say("stop")
        if is_paused(self._stop) != self._paused:
            self._paused = not self._paused
            self._say("pause")

    def _say(self, line: str) -> None:
        self._last_word = time.monotonic()
        if self._child.stdin is not None:
            # A child that has gone says so by the end of its output.
            with contextlib.suppress(BrokenPipeError):
                self._child.stdin.write(line.encode() + b"\n")

    def _take(self, kind: str, facts: Any) -> None:
        if kind == "progress":
            if self._on_progress is not None:
                self._on_progress(*facts)
        elif kind == "log":
            name, level, text = facts
            logging.getLogger(name).log(level, "%s", text)
        else:
            self._result = kind, facts


def _as_ours(facts: dict[str, Any]) -> DuetError:
    """Return the error that a child has told of."""
    kind = getattr(errors, facts["type"], None)
    if not (isinstance(kind, type) and issubclass(kind, DuetError)):
        kind = BusError  # a bug: nobody knows what the servos do
    error = cast(type[DuetError], kind)(facts["what"], **facts["parts"])
    for note in facts["notes"]:
        error.add_note(note)
    return error
