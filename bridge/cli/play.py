"""``pasdedeux play``: trajectories to servos, virtual or real."""

from __future__ import annotations

import argparse
from pathlib import Path

from bridge import stages
from bridge.cli.console import Console
from bridge.cli.options import add_plant, in_folder
from robots.errors import SpecError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is played, where, and what must be allowed first."""
    parser.add_argument("trajectory_a", type=Path, metavar="A", help="trajectory of person a")
    parser.add_argument("trajectory_b", type=Path, metavar="B", help="trajectory of person b")
    parser.add_argument(
        "--report", type=Path, help="report.json of the same motion; without it --force is needed"
    )
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(stages.TELEMETRY), help="telemetry: file or folder"
    )
    parser.add_argument(
        "--port",
        nargs="+",
        default=["virtual"],
        metavar="PORT",
        help="'virtual' (default), or the serial ports of a and b",
    )
    add_plant(parser)
    parser.add_argument(
        "--transport",
        choices=stages.TRANSPORTS,
        default=stages.TRANSPORTS[0],
        help="who speaks to the servos: the maker's client (sdk, the default), or rustypot, which"
        " takes less of the processor and is installed on its own",
    )
    parser.add_argument("--arm", action="store_true", help="allow real servos to move")
    parser.add_argument(
        "--force", action="store_true", help="play what the report refuses; virtual ports alone"
    )
    parser.add_argument(
        "--speed", type=float, default=1.0, help="of the dance; 0.3 for a first run on metal"
    )
    parser.add_argument(
        "--end",
        choices=("rest", "hold"),
        default="rest",
        help="where the robots end before they go limp: in their rest pose (default), or in the"
        " last one",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="everything but torque, goals and settings"
    )
    parser.add_argument("--only", nargs="+", metavar="JOINT", help="joints that play")
    parser.add_argument(
        "--without", nargs="+", default=[], metavar="JOINT", help="joints that do not play"
    )
    parser.add_argument(
        "--write-eeprom",
        action="store_true",
        help="make real servos' EEPROM what the robot's file says, after a backup",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="ask the system for real-time priority, for real servos on a machine with other work",
    )
    parser.add_argument("--rate", type=float, help="ticks per second (default 60)")
    parser.add_argument("--robot-a", metavar="NAME", help="folder of a's robot, if not built in")
    parser.add_argument("--robot-b", metavar="NAME", help="folder of b's robot, if not built in")
    parser.add_argument(
        "--calibration-a", type=Path, metavar="FILE", help="of the unit that plays a"
    )
    parser.add_argument(
        "--calibration-b", type=Path, metavar="FILE", help="of the unit that plays b"
    )


def execute(args: argparse.Namespace, console: Console) -> int:
    """Play; Ctrl-C slows down, a second one relaxes, a third cuts the torque."""
    from bridge.player.settings import PlayerSettings
    from bridge.stop import stop_on_signals

    ports = tuple(args.port * 2 if args.port == ["virtual"] else args.port)
    if len(ports) != 2:
        raise SpecError(f"{len(ports)} port given for two robots", allowed="--port A B")
    with stop_on_signals() as stop, console.stage("play") as progress:
        performance = stages.play(
            (args.trajectory_a, args.trajectory_b),
            in_folder(args.out, stages.TELEMETRY),
            report=args.report,
            robots=(args.robot_a, args.robot_b),
            ports=(ports[0], ports[1]),
            plant=args.plant,
            transport=args.transport,
            settings=PlayerSettings(
                speed=args.speed, rate=args.rate, end=args.end, dry_run=args.dry_run
            ),
            arm=args.arm,
            force=args.force,
            only=args.only,
            without=args.without,
            write_eeprom=args.write_eeprom,
            calibrations=(args.calibration_a, args.calibration_b),
            realtime=args.realtime,
            stop=stop,
            progress=progress,
        )
    for person, track in performance.tracking.items():
        console.show(
            f"{person} ({track.robot}): {track.rms_deg:.2f}° off (at most {track.max_deg:.1f}°,"
            f" {track.worst_joint}), {track.lag_ms:.0f} ms behind"
        )
    console.show(
        f"{performance.outcome}: {performance.ticks} ticks at {performance.rate:g} Hz,"
        f" {performance.late_ticks} late, {performance.dropped_ticks} left out,"
        f" {performance.skew_p99_ms:.2f} ms between the robots"
    )
    console.result(performance.to_json())
    return 0 if performance.completed else 130
