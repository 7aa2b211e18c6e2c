"""Three people and more, from a network that knows two: one pair after the other.

**The problem.** A network draws pairs. But it can draw a pair of which one person is given
(:class:`~generator.runtime.drawing.Held`), so a group is a chain: a and b are drawn together, then
c as the partner of b, d as the partner of c. What the network does not know of c is that a is
there, too, and where b looks there is a: it would put c into the same place. So every prediction of
c is moved aside, as little as gives all others room, before the next step is made from it, and the
network mends what c does from there.
"""

from __future__ import annotations

import string
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from generator.features import POINTS, POSITIONS
from generator.motion import DuetMotion
from generator.placement import placement_of
from generator.runtime.drawing import Held, Progress, draw
from generator.runtime.generation import (
    Studio,
    as_motion,
    facts_of,
    open_studio,
    part_frames,
)
from generator.runtime.network import Floats
from generator.runtime.request import DiffusionRequest
from generator.runtime.sequence import put_back, seen_from
from generator.text.encoder import SentenceEncoder
from robots.errors import SpecError
from robots.skeleton import FloatArray

ROOM = 0.8
"""Least distance on the ground between the pelvises of people who are no pair, m."""
STEP = 0.05
"""How finely the least move aside is searched for, m."""
DIRECTIONS = 24
"""In how many directions."""


def generate_group(
    text: str,
    request: DiffusionRequest,
    *,
    seed: int = 0,
    encoder: SentenceEncoder | None = None,
    progress: Progress | None = None,
) -> tuple[dict[str, DuetMotion], dict[str, Any]]:
    """Return the duets of a group, ``ab``, ``bc`` and so on, in one world, and the facts.

    Who is in two duets moves in both alike, and is person b of the first and a of the second.

    Args:
        text: What each pair does.
        request: Everything else; ``request.people`` says how many.
        seed: The same seed gives the same group on the same machine.
        encoder: Sentence encoder; the one that ships by default.
        progress: Called with the share done, 0 to 1.

    Raises:
        PromptError: The sentence is empty.
        CheckpointError: The model is missing or damaged.
        SpecError: A setting is out of range, or the length is more than the model has learnt.
    """
    studio = open_studio((text,), request, seed, encoder)
    frames, longest = part_frames(studio, 1)[0], studio.model.sampling.frames
    if frames > longest or studio.model.config.representation == "canonical":
        raise SpecError(
            f"{request.people} people for {frames} frames",
            where="--people",
            allowed=f"up to {longest} frames, and a model of the non-canonical representation",
        )
    pairs = request.people - 1

    def drawn(number: int, held: Held | None, others: FloatArray | None) -> FloatArray:
        steering = replace(studio.steering(text), held=held)
        if others is not None:
            steering = replace(steering, mend=lambda clean: _aside(studio, clean, others))
        return draw(
            studio.model,
            studio.cond(text),
            frames,
            studio.sampler,
            seed=(seed, number) if number else seed,
            steering=steering,
            progress=lambda share: progress((number + share) / pairs) if progress else None,
        )[0]

    first = drawn(0, None, None)
    people = [first[:, 0], first[:, 1]]
    for number in range(1, pairs):
        stand = placement_of(_points(people[-1][:1]))
        known = seen_from(people[-1], stand)
        others = np.stack([_pelvis(seen_from(one, stand)) for one in people[:-1]], axis=1)
        pair = drawn(number, _held_person(studio, known), others)
        people.append(put_back(pair[:, 1], stand))
    names = string.ascii_lowercase
    duets = {
        names[i : i + 2]: as_motion(studio, np.stack(people[i : i + 2], axis=1), text, seed)
        for i in range(pairs)
    }
    return duets, {**facts_of(studio), "people": request.people}


def spread(path: NDArray, others: NDArray, room: float = ROOM) -> FloatArray:
    """Return the least move aside ``[2]`` m, to 5 cm, that keeps a path away from others.

    It is the same at all times, so that the motion itself does not change, and zero where there is
    room. Circles around the old place are searched, from the smallest; far out there is room.

    Args:
        path: ``[T, 2]`` m, of the pelvis on the ground.
        others: ``[T, P, 2]`` m.
        room: Least distance, m.
    """
    between = path[:, None] - others
    turns = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=-1)
    farthest = float(np.linalg.norm(between, axis=-1).max()) + room
    for radius in np.arange(0, farthest + 2 * STEP, STEP):
        moves = radius * circle
        distances = np.linalg.norm(between + moves[:, None, None], axis=-1).min(axis=(1, 2))
        best = int(np.argmax(distances))
        if distances[best] >= room:
            return moves[best]
    raise ValueError("a path is not finite")


def _aside(studio: Studio, clean: Floats, others: FloatArray) -> Floats:
    """Return a prediction ``[1, T, 2F]`` with its second person moved aside."""
    raw = studio.model.denormalise(clean)
    offset = spread(_pelvis(raw[0, :, 1]), others)
    raw[0, :, 1, 0 : 3 * POINTS : 3] += offset[0]
    raw[0, :, 1, 2 : 3 * POINTS : 3] += offset[1]
    return studio.model.normalise(raw)


def _held_person(studio: Studio, features: FloatArray) -> Held:
    """Return that the first person of a pair does this, ``[T, 262]``."""
    both = np.stack([features, features], axis=1)
    known = np.zeros(both.shape, bool)
    known[:, 0] = True
    return Held(studio.model.normalise(both)[None], known.reshape(1, len(features), -1))


def _pelvis(features: NDArray) -> FloatArray:
    """Return where the pelvis is on the ground, ``[T, 2]`` m, of features ``[T, 262]``."""
    return np.asarray(features[:, (0, 2)], float)


def _points(features: NDArray) -> FloatArray:
    return features[..., POSITIONS].reshape(*features.shape[:-1], POINTS, 3)


def nearest_strangers(duets: Sequence[DuetMotion]) -> float:
    """Return the least distance of the pelvises of two people who are no pair, m."""
    paths = [duets[0].a.keypoints[:, 0, :2], *(duet.b.keypoints[:, 0, :2] for duet in duets)]
    distances = [
        float(np.linalg.norm(paths[i] - paths[j], axis=-1).min())
        for j in range(len(paths))
        for i in range(j - 1)
    ]
    return min(distances, default=float("inf"))
