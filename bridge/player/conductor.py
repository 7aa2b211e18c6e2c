"""The child process of :mod:`bridge.player.process`: takes a request, plays it, tells of it."""

from __future__ import annotations

import ctypes
import gc
import json
import logging
import os
import threading
import time
import traceback
from collections.abc import Iterator
from typing import Any

from bridge.player.request import PlayRequest, perform
from bridge.stop import StopRequest, stop_on_signals
from robots.errors import DuetError

log = logging.getLogger(__name__)

STDIN, STDOUT, STDERR = 0, 1, 2
TOLD_EVERY = 0.1
"""Least time between two words about the progress of a state, s."""
PRIORITY = 20
"""Of the real-time queue: above everything ordinary, below the system's own interrupt threads."""
LOCK_CURRENT, LOCK_FUTURE = 1, 2
"""Linux: what ``mlockall`` shall keep in memory."""


def serve() -> None:
    """Play the request on standard input; tell of it on standard output."""
    voice = _Voice(os.dup(STDOUT))
    os.dup2(STDERR, STDOUT)  # whatever a library prints must not get between
    words = _lines(STDIN)
    first = next(words, None)
    if first is None:
        return
    asked = json.loads(first)
    logging.basicConfig(level=asked["log_level"], handlers=[_Passed(voice)])
    with stop_on_signals() as stop:
        threading.Thread(target=_obey, args=(words, stop), name="orders", daemon=True).start()
        try:
            request = PlayRequest.from_json(asked["request"])
            _undisturbed(realtime=request.realtime)
            performance = perform(request, stop=stop, on_progress=voice.progress)
        except DuetError as error:
            voice.result("error", _facts(error))
        except BaseException as error:
            facts = _facts(DuetError(f"the player failed: {error!r}"))
            voice.result("error", {**facts, "type": "", "notes": [traceback.format_exc()]})
        else:
            voice.result("performance", performance.to_json())


def _lines(fd: int) -> Iterator[str]:
    """Yield lines as they come, until the other end is closed.

    Not with ``sys.stdin``: a thread that waits in it keeps the interpreter from ending.
    """
    received = bytearray()
    while data := os.read(fd, 65536):
        received += data
        *lines, rest = received.split(b"\n")
        received = bytearray(rest)
        for line in lines:
            yield line.decode()


def _obey(words: Iterator[str], stop: StopRequest) -> None:
    for word in words:
        if word == "pause":
            stop.pause()
        else:
            stop.set()
    log.warning("whoever asked for the performance has gone: it is stopped")
    stop.set()


def _undisturbed(*, realtime: bool) -> None:
    """Let nothing in this process delay a tick; ask the system for the same, if wanted."""
    # A sweep takes milliseconds. What a performance leaves behind is not cyclic.
    gc.collect()
    gc.freeze()
    gc.disable()
    if not realtime:
        return
    try:
        # Not for children: a virtual bus that outranks the player's machine starves it.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
        if ctypes.CDLL(None, use_errno=True).mlockall(LOCK_CURRENT | LOCK_FUTURE):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    except (AttributeError, OSError) as error:
        reason = getattr(error, "strerror", None) or "this system has none"
        log.warning(
            "no real-time priority: %s; on Linux, allow it with 'rtprio' and 'memlock' in"
            " /etc/security/limits.d",
            reason,
        )


class _Voice:
    """Says lines of JSON to the caller; only the last is waited for."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._state, self._next = "", 0.0
        self._unsaid = b""
        self._lock = threading.Lock()
        os.set_blocking(fd, False)

    def progress(self, state: str, share: float) -> None:
        """Tell about the progress of a state, now and then."""
        now = time.monotonic()
        if state != self._state or now >= self._next or share >= 1:
            self._state, self._next = state, now + TOLD_EVERY
            self.say("progress", [state, round(share, 4)])

    def say(self, kind: str, facts: Any) -> None:
        """Say it if somebody listens; else leave it out."""
        with self._lock:
            self._go_on()
            if not self._unsaid:
                self._unsaid = _line(kind, facts)
                self._go_on()

    def result(self, kind: str, facts: Any) -> None:
        """Say the last word, however long it takes."""
        with self._lock:
            os.set_blocking(self._fd, True)
            self._unsaid += _line(kind, facts)
            self._go_on()

    def _go_on(self) -> None:
        """Write what is left of a line as far as it goes; nobody is there: forget it."""
        try:
            while self._unsaid:
                self._unsaid = self._unsaid[os.write(self._fd, self._unsaid) :]
        except BlockingIOError:
            pass
        except BrokenPipeError:
            self._unsaid = b""


class _Passed(logging.Handler):
    """Passes log records on to the caller."""

    def __init__(self, voice: _Voice) -> None:
        super().__init__()
        self._voice = voice

    def emit(self, record: logging.LogRecord) -> None:
        """Pass on one record."""
        self._voice.say("log", [record.name, record.levelno, record.getMessage()])


def _line(kind: str, facts: Any) -> bytes:
    return json.dumps([kind, facts], separators=(",", ":")).encode() + b"\n"


def _facts(error: DuetError) -> dict[str, Any]:
    parts = {"where": error.where, "allowed": error.allowed, "hint": error.hint}
    notes = list(getattr(error, "__notes__", ()))
    return {"type": type(error).__name__, "what": error.what, "parts": parts, "notes": notes}
