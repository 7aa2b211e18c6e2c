"""From a sentence to a duet, whichever generator makes it, and a duet made clean."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from generator.model_folder import shipped_folder
from generator.motion import DuetMotion
from robots.errors import SpecError, nearest

if TYPE_CHECKING:  # networks are loaded by the generators that need them
    from generator.finishing import Finishing, Meeting
    from generator.intergen import IntergenRequest
    from generator.runtime.request import DiffusionRequest

Progress = Callable[[float], None]

GENERATORS = ("choreographer", "diffusion", "intergen")
"""Who turns sentences into motion."""
FPS = 30.0
"""Frames per second of a finished motion."""


def default_generator() -> str:
    """Return who turns sentences into motion if nobody is named: the model, if one ships."""
    return "choreographer" if shipped_folder() is None else "diffusion"


def no_progress(_: float) -> None:
    """Take a share of work done and do nothing with it."""


def make(
    text: str,
    *,
    seed: int = 0,
    nearest_known: bool = False,
    style: Mapping[str, float] | None = None,
    generator: str | None = None,
    intergen: IntergenRequest | None = None,
    diffusion: DiffusionRequest | None = None,
    raw: bool = False,
    progress: Progress = no_progress,
) -> tuple[DuetMotion, dict[str, Any]]:
    """Return the duet of a sentence, and the facts of how it was made.

    What a network drew is finished, unless something of the motion was given: that stays exact.

    Args:
        text: The sentence.
        seed: Same seed, same machine: same motion.
        nearest_known: Take the nearest interaction of the repertoire for a sentence outside.
        style: Numbers of the style that the choreographer takes instead of the sentence's.
        generator: Who, of :data:`GENERATORS`; :func:`default_generator` by default.
        intergen: Which model, and what is given of the motion, for ``intergen``.
        diffusion: Which model, and how it is drawn from, for ``diffusion``.
        raw: Leave what a network drew as it is.
        progress: Told the share done.

    Raises:
        PromptError: The sentence is outside the repertoire and ``nearest_known`` is off.
        CheckpointError: The model is missing or damaged.
        SpecError: There is no such generator, or a setting is out of range.
    """
    generator = generator or default_generator()
    if generator not in GENERATORS:
        raise SpecError(
            f"no generator '{generator}'",
            allowed=", ".join(GENERATORS),
            hint=nearest(generator, GENERATORS),
        )
    if generator == "choreographer":
        from generator.choreographer.from_text import generate as choreograph

        motion, understood = choreograph(text, seed=seed, nearest=nearest_known, style=style)
        confidence = round(float(understood.certainty), 4)
        return motion, {"generator": generator, "confidence": confidence}
    start = time.process_time()
    if generator == "intergen":
        from generator.intergen import IntergenRequest
        from generator.intergen import generate as draw

        wish = intergen or IntergenRequest()
        raw = raw or wish.wants_given
        if not raw:  # finishing takes jitter out where it is
            wish = replace(wish, smoothing=0.0)
        motion, facts = draw(text, wish, seed=seed, progress=progress)
    else:
        from generator.runtime.generation import generate as sample
        from generator.runtime.request import DiffusionRequest

        request = diffusion or DiffusionRequest()
        request = replace(request, nearest=request.nearest or nearest_known)
        motion, facts = sample(text, request, seed=seed, progress=progress)
    facts |= {"generator": generator, "cpu_seconds": round(time.process_time() - start, 3)}
    if raw:
        return motion, facts
    from generator.finishing import DRAWN

    motion, changes = clean(motion, settings=DRAWN, touches=_meetings(text, facts))
    return motion, {**facts, "finishing": changes}


def make_group(
    text: str,
    request: DiffusionRequest,
    *,
    seed: int = 0,
    raw: bool = False,
    progress: Progress = no_progress,
) -> tuple[dict[str, DuetMotion], dict[str, Any]]:
    """Return the duets of a group in one world, by the letters of their people, and the facts.

    Whoever is in two duets moves in both alike. So each person is finished alone: hands are not
    brought together, and nobody is moved.

    Args:
        text: What each pair does.
        request: Which model, how many people, and how they are drawn.
        seed: Same seed, same machine: same motions.
        raw: Leave what a network drew as it is.
        progress: Told the share done.
    """
    from generator.finishing import DRAWN
    from generator.runtime import generate_group
    from generator.runtime.group import nearest_strangers

    start = time.process_time()
    duets, facts = generate_group(text, request, seed=seed, progress=progress)
    facts["cpu_seconds"] = round(time.process_time() - start, 3)
    if not raw:
        alone = replace(DRAWN, hands=False, apart=False)
        cleaned = {pair: clean(motion, settings=alone) for pair, motion in duets.items()}
        duets = {pair: motion for pair, (motion, _) in cleaned.items()}
        facts["finishing"] = {pair: changes for pair, (_, changes) in cleaned.items()}
    facts["nearest_strangers"] = round(nearest_strangers(list(duets.values())), 3)
    return duets, facts


def clean(
    motion: DuetMotion,
    *,
    fps: float = FPS,
    settings: Finishing | None = None,
    touches: Sequence[Meeting | tuple[str, str]] = (),
) -> tuple[DuetMotion, dict[str, Any]]:
    """Return a motion as two bodies could have moved it, and what was changed, as JSON.

    Args:
        motion: From any generator or file.
        fps: Frames per second of the result.
        settings: Bounds; the defaults if not given.
        touches: Points of a and b that are meant to touch, somewhere or in a certain time.

    Raises:
        MotionError: The frame rate is absurd.
        SpecError: A point does not exist.
    """
    from generator.finishing import finish_with_changes

    start = time.process_time()
    done, changes = finish_with_changes(motion, fps=fps, settings=settings, expected=touches)
    facts = {name: _plain(value) for name, value in asdict(changes).items()}
    facts["fps_before"] = motion.fps
    facts["cpu_seconds"] = round(time.process_time() - start, 3)
    return done, facts


def _meetings(text: str, facts: dict[str, Any]) -> list[Meeting]:
    """Return who is to meet when, as the sentences of a motion say."""
    from generator.finishing.meant import meetings_of

    found, start, drawn_as = [], 0.0, facts.get("drawn_as", {})
    for part in facts.get("parts", [{"text": text, "end": math.inf}]):
        said = drawn_as.get(part["text"], part["text"])
        found += meetings_of(said, start, part["end"])
        start = part["end"]
    return found


def describe(motion: DuetMotion) -> dict[str, Any]:
    """Return the plain facts of a motion as JSON."""
    return {
        "interaction": motion.interaction,
        "frames": motion.frames,
        "fps": motion.fps,
        "seconds": round(motion.duration, 3),
        "seed": motion.seed,
        "licence": motion.licence,
        "contacts": [
            {"a": c.a, "b": c.b, "start": round(c.start, 3), "end": round(c.end, 3), "gap": c.gap}
            for c in motion.contacts
        ],
    }


def _plain(value: float) -> float | None:
    """Return a figure as JSON knows it: six digits after the point, none where there is no figure.

    ``nan`` is what was not looked at.
    """
    return value if isinstance(value, int) else None if value != value else round(value, 6)
