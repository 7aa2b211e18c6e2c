"""Entry point of the ``pasdedeux`` command.

Exit status: 0 done, 1 the gate failed (implausible, over limits, unknown sentence), 2 wrong usage
or input, 3 hardware fault, 130 stopped safely. With ``--json`` standard output carries exactly one
JSON object, also for an error; everything else goes to standard error.
"""

from __future__ import annotations

import argparse
import importlib.util
import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

PACKAGES = ("robots", "generator", "sim", "bridge")

VERBS = {
    "run": "sentence or motion file to two performing puppets, every stage",
    "generate": "sentence to motion.npz",
    "finish": "motion to a clean one: rigid bones, still feet, less jitter, hands that meet",
    "track": "motion to rollout.npz: two humanoids perform it in physics",
    "score": "rollout or motion to report.json: is it plausible?",
    "retarget": "motion to trajectory-a.npz and trajectory-b.npz for servo robots",
    "play": "trajectories to servos, virtual or real",
    "replay": "telemetry to a summary and a picture of goal, present, lag, current, temperature",
    "bus": "serve a virtual Dynamixel bus on a pseudo-terminal",
    "view": "look at a motion, rollout or trajectories in the browser",
    "export": "motion, rollout or trajectories to BVH, CSV, NPZ, MP4, PNG or HTML",
    "robots": "list, show and check the servo robots",
    "curate": "a configuration's invented clips to those that physics repaired or let pass",
    "train": "configuration and clips to a model that turns sentences into motion",
    "pack": "trained model to a folder that runs without torch, and may ship",
    "evaluate": "model to a table of figures against real motions, those first",
    "scan": "find the servos on a bus: ids, bit rates, models, clashes",
    "setup-id": "give the one servo on a bus its id and bit rate, or restore a backup",
    "calibrate": "measure zero and reach of each joint of one unit by hand, or verify them",
    "jog": "move one joint by keys, in small steps",
    "doctor": "check this machine: packages, OpenGL, serial ports; the bit rate of a robot's bus",
}
"""Verb to one line of help; each verb is a module of this package, loaded when it is called."""


def intruder() -> str | None:
    """Return the folder of a package that shadows one of ours, or None.

    The four packages have common names. A ``sim.py`` beside the user's script, or an unrelated
    distribution called ``robots``, would be imported in their place and fail in odd ways.
    """
    home = Path(__file__).resolve().parents[2]
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        origin = Path(spec.origin).resolve() if spec and spec.origin else None
        if origin is None or origin.parent.parent != home:
            return f"'{name}' at {origin or 'an unknown place'}, not in {home}"
    return None


def _module(verb: str) -> ModuleType:
    return import_module(f"bridge.cli.{verb.replace('-', '_')}")


def build_parser(verb: str | None) -> argparse.ArgumentParser:
    """Return the parser; only the chosen verb's own arguments are filled in."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        number = version("pasdedeux")
    except PackageNotFoundError:
        number = "(not installed)"
    parser = argparse.ArgumentParser(
        prog="pasdedeux", description="Type a sentence, and two robots dance it."
    )
    parser.add_argument("--version", action="version", version=f"pasdedeux {number}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for name, line in VERBS.items():
        sub = verbs.add_parser(name, help=line, description=line[0].upper() + line[1:] + ".")
        if name == verb:
            _module(name).add_arguments(sub)
            sub.add_argument(
                "--json", action="store_true", help="one JSON object on standard output"
            )
            sub.add_argument("--verbose", action="store_true", help="log what happens")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    shadow = intruder()
    if shadow:
        print(
            f"pasdedeux: another package shadows {shadow}; rename it, leave its folder, or install"
            " pasdedeux in an environment of its own",
            file=sys.stderr,
        )
        return 2
    verb = next((word for word in arguments if not word.startswith("-")), None)
    args = build_parser(verb).parse_args(arguments)
    logging.basicConfig(
        stream=sys.stderr,
        level=logging.INFO if args.verbose else logging.WARNING,
        format="%(levelname)s %(name)s: %(message)s",
    )
    # Small matrices everywhere: more than one BLAS thread only slows them down.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from sim.gl import choose_backend

    choose_backend()

    from bridge.cli.console import Console
    from robots.errors import DuetError

    console = Console(json=args.json)
    try:
        return _module(args.verb).execute(args, console)
    except DuetError as error:
        console.error(error)
        return error.exit_code
    except KeyboardInterrupt:
        console.say("stopped")
        return 130
    except BrokenPipeError:  # the reader of our output went away, as in `pasdedeux robots | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    sys.exit(main())
