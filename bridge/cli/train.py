"""``pasdedeux train``: a configuration to a model."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from bridge.cli.console import Console

INTERRUPTED = 130
PRECISIONS = ("float16", "float32", "int8")
"""Of a portable model: :data:`generator.runtime.portable.PRECISIONS`, the default first."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the configuration and where the model goes."""
    parser.add_argument("config", type=Path, help="TOML file; see configs/")
    parser.add_argument(
        "-o", "--out", type=Path, help="folder of the run (default: runs/ and the model's name)"
    )
    parser.add_argument(
        "--resume", action="store_true", help="go on from the folder's last checkpoint, if any"
    )
    parser.add_argument(
        "--portable",
        type=Path,
        metavar="DIR",
        help="when all steps are done, also leave the model so that it runs without torch, as"
        " 'pasdedeux pack' does",
    )
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default=PRECISIONS[0],
        help="of the portable model: numbers stored in 16 bits (default) or 32, or multiplied in 8",
    )
    parser.add_argument("--threads", type=int, default=1, help="of the processor (default 1)")
    parser.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto", help="(default auto)"
    )


def execute(args: argparse.Namespace, console: Console) -> int:
    """Train; 0 when all steps are done, 130 when stopped after saving."""
    from generator.training.config import load_config
    from robots.errors import SpecError

    if args.threads < 1:
        raise SpecError(f"{args.threads}", where="--threads", allowed="1 or more")
    run = load_config(args.config)
    out = args.out or Path("runs") / run.name
    require_torch()
    import torch

    from bridge.stop import stop_on_signals
    from generator.training.processes import join, leave
    from generator.training.train import Report, Watch, train

    torch.set_num_threads(args.threads)

    def report(state: Report) -> None:
        left = (state.total - state.step) / max(state.rate, 1e-9)
        console.say(
            f"step {state.step}/{state.total}  loss {state.losses['total']:.4f}"
            f"  simple {state.losses['simple']:.4f}  {state.rate:.2f} steps/s  {clock(left)} left"
        )

    processes = join(args.device)
    try:
        with stop_on_signals() as stop:
            watch = Watch(
                announce=console.say if processes.leads else lambda _: None,
                report=report,
                stop=stop.is_set,
            )
            outcome = train(run, out, resume=args.resume, processes=processes, watch=watch)
    finally:
        leave(processes)
    if not processes.leads:
        return 0 if outcome.finished else INTERRUPTED
    made = str(args.portable) if args.portable and outcome.finished else None
    if made is not None:
        console.say("writing the portable model")
        from generator.training.portable import pack

        pack(out, made, precision=args.precision)
    console.show(
        f"{out}: {outcome.steps} of {outcome.total} steps in {clock(outcome.seconds)}"
        + ("" if outcome.finished else "; go on with --resume")
    )
    console.result(
        {"folder": str(out), "portable": made, "finished": outcome.finished, **asdict(outcome)}
    )
    return 0 if outcome.finished else INTERRUPTED


def require_torch() -> None:
    """Make sure that torch and safetensors are installed.

    Raises:
        CheckpointError: One is not.
    """
    from importlib.util import find_spec

    from robots.errors import CheckpointError

    for name in ("torch", "safetensors"):
        if find_spec(name) is None:
            raise CheckpointError(
                f"this needs the package '{name}'", hint="pip install 'pasdedeux[train]'"
            )


def clock(seconds: float) -> str:
    """Return a time as ``h:mm:ss``."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"
