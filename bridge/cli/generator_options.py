"""Options of the generators, for ``generate`` and ``run``, and which of them takes which."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bridge.generating import GENERATORS, default_generator
from robots.errors import SpecError

if TYPE_CHECKING:
    from generator.intergen import IntergenRequest
    from generator.runtime.request import DiffusionRequest

_STYLE = {"tempo": "speed", "energy": "energy", "amplitude": "amplitude"}
"""Options of the manner, and fields of the choreographer's style."""
_DIFFUSION = ("weights", "frames", "seconds", "threads", "people", "nearest")
_INTERGEN = (
    "weights", "frames", "seconds", "threads", "solver", "precision", "given", "given_person",
    "path_a", "path_b", "start", "end", "strength",
)  # fmt: skip
_OWN = ("steps", "guidance")
"""Settings of which a model has its own."""
_SEVERAL = ("then", "like", "unlike")
"""Options that can be repeated, for ``diffusion``."""
_TAKEN = {
    "choreographer": {"nearest", *_STYLE},
    "diffusion": {*_DIFFUSION, *_OWN, *_SEVERAL, *_STYLE, "raw"},
    "intergen": {*_INTERGEN, *_OWN, "round", "raw"},
}


def add_generator(parser: argparse.ArgumentParser, *, speed: Sequence[str] = ()) -> None:
    """Add who turns sentences into motion, and everything that they take.

    Args:
        parser: Of ``generate`` or ``run``.
        speed: Further names of ``--tempo``.
    """
    parser.add_argument(
        "--generator",
        choices=GENERATORS,
        default=default_generator(),
        help="who turns the sentence into motion: composed movements (choreographer), a diffusion"
        " model without torch (diffusion), or with it (intergen); default %(default)s",
    )
    parser.add_argument(
        "--nearest",
        action="store_true",
        help="choreographer, diffusion: for a sentence outside the repertoire, the nearest"
        " interaction",
    )
    _add_manner(parser.add_argument_group("manner, for choreographer and diffusion"), speed)
    _add_model(parser.add_argument_group("models, for diffusion and intergen"))
    _add_diffusion(parser.add_argument_group("for diffusion"))
    _add_intergen(parser.add_argument_group("for intergen"))


def _add_manner(group: argparse._ArgumentGroup, speed: Sequence[str]) -> None:
    group.add_argument(
        "--tempo", *speed, dest="tempo", type=float, metavar="X", help="how fast, 0.6 to 1.4"
    )
    group.add_argument("--energy", type=float, metavar="X", help="how vigorous, 0.5 to 1.5")
    group.add_argument("--amplitude", type=float, metavar="X", help="how large, 0.5 to 1.5")


def _add_model(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--weights", metavar="DIR", help="a model; for intergen also a .ckpt file")
    length = group.add_mutually_exclusive_group()
    length.add_argument("--frames", type=int, help="length in frames of the model")
    length.add_argument("--seconds", type=float, help="length in seconds")
    group.add_argument(
        "--steps", type=int, help="sampling steps (default: the model's own; 50 for intergen)"
    )
    group.add_argument(
        "--guidance", type=float, help="weight of the text (the model's own; 3.5 for intergen)"
    )
    group.add_argument(
        "--threads", type=int, help="of the processor (default: one; for intergen all but one)"
    )
    group.add_argument(
        "--raw", action="store_true", help="leave the motion as it was drawn (docs/finishing.md)"
    )


def _add_diffusion(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--then",
        action="append",
        default=[],
        metavar="TEXT",
        help="what they do next, as long as the first part; can be repeated",
    )
    for name, what in (("like", "a variation of"), ("unlike", "something else than")):
        group.add_argument(
            f"--{name}",
            action="append",
            default=[],
            metavar="FILE|SEED",
            help=f"{what} a motion, by file or by the seed that it had; can be repeated",
        )


def add_people(parser: argparse.ArgumentParser) -> None:
    """Add how many take part, for ``generate`` alone: a group is several motion files."""
    parser.add_argument(
        "--people",
        type=int,
        metavar="N",
        help="diffusion: a group of pairs a-b, b-c ...; one file a pair, all in one world",
    )


def _add_intergen(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--solver", choices=("auto", "ddim", "dpm2m"))
    group.add_argument("--precision", choices=("float32", "fast", "bfloat16"))
    group.add_argument("--given", metavar="FILE", help="keep one person of this motion")
    group.add_argument("--given-person", choices=("a", "b"), help="which (default a)")
    for person in ("a", "b"):
        group.add_argument(
            f"--path-{person}",
            metavar="CSV",
            help=f"where {person} goes: lines of time s, x m, y m; or a motion file",
        )
    for edge, verb in (("start", "begins"), ("end", "ends")):
        group.add_argument(
            f"--{edge}",
            metavar="FILE[@S:S]",
            help=f"the motion {verb} with this one, or with a part of it (seconds)",
        )
    group.add_argument(
        "--round",
        action="append",
        default=[],
        metavar="TEXT",
        help="one more round between start and end, from the motion so far; can be repeated",
    )
    group.add_argument("--strength", type=float, help="how much a round changes, 0 to 1 (0.7)")


def style_request(args: argparse.Namespace) -> dict[str, float]:
    """Return the numbers of the choreographer's style that were given."""
    given = {field: getattr(args, name) for name, field in _STYLE.items()}
    return {field: value for field, value in given.items() if value is not None}


def intergen_request(args: argparse.Namespace) -> IntergenRequest | None:
    """Return what :func:`add_generator` parsed for ``intergen``; ``None`` for another generator.

    Raises:
        SpecError: The generator does not take an option, or settings make no sense.
    """
    _require_taken(args)
    if args.generator != "intergen":
        return None
    from generator.intergen import IntergenRequest

    return IntergenRequest(**_given(args, *_INTERGEN, *_OWN), rounds=tuple(args.round))


def diffusion_request(args: argparse.Namespace) -> DiffusionRequest | None:
    """Return what :func:`add_generator` parsed for ``diffusion``; ``None`` for another generator.

    Raises:
        SpecError: The generator does not take an option, or settings make no sense.
    """
    _require_taken(args)
    if args.generator != "diffusion":
        return None
    from generator.runtime.request import DiffusionRequest

    values = _given(args, *_DIFFUSION, *_OWN, *_STYLE)
    values |= {name: tuple(getattr(args, name)) for name in _SEVERAL}
    return DiffusionRequest(**values)


def _given(args: argparse.Namespace, *names: str) -> dict[str, Any]:
    return {name: value for name in names if (value := getattr(args, name, None)) is not None}


def _require_taken(args: argparse.Namespace) -> None:
    """Check that the chosen generator takes every option that was given, and say who does.

    Raises:
        SpecError: It does not.
    """
    for name in sorted(set().union(*_TAKEN.values()) - _TAKEN[args.generator]):
        if getattr(args, name, None) not in (None, False, []):
            able = [f"--generator {who}" for who in GENERATORS if name in _TAKEN[who]]
            raise SpecError(
                f"--generator {args.generator} does not take it",
                where=f"--{name.replace('_', '-')}",
                allowed=" or ".join(able),
            )
