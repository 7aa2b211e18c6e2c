"""A performance as files and names: what can be said to another process.

A robot, a checked trajectory and a verdict are objects; the files they come from are named in a few
lines of JSON. Whoever gets those lines loads and checks everything itself, so what was checked is
what is played.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bridge.gate import verdict
from bridge.player.play import BACKUPS, play
from bridge.player.settings import PlayerSettings
from bridge.player.streamer import OnProgress
from bridge.player.telemetry import Performance
from bridge.ports import TRANSPORTS, VIRTUAL, connect
from bridge.setup.calibration import Calibration
from bridge.trajectory import JointTrajectory
from bridge.virtual.plant import SERVO
from robots.errors import SpecError
from robots.files import plain
from robots.registry import load_robot


@dataclass(frozen=True, slots=True, kw_only=True)
class PlayRequest:
    """What to play, on what, and what is allowed; pairs are of persons a and b.

    Raises:
        SpecError: A plant is asked for behind real ports.
    """

    trajectories: tuple[Path, Path]
    """Files."""
    telemetry: Path
    """File to write."""
    report: Path | None = None
    """The report on the same motion; without one only :attr:`force` lets it pass."""
    robots: tuple[str | None, str | None] = (None, None)
    """Folder or name; ``None``: the built-in robot that the trajectory names."""
    ports: tuple[str, str] = (VIRTUAL, VIRTUAL)
    """``virtual``, or a serial port."""
    plant: str = SERVO
    """What moves behind virtual ports, one of :data:`~bridge.virtual.plant.PLANTS`."""
    transport: str = TRANSPORTS[0]
    """Client that speaks to the servos, one of :data:`~bridge.ports.TRANSPORTS`."""
    settings: PlayerSettings = field(default_factory=PlayerSettings)
    """How to play."""
    arm: bool = False
    """Real servos may move."""
    force: bool = False
    """Play what the report refuses, on virtual ports."""
    only: tuple[str, ...] | None = None
    """Joints that play; ``None`` for all."""
    without: tuple[str, ...] = ()
    """Joints that do not."""
    write_eeprom: bool = False
    """Make real servos' EEPROM what the robot's file says, after a backup."""
    backups: Path = BACKUPS
    """Folder for what it held before."""
    calibrations: tuple[Path | None, Path | None] = (None, None)
    """Files of the units that play; ``None``: built just as designed."""
    realtime: bool = False
    """Ask the system for real-time priority, where a process of its own plays."""

    def __post_init__(self) -> None:
        """Validate."""
        if self.plant != SERVO and set(self.ports) != {VIRTUAL}:
            raise SpecError(
                f"plant '{self.plant}'",
                where=", ".join(self.ports),
                allowed="virtual ports alone",
            )

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON."""
        return plain(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> PlayRequest:
        """Return what :meth:`to_json` told of."""
        paths = {
            "trajectories": tuple(Path(name) for name in values["trajectories"]),
            "telemetry": Path(values["telemetry"]),
            "report": None if values["report"] is None else Path(values["report"]),
            "backups": Path(values["backups"]),
            "calibrations": tuple(
                None if name is None else Path(name) for name in values["calibrations"]
            ),
        }
        lists = {
            "robots": tuple(values["robots"]),
            "ports": tuple(values["ports"]),
            "only": None if values["only"] is None else tuple(values["only"]),
            "without": tuple(values["without"]),
            "settings": PlayerSettings(**values["settings"]),
        }
        return cls(**{**values, **paths, **lists})


def perform(
    request: PlayRequest,
    *,
    stop: threading.Event | None = None,
    on_progress: OnProgress | None = None,
) -> Performance:
    """Load what a request names and play it in this process; see :func:`bridge.player.play`.

    Args:
        request: What to play.
        stop: Ends the performance when set.
        on_progress: Told about the state and how much of it is done.

    Raises:
        DuetError: As :func:`bridge.player.play` and the readers of the files.
    """
    trajectories = [JointTrajectory.load(path) for path in request.trajectories]
    units = []
    for name, trajectory, unit in zip(
        request.robots, trajectories, request.calibrations, strict=True
    ):
        design = load_robot(name or trajectory.robot)
        units.append(design if unit is None else Calibration.load(unit).apply(design))
    return play(
        trajectories,
        units,
        gate=verdict(request.report, request.trajectories, trajectories),
        ports=request.ports,
        settings=request.settings,
        arm=request.arm,
        force=request.force,
        only=request.only,
        without=request.without,
        write_eeprom=request.write_eeprom,
        backups=request.backups,
        telemetry=request.telemetry,
        on_progress=on_progress,
        stop=stop,
        connector=partial(connect, plant=request.plant, transport=request.transport),
    )
